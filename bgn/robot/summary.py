"""What came out of a session: one row a task, as evidence that stands beside the simulated results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bgn.robot.entrant import Entrant
from bgn.robot.lab import Lab
from bgn.robot.network import is_loopback
from bgn.robot.recording import FINISHED, SessionFolder, rows
from bgn.robot.statistics import clopper_pearson


@dataclass(frozen=True)
class Circumstances:
    """Where and how episodes were played."""

    lab: Lab
    host: str
    serial: str
    polyscope: str
    speed: float

    @property
    def evidence(self) -> str:
        """``robot``, or ``twin`` at a loopback address."""
        return "twin" if is_loopback(self.host) else "robot"


def summarise(
    folder: SessionFolder, entrants: Mapping[str, Entrant], circumstances: Circumstances
) -> pd.DataFrame:
    """Return one row a task of the episodes that came to their end."""
    table = folder.episodes()
    lab = circumstances.lab
    found = []
    for task, entrant in entrants.items():
        mine = table[table.task == task] if len(table) else table
        done = mine[mine.outcome.isin(FINISHED)] if len(mine) else mine
        successes = int((done.outcome == "success").sum()) if len(done) else 0
        low, high = clopper_pearson(successes, len(done))
        found.append(
            {
                "evidence": circumstances.evidence,
                "domain": task,
                "agent": entrant.policy.spec.id,
                "episodes": len(done),
                "successes": successes,
                "success": successes / len(done) if len(done) else np.nan,
                "success_low": low,
                "success_high": high,
                "length": float(done.steps.mean()) if len(done) else np.nan,
                "interrupted": len(mine) - len(done),
                "policy": entrant.place,
                "policy_sha256": entrant.digest,
                "serial": circumstances.serial,
                "polyscope": circumstances.polyscope,
                "speed": circumstances.speed,
                "baseline_0": float(np.mean([pair[0] for pair in done.baseline])) if len(done) else np.nan,
                "baseline_1": float(np.mean([pair[1] for pair in done.baseline])) if len(done) else np.nan,
                "angle_edges": str(list(lab.station(task).angle_edges)),
                "soft": lab.gripper.soft,
                "stiff": lab.gripper.stiff,
            }
        )
    return pd.DataFrame(found)


def render(summary: pd.DataFrame) -> str:
    """Return the summary as the table that is printed."""
    lines = [
        f"{'task':14} {'agent':12} {'evidence':8} {'success':>9} {'rate':>7} {'95 % interval':>15} {'length':>7}"
    ]
    for row in rows(summary):
        interval = f"{100 * row.success_low:.1f}..{100 * row.success_high:.1f} %"
        count = f"{row.successes}/{row.episodes}"
        rate = f"{100 * row.success:.0f} %" if row.episodes else "-"
        lines.append(
            f"{row.domain:14} {row.agent:12} {row.evidence:8} {count:>9} {rate:>7} {interval:>15} {row.length:7.1f}"
        )
    return "\n".join(lines)
