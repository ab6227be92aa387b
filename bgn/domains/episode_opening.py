"""How an episode opens: two conventions are in use in the paper's table."""

from __future__ import annotations

from typing import Final, Literal

EpisodeOpening = Literal["clean", "hidden-first-action"]
"""``clean``: the policy chooses every action. ``hidden-first-action``: nature first takes an unseen, uniformly
random action; what it showed is seen, its reward is dropped (the authors' environment wrappers)."""

CLEAN: Final = "clean"
HIDDEN: Final = "hidden-first-action"
