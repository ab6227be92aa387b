"""What can be made to go wrong at the twin, and when.

A fault is written NAME[=VALUE][@MOTION[+SECONDS]]: at once, or so many seconds (of simulated time) into the
MOTION-th motion from now. ``bgn robot twin --fault`` and the control socket take the same words.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from bgn.robot.errors import UsageError

#: Name: (what it does, default value or None).
FAULTS: Final[dict[str, tuple[str, float | None]]] = {
    "close": ("close all RTDE connections (FIN)", None),
    "reset": ("reset all RTDE connections (RST)", None),
    "mute": ("send no more RTDE data", None),
    "freeze": ("answer nothing for VALUE seconds of wall time; the arm goes on", 3.0),
    "refuse": ("reset all connections and refuse new ones", None),
    "protective-stop": ("make a protective stop", None),
    "emergency-stop": ("press the emergency stop", None),
    "stop-program": ("stop the program, as somebody at the pendant would", None),
    "wall": ("put a padded wall VALUE metres ahead of the gripper", 0.02),
    "short": ("end the present motion at VALUE of what was left of it", 0.5),
    "local": ("switch to local mode", None),
    "fieldbus": ("let a fieldbus own the input registers", None),
    "gripper-lost": ("lose the next VALUE replies of the gripper", 1.0),
    "gripper-garbled": ("garble the next VALUE replies of the gripper", 1.0),
    "gripper-duplicate": ("send the next VALUE replies of the gripper twice", 1.0),
    "gripper-late": ("let all replies of the gripper come VALUE seconds late", 0.02),
    "gripper-dead": ("let the gripper die", None),
    "drift": ("turn the zero of the finger's encoder by VALUE rad", 0.2),
    "noise": ("let the finger's angle scatter by VALUE rad", 0.05),
}
_PATTERN: Final = re.compile(r"([a-z-]+)(?:=([0-9.+-]+))?(?:@(\d+)(?:\+([0-9.]+))?)?")


@dataclass(frozen=True)
class Fault:
    """One thing to go wrong."""

    name: str
    value: float
    motion: int
    """Which motion from now on; 0 is at once."""
    delay: float
    """Simulated seconds into that motion."""


def parse(text: str) -> Fault:
    """Read a fault.

    Raises
    ------
    UsageError
        No such fault, or not of the form above.
    """
    found = _PATTERN.fullmatch(text)
    if found is None or found[1] not in FAULTS:
        raise UsageError(
            f"{text!r} is not a fault: NAME[=VALUE][@MOTION[+SECONDS]] with NAME of {', '.join(FAULTS)}"
        )
    default = FAULTS[found[1]][1]
    if found[2] and default is None:
        raise UsageError(f"the fault {found[1]!r} takes no value")
    try:
        value = float(found[2]) if found[2] else default or 0.0
        return Fault(found[1], value, int(found[3] or 0), float(found[4] or 0))
    except ValueError as error:
        raise UsageError(f"{text!r}: {error}") from error
