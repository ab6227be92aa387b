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
# # 02 · Does grounding make learning faster?
#
# The title of the paper promises *accelerated* learning. Speed is a matter of curves: how many steps until an agent is good?

# %%
from benchmarks.notebooks import display
from bgn.analysis import answers
from bgn.analysis.figures import across, curves

evidence = display.read()
display.answer(answers.speed_of_learning(evidence.scores))
display.stamp(evidence)

# %% [markdown]
# ## Classic domains
#
# The paper draws these curves over its full horizon. Steps are on a logarithmic axis here, because most of the story happens
# early. The dotted line is SARSOP's return when its episodes open the way the agents' do, with a hidden random action: it is the
# best that planning found, and in RockSample it lies well below the SARSOP of the paper's table.

# %%
display.figure(curves.training_curves(evidence.scores, evidence.agent_titles))

# %% [markdown]
# ## Robot domains

# %%
display.figure(curves.success_curves(evidence.scores, evidence.agent_titles))

# %% [markdown]
# ## Steps to 90 % of the best
#
# The median run, with the 95 % interval of a bootstrap over runs. *Never* means that at least half of the runs did not get there
# within the horizon of the store.

# %%
display.frame(across.efficiency(evidence.scores, evidence.agent_titles), index=True)

# %% [markdown]
# ## All domains at once
#
# A performance profile shows, for every level, what share of the runs is above it: a curve further to the right is better, and
# where two cross neither is simply the better agent.

# %%
display.figure(across.performance_profiles(evidence.scores, evidence.agent_titles))

# %% [markdown]
# The interquartile mean (IQM) sums a profile up in a number, and the probability of improvement asks how often a run of
# Ah-Ch+BGN would beat a run of the other agent. Classic domains first, then the robot domains.

# %%
display.frame(across.aggregates(evidence.scores, evidence.agent_titles, "classic"))
display.frame(across.aggregates(evidence.scores, evidence.agent_titles, "robot"))

# %% [markdown]
# ## Verdict

# %%
display.verdicts(evidence, "02-learning-curves")
