from __future__ import annotations

import dataclasses

import pytest

from bgn.agents.hyperparameters import Hyperparameters
from bgn.results import provenance
from bgn.results.provenance import Origin
from bgn.training.cell import CellSpec

SPEC = CellSpec(domain="hallway", agent="ah-ch", hyperparameters=Hyperparameters(), env_steps=100)


def test_spec_hash_sees_every_field() -> None:
    others = [
        dataclasses.replace(SPEC, env_steps=101),
        dataclasses.replace(SPEC, hyperparameters=Hyperparameters(learning_rate=1e-3)),
        dataclasses.replace(SPEC, variant={"n": 5}),
    ]
    hashes = {provenance.spec_hash(spec) for spec in (SPEC, *others)}
    assert len(hashes) == 4
    assert provenance.spec_hash(dataclasses.replace(SPEC)) in hashes


def test_spec_refuses_what_it_cannot_hold() -> None:
    with pytest.raises(TypeError, match="set"):
        provenance.spec_hash(dataclasses.replace(SPEC, variant={"n": {1}}))  # type: ignore[dict-item]


def test_key_depends_on_all_three() -> None:
    keys = {Origin(*parts).key for parts in ("abc", "xbc", "axc", "abx")}
    assert len(keys) == 4
