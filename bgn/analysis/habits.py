"""What the paper says that the trained policies do in the robot domains (Section 5.3), asked of single episodes.

Everything but the start is deterministic once a policy takes its most probable action, so that the share of the
possible starts from which it does something is exact. A habit is asked only of the starts that its sentence speaks of.
Where the finger goes is asked of its path: an action that leaves it where it is, such as down at the bottom, adds
nothing to it.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from bgn.domains import top_plate, two_bumps_1d, two_bumps_2d

#: In which share of its cases a policy does what it is said to do, and what "unconditionally" may miss.
AS_A_RULE = 0.9
UNCONDITIONALLY = 0.99


@dataclass(frozen=True)
class Episode:
    """One episode of a robot domain: T actions, the observed parts before and after them, the hidden part."""

    observed: Sequence[int]
    """T + 1 indices x; the last is where the episode ended."""
    hidden: int
    """Index y, which no action changes."""
    actions: Sequence[int]
    success: bool


@dataclass(frozen=True)
class Habit:
    """One thing that a policy is said to do."""

    id: str
    domain: str
    asks: str
    """What is asked of an episode, in one line."""
    concerns: Callable[[Episode], bool]
    """Whether the sentence speaks of such an episode."""
    shows: Callable[[Episode], bool]
    level: float = AS_A_RULE
    """Share of its cases in which a policy that has the habit shows it."""

    @property
    def share_column(self) -> str:
        """Column of the share of the cases in which a policy shows the habit."""
        return f"habit_{self.id}"

    @property
    def cases_column(self) -> str:
        """Column of the number of cases."""
        return f"habit_{self.id}_cases"


def shares(domain_id: str, episodes: Iterable[Episode]) -> Mapping[str, float]:
    """Return, by column, how often a policy shows each habit of a domain, and of how many cases (NaN of none)."""
    episodes = tuple(episodes)
    found = {}
    for habit in HABITS:
        if habit.domain == domain_id:
            cases = [habit.shows(episode) for episode in episodes if habit.concerns(episode)]
            found[habit.share_column] = sum(cases) / len(cases) if cases else float("nan")
            found[habit.cases_column] = float(len(cases))
    return found


def _height(episode: Episode) -> int:
    return episode.hidden + 1


def _path(cells: Sequence[int]) -> list[int]:
    """Return the cells a finger moves through, without those in which it stays."""
    return [cell for cell, _ in itertools.groupby(cells)]


def _levels(episode: Episode) -> list[int]:
    return _path([x // top_plate.BINS for x in episode.observed])


def _past_the_top_and_back(episode: Episode) -> bool:
    height = _height(episode)
    return episode.success and _levels(episode) == [*range(height + 2), height]


def _straight_to_the_top(episode: Episode) -> bool:
    return episode.success and _levels(episode) == [*range(_height(episode) + 1)]


def _bumps(episode: Episode) -> tuple[int, int]:
    return two_bumps_1d.PAIRS[episode.hidden]


def _cells_1d(episode: Episode) -> list[int]:
    return [x // two_bumps_1d.BINS for x in episode.observed]


def _starts_left(episode: Episode) -> bool:
    return _cells_1d(episode)[0] < _bumps(episode)[0]


def _starts_between(episode: Episode) -> bool:
    return _bumps(episode)[0] < _cells_1d(episode)[0] < _bumps(episode)[1]


def _starts_right(episode: Episode) -> bool:
    return _cells_1d(episode)[0] > _bumps(episode)[1]


#: Actions of TwoBumps-1D as letters: a soft finger's are small.
_LETTERS = "lLrR"


def _word(episode: Episode) -> str:
    return "".join(_LETTERS[action] for action in episode.actions)


def _moves_right_first(episode: Episode) -> bool:
    return episode.actions[0] == two_bumps_1d.RIGHT_SOFT


def _stiffens_and_pushes(episode: Episode) -> bool:
    word = _word(episode)
    if not (episode.success and re.fullmatch("r+R+", word)):
        return False
    return _cells_1d(episode)[word.index("R")] >= _bumps(episode)[0]


def _turns_back_at_the_end(episode: Episode) -> bool:
    word = _word(episode)
    if not (episode.success and re.fullmatch("r+[rR]*l+R+", word)):
        return False
    last_place = max(right for _, right in two_bumps_1d.PAIRS)  # beyond it there is nothing to find
    return _cells_1d(episode)[word.index("l")] >= last_place


def _turns_back_softly(episode: Episode) -> bool:
    return episode.success and re.fullmatch("r+l+R+", _word(episode)) is not None


def _cells_2d(episode: Episode) -> list[int]:
    return [x // two_bumps_2d.FLAGS // two_bumps_2d.BINS for x in episode.observed]


def _found_both(episode: Episode) -> int | None:
    """Return after how many actions both bumps have been touched."""
    both = two_bumps_2d.FLAGS - 1
    return next((t for t, x in enumerate(episode.observed) if x % two_bumps_2d.FLAGS == both), None)


def _found_large_first(episode: Episode) -> bool | None:
    """Say which bump was the first to be touched; None where they were not both."""
    found = _found_both(episode)
    return None if not found else episode.observed[found - 1] % two_bumps_2d.FLAGS == 1


def _never_crosses_its_path(episode: Episode) -> bool:
    found = _found_both(episode)
    if found is None:
        return False
    path = _path(_cells_2d(episode)[: found + 1])
    return len(set(path)) == len(path)


def _grasps_at_once(episode: Episode) -> bool:
    found = _found_both(episode)
    return episode.success and found is not None and [*episode.actions[found:]] == [two_bumps_2d.GRASP]


def _goes_straight_back(episode: Episode) -> bool:
    found = _found_both(episode)
    if found is None or not episode.success:
        return False
    side = two_bumps_2d.SIDE
    large, small = (divmod(cell, side) for cell in two_bumps_2d.PAIRS[episode.hidden])
    distance = abs(large[0] - small[0]) + abs(large[1] - small[1])
    return len(_path(_cells_2d(episode)[found:])) == distance + 1


def _always(episode: Episode) -> bool:
    return True


HABITS: tuple[Habit, ...] = (
    Habit(
        "up_then_down",
        "top-plate",
        "TopPlate, under ten plates: up past the top, one down, grasps",
        lambda episode: _height(episode) < top_plate.PLATES,
        _past_the_top_and_back,
    ),
    Habit(
        "counts_plates",
        "top-plate",
        "TopPlate, ten plates: up to the tenth, grasps",
        lambda episode: _height(episode) == top_plate.PLATES,
        _straight_to_the_top,
    ),
    Habit(
        "moves_right_first",
        "two-bumps-1d",
        "TwoBumps-1D: first to the right, softly",
        _always,
        _moves_right_first,
        UNCONDITIONALLY,
    ),
    Habit(
        "pushes_second",
        "two-bumps-1d",
        "TwoBumps-1D, from the left: stiff past one bump, pushes the other",
        _starts_left,
        _stiffens_and_pushes,
    ),
    Habit(
        "turns_at_the_end",
        "two-bumps-1d",
        "TwoBumps-1D, from between: to the end, back softly, pushes stiffly",
        _starts_between,
        _turns_back_at_the_end,
    ),
    Habit(
        "turns_softly",
        "two-bumps-1d",
        "TwoBumps-1D, from the right: right, back softly, pushes stiffly",
        _starts_right,
        _turns_back_softly,
    ),
    Habit(
        "non_intersecting",
        "two-bumps-2d",
        "TwoBumps-2D: no cell twice until both bumps are found",
        _always,
        _never_crosses_its_path,
    ),
    Habit(
        "grasps_at_once",
        "two-bumps-2d",
        "TwoBumps-2D, large bump found last: grasps it at once",
        lambda episode: _found_large_first(episode) is False,
        _grasps_at_once,
    ),
    Habit(
        "shortest_way_back",
        "two-bumps-2d",
        "TwoBumps-2D, small bump found last: shortest way back, grasps",
        lambda episode: _found_large_first(episode) is True,
        _goes_straight_back,
    ),
)


def habit(habit_id: str) -> Habit:
    """Return a habit by its id."""
    return next(habit for habit in HABITS if habit.id == habit_id)
