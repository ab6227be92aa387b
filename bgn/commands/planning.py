"""What ``bgn solve`` and ``bgn evaluate`` share: which model, which opening of its episodes, how to print."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, Final, get_args

from bgn import domains
from bgn.domains.domain import Domain
from bgn.domains.episode_opening import CLEAN, EpisodeOpening
from bgn.domains.from_file import FileDomain
from bgn.planning.sarsop import PlanningError

#: Counted steps of an episode in a file's model, as in the paper's classic domains (Table 4).
FILE_EPISODE_LIMIT: Final = 100


def add_model(command: argparse.ArgumentParser) -> None:
    """Add the arguments that say what is planned for, and how the result is printed."""
    command.add_argument("model", metavar="FILE", help="a .pomdp file, or the id of a domain")
    command.add_argument(
        "--convention",
        choices=get_args(EpisodeOpening),
        default=CLEAN,
        help="how an episode opens; the second with an unseen random action, as for the paper's agents",
    )
    command.add_argument("--json", action="store_true", help="print the result as JSON")


def load_domain(name: str) -> Domain:
    """Return a domain by its id, or the one that a .pomdp file defines."""
    if name in domains.ids():
        return domains.get(name)
    path = Path(name)
    if not path.exists():
        raise PlanningError(f"{name}: no such file, nor a domain; domains: {', '.join(domains.ids())}")
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    return FileDomain(
        id=path.name,
        title=path.name,
        source=name,
        text=text,
        episode_limit=FILE_EPISODE_LIMIT,
        hidden_first_action=True,
    ).build()


def print_values(values: dict[str, Any], *, as_json: bool) -> None:
    """Print named values, one a line, or as JSON."""
    if as_json:
        print(json.dumps(values, indent=2))
        return
    for name, value in values.items():
        if value is not None:
            print(f"{name.replace('_', ' '):>20}  {f'{value:,.6g}' if isinstance(value, float) else value}")
