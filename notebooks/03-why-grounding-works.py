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
# # 03 · Why would grounding work?
#
# A grounded network has to say what it believes. The simulator knows the exact belief while training, so the network can be
# corrected, and what it then carries in its memory is what a good decision needs. That is the idea; this page looks for its traces.

# %%
from benchmarks.notebooks import display
from bgn.analysis import answers
from bgn.analysis.figures import across, curves, schematic

evidence = display.read()
display.answer(answers.grounding(evidence.scores))
display.stamp(evidence)

# %% [markdown]
# ## The agent
#
# Actor and critic are two recurrent networks that read nothing but observations and their own actions. Grounding adds one output
# layer to each, in colour; at run time it is left off.

# %%
display.figure(schematic.architecture())

# %% [markdown]
# ## The belief loss falls, whether or not there are rewards

# %%
display.figure(curves.belief_losses(evidence.scores, evidence.agent_titles))

# %% [markdown]
# ## What the network believes
#
# One episode of a trained agent in TwoBumps-1D: above, its reconstruction of where the two bumps can be; below, the exact
# belief. The finger (yellow) moves along the diagonal, the truth is ringed.

# %%
display.beliefs(evidence, "two-bumps-1d", "ah-ch+bgn")

# %% [markdown]
# ## Does a better belief go with a better policy?
#
# If knowing were all that mattered, marks would fall from the upper left to the lower right.

# %%
display.figure(across.belief_against_score(evidence.scores, evidence.agent_titles))

# %% [markdown]
# ## Grounding an agent that is given the belief
#
# Ab-Cb has the exact belief as its input and nothing left to infer. The paper reports that reconstructing its own input helps it
# nevertheless, about half of the way to Ah-Ch+BGN.

# %%
agents = ("ah-ch+bgn", "ab-cb", "ab-cb+bgn")
display.figure(curves.success_curves(evidence.scores, evidence.agent_titles, agents))

# %% [markdown]
# ## The memoryless trap
#
# RockSample can be left to the east at once, for a sure +10. An agent that can't tell good rocks from bad ones is right to do so, and
# three of the paper's agents are worth no more than that. Where all marks lie on the line *drive east*, agreement with the paper
# means only that both gave up.

# %%
display.figure(across.openings(evidence.scores, evidence.agent_titles, evidence.reference_titles))
display.figure(across.every_seed(evidence.scores, evidence.agent_titles, "classic"))

# %% [markdown]
# ## Verdict

# %%
display.verdicts(evidence, "03-why-grounding-works")
