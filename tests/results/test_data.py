from __future__ import annotations

import dataclasses

import pytest

from bgn import domains
from bgn.results.data import data_hash, unseen_fields


def test_data_hash_sees_a_changed_table_or_rule() -> None:
    domain = domains.get("hallway")
    joint = domain.model.joint
    rewards = joint.rewards.copy()
    rewards.flat[0] += 1e-9
    changed = dataclasses.replace(domain.model, joint=dataclasses.replace(joint, rewards=rewards))
    others = [
        dataclasses.replace(domain, model=changed),
        dataclasses.replace(domain, episode_limit=99),
        domains.get("hallway-2"),
    ]
    assert len({data_hash(one) for one in (domain, *others)}) == 4
    assert data_hash(dataclasses.replace(domain)) == data_hash(domain)


def test_data_hash_skips_what_is_for_people() -> None:
    domain = domains.get("hallway")
    assert unseen_fields(type(domain)) == ["title", "layout"]
    for_people = dataclasses.replace(domain, title="Another name", layout=None)
    assert data_hash(for_people) == data_hash(domain)


def test_data_hash_can_name_what_a_former_version_did_not_mark() -> None:
    @dataclasses.dataclass
    class Former:
        title: str
        limit: int

    one, two = Former("a", 1), Former("b", 1)
    assert data_hash(one) != data_hash(two)  # type: ignore[arg-type]
    assert data_hash(one, unseen=["title"]) == data_hash(two, unseen=["title"])  # type: ignore[arg-type]


def test_a_new_optional_field_changes_nothing_until_it_is_used() -> None:
    @dataclasses.dataclass
    class Before:
        limit: int

    @dataclasses.dataclass
    class After:
        limit: int
        prior: float | None = None

    assert data_hash(After(1)) == data_hash(Before(1)) != data_hash(After(1, 0.5))  # type: ignore[arg-type]


def test_what_cannot_be_hashed_is_refused() -> None:
    @dataclasses.dataclass
    class Strange:
        rule: object

    with pytest.raises(TypeError, match="function"):
        data_hash(Strange(lambda: None))  # type: ignore[arg-type]
