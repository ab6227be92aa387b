"""``bgn render``: an episode of a robot domain as a GIF and a film strip."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bgn.commands.parsing import Commands, check_robot_domain, robot_domains
from bgn.domains.registry import get
from bgn.errors import InputError

if TYPE_CHECKING:
    from bgn.domains.domain import Domain
    from bgn.simulation.policy import Policy


def add_render(commands: Commands) -> None:
    """Add the command that films an episode."""
    command = commands.add_parser(
        "render", help="film an episode of a robot domain: a GIF and a film strip with the beliefs beside it"
    )
    command.add_argument("domain", metavar="DOMAIN", help=f"one of {', '.join(robot_domains())}")
    command.add_argument(
        "--policy",
        default="scripted",
        help="a saved policy file, `scripted` (the paper's description) or `random` (default: %(default)s)",
    )
    command.add_argument("--variant", help="of a random or scripted policy's domain: paper or authors")
    command.add_argument("--plates", type=int, help="of a random or scripted policy's top-plate")
    command.add_argument("--seed", type=int, default=0, help="of the episode (default: %(default)s)")
    command.add_argument("--out", type=Path, help="the GIF (default: DOMAIN.gif); the strip lies beside it")
    command.set_defaults(run=_render)


def _render(options: argparse.Namespace) -> int:
    check_robot_domain(options.domain)
    from bgn.pictures import film

    asked = {"variant": options.variant, "plates": options.plates}
    variant = {key: value for key, value in asked.items() if value is not None}
    domain, policy = _find_policy(options.domain, options.policy, variant)
    out: Path = options.out or Path(f"{options.domain}.gif")
    if not out.parent.is_dir():
        raise InputError(f"no folder {out.parent} to write {out.name} into")
    if out.suffix != ".gif":
        raise InputError(f"--out {out}: a film is a .gif file")
    recorded = film.record(domain, policy, options.seed)
    strip = out.with_name(f"{out.stem}-strip.png")
    film.save_gif(recorded, out)
    film.save_strip(recorded, strip)
    print(out, strip, sep="\n")
    return 0


def _find_policy(domain_id: str, name: str, variant: dict[str, str | int]) -> tuple[Domain, Policy]:
    from bgn import policies
    from bgn.policies.scripted import scripted_policy
    from bgn.policies.uniform import RandomPolicy

    if name in ("random", "scripted"):
        domain = get(domain_id, **variant)
        return domain, RandomPolicy(domain) if name == "random" else scripted_policy(domain)
    if variant:
        raise InputError("a saved policy brings its own variant: leave out --variant and --plates")
    policy = policies.load(name)
    if policy.domain.id != domain_id:
        raise InputError(f"{name} is a policy of {policy.domain.id}, not of {domain_id}")
    return policy.domain, policy
