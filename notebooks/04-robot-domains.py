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
# # 04 · Is Ah-Ch+BGN alone in always succeeding with the finger?
#
# A finger on a rail or a plane, compliant or stiff, feels for plates and bumps it can't see. For these three domains the paper prints
# no numbers; it says that Ah-Ch+BGN is the only agent with a perfect success rate in all of them.

# %%
from benchmarks.notebooks import display
from bgn.analysis import answers, tables
from bgn.analysis.figures import across, curves

evidence = display.read()
display.answer(answers.robots(evidence.scores))
display.stamp(evidence)

# %% [markdown]
# ## What trained policies do
#
# Each strip is one episode in MuJoCo of a policy that was trained on the compiled tables: the scene, what the network believes,
# and the exact belief.

# %%
display.film_strip(evidence, "top-plate", "ah-ch+bgn")

# %%
display.film_strip(evidence, "two-bumps-1d", "ah-ch+bgn")

# %%
display.film_strip(evidence, "two-bumps-2d", "ah-ch+bgn")

# %% [markdown]
# ## Whether they do what the paper describes
#
# Section 5.3 describes each policy in words. Both the policies, which take their most probable action here, and the domains are
# deterministic: from every possible start there is one episode, and the share of those that go as described is exact. Where the
# finger goes is what counts, not actions that leave it in its place.

# %%
display.table(tables.policies_habits(evidence))

# %% [markdown]
# ## How often they succeed
#
# The interval is one of a *seed's* success rate. Pooling all episodes would hide that seeds differ, and seeds that agree would hide
# that episodes are finite, so the wider of both intervals is taken.

# %%
display.figure(across.every_seed(evidence.scores, evidence.agent_titles, "robot"))

# %%
display.table(tables.success_rates(evidence))

# %%
display.figure(curves.success_curves(evidence.scores, evidence.agent_titles))

# %% [markdown]
# ## Who loses what was learnt
#
# A run that has learnt a task may stop succeeding altogether, and later succeed again. It has then stopped grasping: its episodes
# run into the time limit (50 steps in TopPlate, 100 in TwoBumps-2D), and its entropy is that of moving at random without a grasp
# (ln 2 = .69 and ln 4 = 1.39 nats). A grasp is what rewards come from, so little but the entropy bonus brings it back. An
# evaluation of the final policy finds such a run wherever it happens to be when training ends; the last fifth of training says
# what it does on average.

# %%
display.answer(answers.lost_success(evidence, evidence.scores))
display.table(tables.success_collapses(evidence, evidence.scores))

# %% [markdown]
# ## Where the layers start
#
# The paper does not say how weights start. Started as in the authors' code, the networks are nearly blind to the finger's position at first;
# started as *ridges* (thresholds spread over the features' range) every agent sees it from the first step, grounded or not. The
# table shows each preset that is stored, with steps and, in brackets, the number of runs.

# %%
display.by_preset(("top-plate", "two-bumps-1d", "two-bumps-2d"), "sampled_success")

# %% [markdown]
# ## Verdict

# %%
display.verdicts(evidence, "04-robot-domains")
