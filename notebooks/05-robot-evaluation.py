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
# # 05 · Do the policies work on a robot?
#
# The paper runs its policies on a UR5e with a compliant two-finger gripper and reports success in every episode. This page
# reads the recordings of such an evaluation; until there are any, it shows what stands in for it: the same policies in physics.

# %%
from benchmarks.notebooks import display

evidence = display.read()
display.recordings()
display.stamp(evidence)

# %% [markdown]
# ## In physics
#
# Policies act in MuJoCo instead of on the tables they were trained on, with sampled actions.

# %%
display.physics(evidence)

# %% [markdown]
# ## How to fill this page
#
# Run an evaluation session (`bgn robot --help`), and put its folder under `results/published/robot/` (or name another with
# `BGN_RECORDINGS`): a session is a folder with `session.json` and `episodes/NAME/episode.json`. Recordings of the simulated arm are
# read in the same way and say *twin*. Then execute this notebook again: `nox -s notebooks -- --write`.
#
# ## Verdict

# %%
display.verdicts(evidence, "05-robot-evaluation")
