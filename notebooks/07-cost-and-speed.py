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
# # 07 · What does a run cost?
#
# Whether a result can be reproduced also depends on what it takes. Every stored run records its time. Shown are, where they are
# stored, the runs of the `laptop` budget: all of them trained on a CPU.

# %%
from benchmarks.notebooks import display
from bgn.analysis import answers
from bgn.analysis.figures import across

evidence = display.read(rather="laptop")
display.answer(answers.cost(evidence.runs))
display.stamp(evidence)

# %% [markdown]
# ## By domain and agent
#
# The seeds of a cell are trained as one stack, so a run's cost is its share of it. Times depend on the machine and on what else it
# was doing; compare within a column, not with other pages.

# %%
display.figure(across.cost(evidence.scores, evidence.agent_titles))

# %% [markdown]
# ## By budget

# %%
display.costs()

# %% [markdown]
# ## Verdict
#
# Agents that see a belief or a state instead of a history train fastest, since their networks have no recurrence; grounding costs
# an output layer and, in the larger domains, the exact belief. How the speed is reached, and how it compares with the authors' code
# on one machine, is in `docs/performance.md`.
