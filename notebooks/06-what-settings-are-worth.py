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
# # 06 · What are the settings worth?
#
# The paper and the code behind its numbers differ, and both leave things open. Some of these settings decide what is learnt;
# others can be read either way without consequence. This page shows every preset that is stored, side by side.

# %%
from benchmarks.notebooks import display
from bgn.analysis.figures import across

presets = display.read_presets()
display.answer(f"{len(presets)} presets are stored: {', '.join(presets)}.")
display.stamp(*presets.values())

# %% [markdown]
# ## The hidden first action
#
# The authors' environments take one unseen random action before an agent's first. In RockSample it ends a fifth of the episodes
# at once, for the best policy too. The lines show what a policy loses by it; the paper's best agents lie where SARSOP lies
# *with* the hidden action, not above it.

# %%
evidence = display.read()
display.figure(across.openings(evidence.scores, evidence.agent_titles, evidence.reference_titles))

# %% [markdown]
# ## Where the presets differ
#
# Only settings in which at least two of the stored presets differ are shown; the meaning of each is in
# `bgn/agents/hyperparameters.py`, the reasons in `DEVIATIONS.md`.

# %%
display.preset_settings(presets, "top-plate")

# %%
display.preset_settings(presets, "hallway")

# %% [markdown]
# ## What came of it: robot domains
#
# Success of the final policies with sampled actions, mean ± standard deviation (number of runs).

# %%
display.by_preset(("top-plate", "two-bumps-1d", "two-bumps-2d"), "sampled_success")

# %% [markdown]
# ## What came of it: classic domains
#
# Return of the final policies: greedy in the Hallways, sampled in RockSample.

# %%
display.by_preset(("hallway", "hallway-2"), "greedy_return")
display.by_preset(("rocksample-4-4", "rocksample-5-5"), "sampled_return")

# %% [markdown]
# ## Verdict

# %%
display.missing_presets(presets)
display.verdicts(evidence, "06-what-settings-are-worth")
