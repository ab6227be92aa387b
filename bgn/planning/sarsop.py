"""SARSOP: point-based planning near the beliefs that optimal policies reach.

H. Kurniawati, D. Hsu, W. S. Lee, "SARSOP: Efficient Point-Based POMDP Planning by Approximating Optimally
Reachable Belief Spaces", RSS 2008. A search alternates between sampling a path of beliefs (guided by the
bounds and by values predicted from similar beliefs), backing up alpha vectors (lower bound) and sawtooth
points (upper bound) along it, and pruning what cannot be optimal. Both bounds hold at any time and only
improve.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
from scipy import sparse

from bgn.domains.episode_opening import CLEAN, EpisodeOpening
from bgn.errors import BgnError
from bgn.planning import _kernels as kernels
from bgn.planning.bounds import blind_policies, fast_informed, value_scale
from bgn.planning.compiled import CompiledModel, Ints, compile_model, restrict
from bgn.planning.episodic import start_beliefs
from bgn.policies.alpha_vectors import AlphaVectors
from bgn.pomdp.model import MOMDP, POMDP

#: A trial aims to close the gap to this share of what it is.
TRIAL_TARGET = 0.5
#: Steps that a sampled path may always have.
MIN_LONGEST_PATH = 200
#: A path may be this many times 1 / (1 - discount) long: what it tolerates grows by exp of that on the way.
LONGEST_PATH_HORIZONS = 3
#: Bounds the memory of a path where the discount is next to 1; trials that find nothing ask for less then.
MAX_LONGEST_PATH = 10_000
#: Prune when this many alpha vectors were added for each one that the last pruning left.
PRUNE_GROWTH = 0.25
#: Neighbourhood of the sampled beliefs in which pruning must not change the lower bound.
DELTA = 1e-4


class PlanningError(BgnError, ValueError):
    """A request that cannot be met; the message says why and what would be possible."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where a search stands."""

    lower: float
    """Value that the policy found guarantees at the start."""
    upper: float
    """Value that no policy exceeds."""
    seconds: float
    """CPU time of the search so far."""
    vectors: int
    """Alpha vectors in the policy."""
    beliefs: int
    """Beliefs sampled and not pruned."""
    trials: int
    backups: int

    @property
    def gap(self) -> float:
        """Upper bound minus lower bound."""
        return self.upper - self.lower


class Sarsop:
    """An anytime search: iterate :meth:`trials` for as long as wanted, then take the :meth:`policy`.

    Raises
    ------
    PlanningError
        The model's discount is 1: bounds need rewards that fade.
    """

    def __init__(self, model: POMDP | MOMDP, convention: EpisodeOpening = CLEAN) -> None:
        warm_up()
        self._begin(model, convention)

    def _begin(self, model: POMDP | MOMDP, convention: EpisodeOpening) -> None:
        self._began = time.process_time()
        self._joint = model.joint if isinstance(model, MOMDP) else model
        if self._joint.discount >= 1:
            raise PlanningError("SARSOP needs a discount below 1; this model's is 1")
        starts = start_beliefs(model, convention)
        self._model = compile_model(self._joint, starts)
        self._search = _allocate(self._model)
        self._prune_alphas_at, self._prune_points_at = 100, 500
        self._spread = False  # whether paths keep away from beliefs they have passed
        roots, weights = [], []
        for start in starts:
            c, belief, mass = restrict(self._model, start.belief)
            if c >= 0:
                self._reserve(1)
                roots.append(kernels.add_sampled(self._model, self._search, c, belief))
                weights.append(start.weight * mass)
        self._roots, self._weights = np.array(roots, dtype=np.int64), np.array(weights)
        for root in self._roots:
            self._reserve(1)
            kernels.backup(self._model, self._search, root)

    @property
    def seconds(self) -> float:
        """CPU time since the search was made."""
        return time.process_time() - self._began

    @property
    def backups(self) -> int:
        """Work done so far: beliefs backed up."""
        return int(self._search.counts[kernels.BACKUPS])

    def progress(self) -> Progress:
        """Return the bounds and sizes reached."""
        lower, upper = self._root_bounds()
        n_alphas, n_slots = (self._search.counts[k] for k in (kernels.ALPHAS, kernels.SLOTS))
        return Progress(
            lower=float(self._weights @ lower),
            upper=float(self._weights @ upper),
            seconds=self.seconds,
            vectors=int(self._search.alphas["alive"][:n_alphas].sum()),
            beliefs=int(self._search.slots["alive"][:n_slots].sum()),
            trials=int(self._search.counts[kernels.TRIALS]),
            backups=self.backups,
        )

    def trials(self, precision: float) -> Iterator[None]:
        """Run trials until the gap at the start is at most ``precision``; yields after each.

        Where the discount is near 1, a path may go round among a few beliefs, and once their bounds agree with
        each other it adds nothing: the next one would be the same. So after a trial that adds nothing, paths
        keep away from beliefs they have passed, and the next trial aims at half as large an improvement.

        Raises
        ------
        PlanningError
            ``precision`` is not positive, or finer than double precision allows for this model's values.
        """
        finest = 10 * kernels.RELATIVE_IMPROVEMENT * self._search.scale
        if not precision >= finest:
            raise PlanningError(
                f"precision {precision:g} is impossible: values of this model are known to about {finest:.1g}"
            )
        share = TRIAL_TARGET
        while True:
            lower, upper = self._root_bounds()
            excess = self._weights * (upper - lower)
            gap = float(excess.sum())
            if gap <= precision:
                return
            chosen = int(excess.argmax())
            target = max(precision, share * gap) * float(excess[chosen]) / gap / self._weights[chosen]
            if self._trial(chosen, lower[chosen], target):
                share = TRIAL_TARGET
            else:
                self._spread, share = True, (1 + share) / 2
            self._prune_if_due()
            yield

    def _trial(self, root: int, lower: float, target: float) -> bool:
        """Run a trial that aims to close a root's gap to ``target``; return whether it added to a bound."""
        self._reserve(self._search.path.size)
        additions = [kernels.ALPHAS, kernels.POINTS]
        before = self._search.counts[additions]
        kernels.trial(
            self._model, self._search, self._roots[root], lower, lower + target, target, self._spread
        )
        return bool((self._search.counts[additions] > before).any())

    def policy(self) -> AlphaVectors:
        """Return the vectors that attain the lower bound, over the original states.

        With every vector the set holds those it goes on with, so acting on it earns at least the lower bound
        (as far as the episode limit allows). Vectors of one action for different classes share a row, and
        states that no belief reaches hold the lowest value there is: values hold for reachable beliefs.
        """
        search, model = self._search, self._model
        if not self._roots.size:  # the episode is over before it begins
            return AlphaVectors(
                vectors=np.zeros((1, self._joint.n_states)), actions=np.zeros(1, dtype=np.int64)
            )
        self._root_bounds()
        kept = np.zeros(search.counts[kernels.ALPHAS], dtype=np.bool_)
        kept[search.nodes["alpha"][self._roots]] = True
        kernels.close_over(model, search, kept)
        alphas = search.alphas[: kept.size][kept]
        lowest = min(0.0, float(self._joint.expected_rewards.min())) / (1 - model.discount)
        vectors, actions = [], []
        for a in range(model.n_actions):
            of_action = alphas[alphas["action"] == a]
            rank = _ranks(of_action["belief_class"])
            rows = np.full((int(rank.max(initial=-1)) + 1, self._joint.n_states), lowest)
            for alpha, row in zip(of_action, rank, strict=True):
                c, at = alpha["belief_class"], alpha["at"]
                states = model.states[model.class_first[c] : model.class_first[c + 1]]
                rows[row, states] = search.alpha_entries[at : at + states.size]
            vectors.append(rows)
            actions.append(np.full(len(rows), a, dtype=np.int64))
        return AlphaVectors(vectors=np.concatenate(vectors), actions=np.concatenate(actions))

    def _root_bounds(self) -> tuple[Any, Any]:
        for root in self._roots:
            belief = kernels.belief_of(self._model, self._search, root)
            kernels.refresh_lower(self._search, root, belief)
            kernels.refresh_upper(self._search, root, belief)
        nodes = self._search.nodes[self._roots]
        return nodes["lower"], nodes["upper"]

    def _prune_if_due(self) -> None:
        counts = self._search.counts
        if counts[kernels.ALPHAS] >= self._prune_alphas_at:
            self._prune_alphas()
            alive = int(self._search.alphas["alive"][: counts[kernels.ALPHAS]].sum())
            self._prune_alphas_at = int(counts[kernels.ALPHAS]) + max(int(PRUNE_GROWTH * alive), 100)
        if counts[kernels.POINTS] >= self._prune_points_at:
            self._prune_points()
            alive = int(self._search.points["alive"][: counts[kernels.POINTS]].sum())
            self._prune_points_at = int(counts[kernels.POINTS]) + max(alive, 500)

    def _prune_alphas(self) -> None:
        kernels.mark_alive(self._model, self._search, self._roots)
        kernels.prune_alphas(self._model, self._search, DELTA)

    def _prune_points(self) -> None:
        kernels.prune_points(self._model, self._search)

    def _reserve(self, steps: int) -> None:
        self._search = _reserve(self._model, self._search, steps)


@cache
def warm_up() -> None:
    """Load the kernels, compiling them if this machine has not yet: no part of any search's time."""
    certain = sparse.csr_array(np.eye(2))
    guess = POMDP(
        transitions=(certain, certain),
        observations=(sparse.csr_array(np.full((2, 2), 0.5)),) * 2,
        rewards=np.eye(2)[:, :, None, None],
        start=np.full(2, 0.5),
        reset=np.zeros((2, 2), dtype=np.bool_),
        discount=0.5,
        state_names=("left", "right"),
        action_names=("left", "right"),
        observation_names=("either", "or"),
    )
    search = Sarsop.__new__(Sarsop)
    search._begin(guess, CLEAN)
    for _ in search.trials(1e-3):
        pass
    search._prune_alphas()
    search._prune_points()
    search.policy()


Reason = Literal["precision", "backups", "timeout", "interrupted"]


@dataclass(frozen=True, kw_only=True)
class Solution:
    """What a solve found."""

    policy: AlphaVectors
    progress: Progress
    """Bounds and sizes at the end."""
    reason: Reason
    """Why it ended."""


def solve(
    model: POMDP | MOMDP,
    *,
    precision: float,
    timeout: float,
    backups: int | None = None,
    convention: EpisodeOpening = CLEAN,
    on_progress: Callable[[Progress], None] | None = None,
) -> Solution:
    """Search until the bounds are within ``precision`` of each other.

    It ends earlier after the trial that reaches ``backups`` (work: the same on every run), or after
    ``timeout`` CPU seconds. ``on_progress`` is called about ten times a second. Ctrl-C ends the search and
    keeps what was found.

    Raises
    ------
    PlanningError
        The precision is impossible, a limit is not positive, or the discount is 1.
    """
    if not timeout > 0:
        raise PlanningError(f"timeout {timeout:g} is not positive")
    if backups is not None and backups < 1:
        raise PlanningError(f"{backups} backups are not positive")
    search = Sarsop(model, convention)
    reason: Reason = "precision"
    reported = -np.inf
    try:
        for _ in search.trials(precision):
            seconds = search.seconds
            if on_progress is not None and seconds - reported > 0.1:
                on_progress(search.progress())
                reported = seconds
            if backups is not None and search.backups >= backups:
                reason = "backups"
                break
            if seconds >= timeout:
                reason = "timeout"
                break
    except KeyboardInterrupt:
        reason = "interrupted"
    return Solution(policy=search.policy(), progress=search.progress(), reason=reason)


def _ranks(labels: Ints) -> Ints:
    """Return the number of each occurrence of a label: 0 for its first, 1 for its second, ..."""
    order = np.argsort(labels, kind="stable")
    ordered = labels[order]
    ranks = np.empty(labels.size, dtype=np.int64)
    ranks[order] = np.arange(labels.size) - np.searchsorted(ordered, ordered)
    return ranks


#: Which arrays grow with which count.
_GROWING = {
    kernels.NODES: ("nodes",),
    kernels.BELIEFS: ("beliefs",),
    kernels.SLOTS: ("slots", "q_upper", "edge_first"),
    kernels.EDGES: ("edges",),
    kernels.ALPHAS: ("alphas",),
    kernels.ALPHA_ENTRIES: ("alpha_entries",),
    kernels.ALPHA_NEXT: ("alpha_next",),
    kernels.POINTS: ("points",),
    kernels.SUPPORTS: ("support_state", "support_inverse"),
}


def _needs(model: CompiledModel, steps: int) -> dict[int, int]:
    """Return by how much each count can grow in a trial of that many steps."""
    A, widest = model.n_actions, int(np.diff(model.class_first).max(initial=1))
    children = int(np.diff(model.branch_first[::A]).max(initial=0))
    return {
        kernels.NODES: steps * children + 1,
        kernels.BELIEFS: (steps + 1) * widest,
        kernels.SLOTS: steps + 1,
        kernels.EDGES: steps * children + 1,
        kernels.ALPHAS: steps + 1,
        kernels.ALPHA_ENTRIES: (steps + 1) * widest,
        kernels.ALPHA_NEXT: (steps + 1) * children,
        kernels.POINTS: steps + 1,
        kernels.SUPPORTS: (steps + 1) * widest,
    }


def _reserve(model: CompiledModel, search: kernels.Search, steps: int) -> kernels.Search:
    """Make room for ``steps`` more steps; memory that is not touched yet costs nothing."""
    grown: dict[str, Any] = {}
    for count, need in _needs(model, steps).items():
        for name in _GROWING[count]:
            array = getattr(search, name)
            wanted = int(search.counts[count]) + need
            if array.shape[0] < wanted:
                larger = np.empty((max(wanted, array.shape[0] * 3 // 2), *array.shape[1:]), dtype=array.dtype)
                larger[: array.shape[0]] = array
                grown[name] = larger
    if grown:
        search = search._replace(**grown)
    if 2 * search.nodes.size > search.table.size:
        table = np.full(1 << int(2 * search.nodes.size).bit_length(), -1, dtype=np.int32)
        kernels.rehash(search, table)
        search = search._replace(table=table)
    return search


def longest_path(discount: float) -> int:
    """Return how many steps a trial may take.

    The gap that a trial tolerates grows by 1 / discount with every step. A path that ends before it has grown
    past the gaps it meets ends in a belief that stays as it was, and the next trial may take the same path.
    """
    horizons = int(np.ceil(LONGEST_PATH_HORIZONS / (1 - discount)))
    return min(max(horizons, MIN_LONGEST_PATH), MAX_LONGEST_PATH)


def _allocate(model: CompiledModel) -> kernels.Search:
    """Return a search that knows only the bounds that need no search."""
    L, A, C = model.n_live, model.n_actions, model.n_classes
    informed = fast_informed(model)
    search = kernels.Search(
        counts=np.zeros(11, dtype=np.int64),
        scale=value_scale(model),
        nodes=np.zeros(0, dtype=kernels.NODE),
        beliefs=np.zeros(0),
        table=np.full(2, -1, dtype=np.int32),
        slots=np.zeros(0, dtype=kernels.SLOT),
        q_upper=np.zeros((0, A)),
        edge_first=np.zeros((0, A), dtype=np.int64),
        edges=np.zeros(0, dtype=kernels.EDGE),
        alphas=np.zeros(0, dtype=kernels.ALPHA),
        alpha_entries=np.zeros(0),
        alpha_next=np.zeros(0, dtype=np.int32),
        alpha_newest=np.full(C, -1, dtype=np.int64),
        default_alpha=np.zeros(C, dtype=np.int64),
        corner=informed.max(axis=0),
        informed=informed,
        points=np.zeros(0, dtype=kernels.POINT),
        point_newest=np.full(C, -1, dtype=np.int64),
        support_state=np.zeros(0, dtype=np.int32),
        support_inverse=np.zeros(0),
        bin_sums=np.zeros((2, max(kernels.BINS) ** 2, 3)),
        path=np.zeros(longest_path(model.discount), dtype=np.int64),
        predicted=np.zeros(L),
        backward=np.zeros(L),
        conditioned=np.zeros(int(np.diff(model.class_first).max(initial=1))),
    )
    search = _reserve(model, search, C * A)
    kernels.add_blind_policies(model, search, blind_policies(model))
    return search
