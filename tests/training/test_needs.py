"""Training needs torch, numpy and scipy: a GPU machine without internet has little else."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
UNNEEDED = (
    *("gymnasium", "lark", "pydantic", "pandas", "pyarrow", "safetensors"),
    *("numba", "mujoco", "matplotlib", "rich"),
)
PROGRAM = f"""
import sys
sys.modules.update(dict.fromkeys({UNNEEDED}))  # as if they were not installed
from bgn.agents.hyperparameters import Hyperparameters
from bgn.training.cell import CellSpec
from bgn.training.trainer import train_cell
import benchmarks.gpu_check

for domain, agent in (("top-plate", "ah-ch+bgn"), ("hallway", "ab-cb")):
    spec = CellSpec(domain=domain, agent=agent, hyperparameters=Hyperparameters(lanes=2), env_steps=20,
                    evaluation_episodes=2, physics_episodes=3)
    (result,) = train_cell(spec, (0,))
    assert result.points[-1]["env_steps"] == 20
    assert "greedy_return" in result.metrics and "physics_success" not in result.metrics
"""


def test_a_cell_trains_without_what_it_does_not_need() -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, cwd=ROOT, env=environment
    )
    assert done.returncode == 0, done.stderr
