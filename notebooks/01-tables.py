# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3 (ipykernel)
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 01 · Do the paper's numbers come out again?
#
# The paper prints twenty numbers for its agents: four classic domains by five agents, the mean ± standard deviation of ten
# seeds (Table 6). This page sets ours beside them and says, for each, whether it is the same number.

# %%
from benchmarks.notebooks import display
from bgn.analysis import answers, tables
from bgn.analysis.figures import across

evidence = display.read()
display.answer(answers.numbers(evidence))
display.stamp(evidence)

# %% [markdown]
# ## Every seed, beside the paper
#
# A mark is one trained agent. The grey bar is what the paper prints. Where all marks of an agent lie in its bar, there is
# little to argue about; where they lie at *drive east*, the agent has learnt to leave the map and nothing else.

# %%
display.figure(across.every_seed(evidence.scores, evidence.agent_titles, "classic"))

# %% [markdown]
# ## The same as a table
#
# Two questions are asked of each cell. Does it differ from the paper's (Welch's test)? Is it equivalent to it, within a
# tolerance that was fixed beforehand: 0.05 in the Hallways, 1.0 in RockSample (two one-sided tests)? Both answers are
# corrected for there being twenty cells. Runs that are shorter than the paper's get no verdict at all: early in training
# agents that will differ later still do the same.

# %%
display.table(tables.raw_returns(evidence))

# %% [markdown]
# ## Normalised, as Table 7, and on one scale
#
# The paper scales returns so that Random is 0 and SARSOP is 1. It mixes two kinds of episode, though: its agents and Random
# start with an unseen random action, its SARSOP does not. Under the rows marked *alike* everyone starts the same way, and the
# gap between the best agents and SARSOP closes.

# %%
display.table(tables.normalised_returns(evidence))

# %% [markdown]
# ## What is stored
#
# Everything above shows, for each domain, the longest budget of most agents. This is what there is in all.

# %%
display.overview()

# %% [markdown]
# ## Verdict
#
# "By Table 6 itself" is the same question put to the paper's own numbers: some of its sentences say more than its table.

# %%
display.verdicts(evidence, "01-tables")
