"""How large a gap between twin and robot the policies bear: one gap is widened at a time until success drops.

Runs on the twin's physics without its protocols, so many episodes take minutes. The other gaps stay at the
laboratory file's values. A real session would refuse a noisy finger long before its policy fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from bgn.physics.tasks import task_of
from bgn.physics.world import play
from bgn.robot import lab as laboratory
from bgn.robot.entrant import PUBLISHED, ROOT, Entrant, enter
from bgn.robot.errors import RobotError, UsageError
from bgn.robot.lab import Lab
from bgn.robot.recording import rows
from bgn.robot.statistics import clopper_pearson
from bgn.robot.twin.direct import direct_finger

BORNE: Final = 0.95  # the success rate below which a gap counts as too wide
#: Values of each gap, in its own unit; the first is no gap.
GAPS: Final[dict[str, tuple[float, ...]]] = {
    "angle_noise": (0.0, 0.01, 0.02, 0.03, 0.04, 0.06, 0.08),  # rad, standard deviation of one sample
    "angle_drift": (0.0, 0.01, 0.02, 0.03, 0.04, 0.06),  # rad, after the baseline was taken
    "servo_lag": (0.0, 0.02, 0.05, 0.1, 0.2),  # s
    "placement_error": (0.0, 0.002, 0.004, 0.006, 0.008, 0.012),  # m, standard deviation
}


def sweep(
    tasks: Sequence[str], gaps: Sequence[str] | None, episodes: int, lab: Path | None, out: Path
) -> int:
    """Widen gaps, print a table, write it as parquet; return 0.

    Raises
    ------
    UsageError
        No such gap, or fewer than one episode.
    """
    wanted = list(gaps or GAPS)
    unknown = [gap for gap in wanted if gap not in GAPS]
    if unknown or episodes < 1:
        raise UsageError(f"gaps are {', '.join(GAPS)}, not {', '.join(unknown)}; episodes at least 1")
    base = laboratory.load(lab)
    entrants = [enter(task, ROOT / PUBLISHED.format(task=task)) for task in tasks]
    table = pd.DataFrame(
        [row for entrant in entrants for gap in wanted for row in widen(base, entrant, gap, episodes)]
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    table.to_parquet(out, index=False)
    print(render(table))
    print(out)
    return 0


def widen(lab: Lab, entrant: Entrant, gap: str, episodes: int) -> Iterator[dict[str, Any]]:
    """Widen one gap value by value until it is not borne any more."""
    for value in GAPS[gap]:
        row = measure(lab, entrant, gap, value, episodes)
        print(f"{entrant.domain.id:14} {gap:16} {value:<6g} {row['successes']}/{episodes}", flush=True)
        yield row
        if row["success"] < BORNE:
            return


def measure(lab: Lab, entrant: Entrant, gap: str, value: float, episodes: int) -> dict[str, Any]:
    """Play episodes with one gap at a value and return a row of the table."""
    # What the finger's own check would refuse is let through: here it is the policy that has to bear it.
    gripper = lab.gripper.model_copy(update={"baseline_spread": np.inf, "baseline_offset": np.inf})
    twin = lab.twin.model_copy(update={gap: value})
    widened = lab.model_copy(update={"twin": twin, "gripper": gripper})
    results = list(_outcomes(widened, entrant, episodes, drift=value if gap == "angle_drift" else 0.0))
    successes = results.count("success")
    low, high = clopper_pearson(successes, episodes)
    return {
        "domain": entrant.domain.id,
        "gap": gap,
        "value": value,
        "episodes": episodes,
        "successes": successes,
        "stopped": results.count("stopped"),
        "success": successes / episodes,
        "success_low": low,
        "success_high": high,
    }


def _outcomes(lab: Lab, entrant: Entrant, episodes: int, drift: float) -> Iterator[str]:
    """Play episodes; one that the arm's or the finger's own checks end is no success."""
    task, rng = task_of(entrant.domain.id), np.random.default_rng(0)
    for episode in range(episodes):
        finger, plant = direct_finger(lab, entrant.domain.id, seed=episode)
        plant.drift = 0.0
        finger.based = lambda plant=plant: setattr(plant, "drift", drift)  # type: ignore[misc]
        try:
            # The history alone: the same call evaluates a policy in the simulated scenes.
            succeeded, _ = play(entrant.domain, task(entrant.domain, finger), entrant.policy, rng)
            yield "success" if succeeded else "failure"
        except RobotError:
            yield "stopped"


def render(table: pd.DataFrame) -> str:
    """Return the sweep as text: the widest value of each gap up to which success stays at 95 %, and all points."""
    lines = [f"{'task':14} {'gap':16} success at each value (borne: at least {100 * BORNE:.0f} % so far)"]
    for (domain, gap), part in table.groupby(["domain", "gap"], sort=False):
        borne = part[(part.success >= BORNE).cummin()]
        widest = f"{borne.value.max():g}" if len(borne) else "none"
        points = "  ".join(f"{row.value:g}: {100 * row.success:.0f} %" for row in rows(part))
        lines.append(f"{domain:14} {gap:16} borne up to {widest:6} | {points}")
    return "\n".join(lines)
