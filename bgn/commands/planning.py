"""What ``bgn solve`` and ``bgn evaluate`` share: which model, which opening of its episodes, how to print."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from bgn import domains
from bgn.planning.evaluate import DEFAULT_LIMIT
from bgn.planning.sarsop import PlanningError
from bgn.pomdp import reader
from bgn.pomdp.model import MOMDP


def add_model(command: argparse.ArgumentParser) -> None:
    """Add the arguments that say what is planned for, and how the result is printed."""
    command.add_argument("model", metavar="FILE", help="a .pomdp file, or the id of a domain")
    command.add_argument(
        "--convention",
        choices=("clean", "hidden-first-action"),
        default="clean",
        help="how an episode opens; the second with an unseen random action, as for the paper's agents",
    )
    command.add_argument("--json", action="store_true", help="print the result as JSON")


def load_model(name: str) -> tuple[MOMDP, int]:
    """Return a model by file or domain id, and its episode limit."""
    if name in domains.ids():
        domain = domains.get(name)
        return domain.model, domain.episode_limit
    if not Path(name).exists():
        raise PlanningError(f"{name}: no such file, nor a domain; domains: {', '.join(domains.ids())}")
    return MOMDP(reader.load(name)), DEFAULT_LIMIT


def print_values(values: dict[str, Any], *, as_json: bool) -> None:
    """Print named values, one a line, or as JSON."""
    if as_json:
        print(json.dumps(values, indent=2))
        return
    for name, value in values.items():
        if value is not None:
            print(f"{name.replace('_', ' '):>20}  {f'{value:,.6g}' if isinstance(value, float) else value}")
