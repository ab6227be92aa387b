"""The sizes of all domains beside those the paper prints (Tables 4 and 5)."""

from __future__ import annotations

from typing import NamedTuple

from rich.table import Table

from bgn.domains.domain import Domain
from bgn.domains.registry import get, ids


class Properties(NamedTuple):
    """A row of the paper's table of domain properties."""

    states: str  # |S|, or |X| x |Y| where a part is observed
    actions: str
    observations: str
    discount: str
    limit: str


PAPER = {
    "hallway": Properties("57", "5", "21", "0.95", "100"),
    "hallway-2": Properties("89", "5", "17", "0.95", "100"),
    "rocksample-4-4": Properties("257", "9", "2", "0.95", "100"),
    "rocksample-5-5": Properties("807", "10", "2", "0.95", "100"),
    "top-plate": Properties("21 x 8", "3", "21", "0.99", "50"),
    "two-bumps-1d": Properties("45 x 225", "4", "25", "0.99", "100"),
    "two-bumps-2d": Properties("48 x 256", "5", "48", "0.99", "100"),
}


def properties(domain: Domain) -> Properties:
    """Return what the paper's table says about a domain, measured on its model."""
    model = domain.model
    parts = f"{model.n_observed} x {model.n_hidden}" if model.n_observed > 1 else str(model.n_hidden)
    return Properties(
        parts,
        str(model.joint.n_actions),
        str(model.joint.n_observations),
        f"{domain.training_discount:g}",
        str(domain.episode_limit),
    )


def overview() -> Table:
    """Return the table of all domains; what differs from the paper shows the paper's value below it."""
    table = Table(
        title="Domains", caption="In brackets: what the paper prints (Tables 4 and 5), where it differs."
    )
    table.add_column("id", no_wrap=True)
    table.add_column("name", no_wrap=True)
    for heading in ("|S|", "|A|", "|Ω|", "γ", "limit"):
        table.add_column(heading, justify="right")
    for domain in map(get, ids()):
        ours = properties(domain)
        paper = PAPER.get(domain.id, ours)
        cells = (
            mine if mine == theirs else f"{mine} [dim]({theirs})[/dim]"
            for mine, theirs in zip(ours, paper, strict=True)
        )
        table.add_row(domain.id, domain.title.replace("[", r"\["), *cells)
    return table
