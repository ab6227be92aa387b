"""The commands ``compile`` and ``render`` of the force-feedback domains."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rich.console import Console
from rich.progress import track

from bgn.domains import _outcomes
from bgn.domains.registry import get

if TYPE_CHECKING:
    from bgn.domains.domain import Domain
    from bgn.domains.physics.compile import Column
    from bgn.simulation.physics_world import Policy

    Commands = argparse._SubParsersAction[argparse.ArgumentParser]

ROBOT_DOMAINS: Final = ("top-plate", "two-bumps-1d", "two-bumps-2d")


def add_compile(commands: Commands) -> None:
    """Add the command that compiles physics into the tables."""
    command = commands.add_parser(
        "compile", help="compile the physics of the robot domains into their exact tables, where it changed"
    )
    command.add_argument("domains", nargs="*", metavar="DOMAIN", help=f"of {', '.join(ROBOT_DOMAINS)}")
    command.add_argument("--histories", type=int, default=4, help="histories a pair (default: %(default)s)")
    command.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes to compile in")
    command.add_argument("--force", action="store_true", help="compile even what is up to date")
    command.add_argument(
        "--tables", type=Path, default=_outcomes.SHIPPED, help="folder of the tables (default: the package's)"
    )
    command.set_defaults(run=_compile)


def add_render(commands: Commands) -> None:
    """Add the command that films an episode."""
    command = commands.add_parser(
        "render", help="film an episode of a robot domain: a GIF and a film strip with the beliefs beside it"
    )
    command.add_argument("domain", metavar="DOMAIN", help=f"one of {', '.join(ROBOT_DOMAINS)}")
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


def _compile(options: argparse.Namespace) -> None:
    from bgn.domains.physics import compile as compiler

    chosen = options.domains or ROBOT_DOMAINS
    for name in chosen:
        _check_robot_domain(name)
    console = Console()
    for name in chosen:
        stem = options.tables / name
        key = compiler.key(compiler.SCENES[name]())
        if not options.force and _up_to_date(stem, key, options.histories):
            console.print(f"{name}: up to date")
            continue

        def progress(columns: Iterable[Column], total: int, name: str = name) -> Iterable[Column]:
            return track(columns, f"{name}: compiling", total, console=console)

        table = compiler.compile_scene(
            name, histories=options.histories, jobs=options.jobs, progress=progress
        )
        _outcomes.save(table, stem)
        header = table.header
        console.print(
            f"{name}: {header.pairs} pairs, one outcome each from {header.histories} histories, "
            f"margin {header.margin:.0%} -> {stem}.npz"
        )


def _up_to_date(stem: Path, key: str, histories: int) -> bool:
    if not stem.with_suffix(".json").exists():
        return False
    header = _outcomes.load(stem).header
    return header.key == key and header.histories >= histories


def _render(options: argparse.Namespace) -> None:
    _check_robot_domain(options.domain)
    from bgn.simulation import film

    asked = {"variant": options.variant, "plates": options.plates}
    variant = {key: value for key, value in asked.items() if value is not None}
    domain, policy = _find_policy(options.domain, options.policy, variant)
    out: Path = options.out or Path(f"{options.domain}.gif")
    if not out.parent.is_dir():
        raise ValueError(f"no folder {out.parent} to write {out.name} into")
    recorded = film.record(domain, policy, options.seed)
    strip = out.with_name(f"{out.stem}-strip.png")
    film.save_gif(recorded, out)
    film.save_strip(recorded, strip)
    print(out, strip, sep="\n")


def _find_policy(domain_id: str, name: str, variant: dict[str, str | int]) -> tuple[Domain, Policy]:
    from bgn.agents.policy import Policy
    from bgn.simulation import scripted

    if name in ("random", "scripted"):
        domain = get(domain_id, **variant)
        return domain, scripted.RandomPolicy(domain) if name == "random" else scripted.scripted_policy(domain)
    if variant:
        raise ValueError("a saved policy brings its own variant: leave out --variant and --plates")
    policy = Policy.load(Path(name))
    if policy.domain.id != domain_id:
        raise ValueError(f"{name} is a policy of {policy.domain.id}, not of {domain_id}")
    return policy.domain, policy


def _check_robot_domain(name: str) -> None:
    if name not in ROBOT_DOMAINS:
        raise ValueError(f"{name!r} is not a robot domain; those are {', '.join(ROBOT_DOMAINS)}")
