"""Who acts on a history: random, scripted, planned and trained policies behind one protocol."""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bgn.domains.domain import Domain
    from bgn.policies.loading import SavedPolicy


def load(
    path: str | os.PathLike[str], domain: Domain | str | None = None, *, greedy: bool = True
) -> SavedPolicy:
    """Read a saved policy, ready to act: trained networks, or alpha vectors.

    In a Gymnasium environment of its domain::

        policy = bgn.policies.load("hallway.safetensors")
        env = gymnasium.make("bgn/Hallway-v0")
        observation, info = env.reset(seed=0)
        policy.reset()
        action, over = info["last_action"], False
        while not over:
            action = policy.act(observation, action)
            observation, reward, ended, truncated, info = env.step(action)
            over = ended or truncated

    Parameters
    ----------
    path
        What a run left (``.safetensors``), or alpha vectors in APPL's format (``bgn solve --policy``).
    domain
        Where it is to act, by default where the file says that it was made.
    greedy
        Whether networks take their most probable action, or sample with the generator given to ``reset``.

    Raises
    ------
    InputError
        It does not fit the domain, or the file does not say for which domain it is.
    PolicyFileError, bgn.policies.alpha_file.PolicyFormatError
        It is not a policy.
    OSError
        It cannot be read.
    """
    # Imported by name, so that one kind of policy can be used without what the others need.
    found: SavedPolicy = import_module("bgn.policies.loading").load(path, domain, greedy=greedy)
    return found
