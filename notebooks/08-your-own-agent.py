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
# # 08 · How does your own agent compare?
#
# An agent here is a declaration: what its actor sees, what its critic sees, whether it is grounded. This page declares one that the
# paper does not have, trains it for some seconds, and judges it, with nothing left out.

# %%
from benchmarks.notebooks import display, tutorial

display.answer("From a declaration to a verdict takes three steps: declare, train, judge.")

# %% [markdown]
# ## Declare
#
# The actor sees the belief, the critic the true state: an asymmetric agent with the belief where the paper's Ah-Cs has the history.

# %%
from bgn.agents.specs import AgentSpec

mine = AgentSpec(id="ab-cs", title="Ab-Cs", actor="belief", critic="state")

# %% [markdown]
# ## Train
#
# A cell is a domain and an agent, a run is a cell and a seed. The settings are those of the registry's default preset, the horizon is a
# few seconds long. `tutorial.train` puts the declaration beside the paper's agents for as long as it trains; to keep it, add it to
# `bgn/agents/specs.py` and name it under `[agents]` in `benchmarks/registry.toml`. Then `nox -s reproduce -- --agent ab-cs` trains it
# everywhere, and every table, figure and status shows it.

# %%
results = tutorial.train([mine, "ab-cb"], domain="hallway", env_steps=40_000, seeds=(0, 1, 2))
display.frame(tutorial.summary(results))

# %%
display.figure(tutorial.curves(results))

# %% [markdown]
# ## Judge
#
# Seeds are what is compared, and three of them say little: besides the difference and its p-value the table says how large a difference
# would have had to be in order to be seen four times in five.

# %%
display.frame(tutorial.compare(results, "ab-cs", "ab-cb"))

# %% [markdown]
# ## Verdict
#
# A new agent has no number in the paper to be held against, so its verdict in the tables is *no reference*; against another agent of
# the same store it is a test like the one above. For a claim, train at the `paper` budget and let `python -m benchmarks tables` say.
