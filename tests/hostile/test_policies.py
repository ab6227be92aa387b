"""A damaged saved policy is refused in its own words; only safetensors are read, which hold no code."""

from __future__ import annotations

import json
import pathlib
import pickle
import struct
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import agent
from bgn.policies.saved import NetworkPolicy, PolicyFileError, save_policy
from tests.effort import effort
from tests.hostile.mutation import mutate, refusal


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """Return a folder with a policy ``good``."""
    folder = tmp_path_factory.mktemp("policies")
    hyperparameters = Hyperparameters(recurrent_hidden_layers=1)
    networks = AgentNetworks(
        agent("ab-cb"), domains.get("hallway"), hyperparameters, (0,), torch.device("cpu")
    )
    names = networks.actor_parameters()
    tensors = {name: tensor for name, tensor in networks.parameters.of_seed(0).items() if name in names}
    save_policy(folder / "good", tensors, domain="hallway", agent="ab-cb", hyperparameters=hyperparameters)
    NetworkPolicy.load(folder / "good").act(0, None)
    return folder


def header(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Return a safetensors file's header and the rest."""
    (length,) = struct.unpack("<Q", content[:8])
    return json.loads(content[8 : 8 + length]), content[8 + length :]


def packed(head: object, rest: bytes) -> bytes:
    text = json.dumps(head).encode() if not isinstance(head, bytes) else head
    return struct.pack("<Q", len(text)) + text + rest


@settings(max_examples=effort(200, 5_000))
@given(seed=st.integers(0, 2**63), described=st.booleans())
def test_damaged_policies(folder: pathlib.Path, seed: int, described: bool) -> None:
    content = (folder / "good").read_bytes()
    if described:  # a file that is in order, of a damaged description
        head, rest = header(content)
        text = mutate(head["__metadata__"]["bgn"].encode(), seed, [b'"', b"{", b"null", b"true", b"[]"])
        head["__metadata__"]["bgn"] = text.decode(errors="replace")
        damaged = packed(head, rest)
    else:
        damaged = mutate(content, seed, [b'"', b"{", b"F64", b"BOOL", b"__metadata__"])
    path = folder / "damaged"
    path.write_bytes(damaged)
    refused = refusal(lambda: NetworkPolicy.load(path).act(0, None), PolicyFileError)
    assert refused is None or str(path) in refused


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"recurrent_hidden_layers": 10**9}, "recurrent_hidden_layers is 1000000000; expected 0 to 64"),
        ({"recurrent_hidden_layers": "2"}, "recurrent_hidden_layers is '2'; expected a int"),
        ({"shared_recurrence": None}, "shared_recurrence is None; expected a bool"),
    ],
)
def test_settings_that_must_not_get_through(
    folder: pathlib.Path, changes: dict[str, object], message: str
) -> None:
    head, rest = header((folder / "good").read_bytes())
    description = json.loads(head["__metadata__"]["bgn"])
    description["hyperparameters"] |= changes
    head["__metadata__"]["bgn"] = json.dumps(description)
    (folder / "changed").write_bytes(packed(head, rest))
    with pytest.raises(PolicyFileError, match=message):
        NetworkPolicy.load(folder / "changed")


def test_other_files_are_no_policies(folder: pathlib.Path) -> None:
    good = (folder / "good").read_bytes()
    head, rest = header(good)
    for content in (
        b"",
        good[: len(good) // 2],
        pickle.dumps({"actor": 1}),
        packed(b"[" * 100_000, rest),
        packed({**head, "__metadata__": {"bgn": "[" * 100_000}}, rest),
        packed({**head, "__metadata__": {"bgn": "9" * 5_000}}, rest),
        packed({**head, "__metadata__": {"bgn": '{"format": "bgn-policy-1"}'}}, rest),
        struct.pack("<Q", 2**62) + good[8:],
    ):
        path = folder / "other"
        path.write_bytes(content)
        with pytest.raises(PolicyFileError, match="other"):
            NetworkPolicy.load(path)
