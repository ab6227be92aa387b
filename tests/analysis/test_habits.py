from __future__ import annotations

import itertools
import math

import pytest

from bgn.analysis import habits
from bgn.analysis.habits import Episode
from bgn.domains import top_plate, two_bumps_1d, two_bumps_2d


def stack(height: int, levels: list[int], success: bool = True) -> Episode:
    """Return an episode of TopPlate that goes through these levels and ends with a grasp."""
    moves = [top_plate.UP if b >= a and b > 0 else top_plate.DOWN for a, b in itertools.pairwise(levels)]
    observed = [level * top_plate.BINS + top_plate.NEUTRAL for level in (*levels, levels[-1])]
    return Episode(observed, height - 1, [*moves, top_plate.GRASP], success)


def rail(pair: tuple[int, int], cells: list[int], word: str, success: bool = True) -> Episode:
    """Return an episode of TwoBumps-1D through these cells; small letters are soft."""
    observed = [cell * two_bumps_1d.BINS + two_bumps_1d.NEUTRAL for cell in cells]
    return Episode(
        observed, two_bumps_1d.PAIRS.index(pair), ["lLrR".index(letter) for letter in word], success
    )


def plane(pair: tuple[int, int], cells: list[int], success: bool = True) -> Episode:
    """Return an episode of TwoBumps-2D through these cells that ends with a grasp."""
    flags, observed = 0, []
    for cell in cells:
        flags |= (cell == pair[0]) * 1 | (cell == pair[1]) * 2
        observed.append((cell * two_bumps_2d.BINS + two_bumps_2d.NEUTRAL) * two_bumps_2d.FLAGS + flags)
    actions = [two_bumps_2d.RIGHT] * (len(cells) - 1) + [
        two_bumps_2d.GRASP
    ]  # which way is read off the cells
    return Episode([*observed, observed[-1]], two_bumps_2d.PAIRS.index(pair), actions, success)


def shown(habit_id: str, episode: Episode) -> bool | None:
    """Say whether an episode shows a habit; None where it is no case of it."""
    habit = habits.habit(habit_id)
    return habit.shows(episode) if habit.concerns(episode) else None


def test_top_plate() -> None:
    assert shown("up_then_down", stack(3, [0, 1, 2, 3, 4, 3]))
    assert shown("up_then_down", stack(3, [0, 0, 1, 2, 3, 4, 3]))  # down at the bottom moves nothing
    assert not shown("up_then_down", stack(3, [0, 1, 2, 3, 4, 3, 2, 3]))  # looks again
    assert not shown("up_then_down", stack(3, [0, 1, 2, 3, 4, 3], success=False))
    assert shown("up_then_down", stack(10, [0, *range(1, 11)])) is None
    assert shown("counts_plates", stack(10, [0, *range(1, 11)]))
    assert not shown("counts_plates", stack(10, [0, *range(1, 12), 10]))  # feels for an eleventh
    assert shown("counts_plates", stack(3, [0, 1, 2, 3])) is None


def test_two_bumps_1d() -> None:
    assert shown("moves_right_first", rail((4, 8), [2, 3], "r"))
    assert not shown("moves_right_first", rail((4, 8), [2, 3], "R"))
    assert shown("pushes_second", rail((4, 8), [2, 3, 4, 5, 6, 7, 8, 8], "rrrRRRR"))
    assert not shown(
        "pushes_second", rail((4, 8), [2, 3, 4, 5, 6, 7, 8, 8], "rRRRRRR")
    )  # stiff before the first
    assert not shown("pushes_second", rail((4, 8), [2, 3, 4, 4], "rrR", success=False))
    assert shown("pushes_second", rail((4, 8), [6, 7, 8, 8], "rrR")) is None  # starts between them
    between = [7, 8, 9, 10, 11, 12, 13, 14, 13, 12, 11, 10, 9, 8, 7, 8, 8]
    assert shown("turns_at_the_end", rail((4, 8), between, "r" * 7 + "l" * 7 + "RR"))
    early = [7, 8, 9, 10, 9, 8, 7, 8, 8]
    assert not shown("turns_at_the_end", rail((4, 8), early, "rrrlllRR"))  # a second one may still lie ahead
    assert not shown("turns_at_the_end", rail((4, 8), between, "r" * 7 + "L" * 7 + "RR"))
    assert shown("turns_softly", rail((4, 8), [10, 11, 10, 9, 8, 7, 8, 8], "rllllRR"))
    assert not shown("turns_softly", rail((4, 8), [10, 9, 8, 7, 8, 8], "lllRR"))  # not to the right first
    assert shown("turns_softly", rail((4, 8), [2, 3], "r")) is None


def test_two_bumps_2d() -> None:
    # Cells 0 1 2 3 / 4 5 6 7 / ...: large at 2, small at 10.
    found = plane((2, 10), [11, 10, 9, 5, 1, 2])
    assert shown("non_intersecting", found)
    assert shown("grasps_at_once", found)
    assert shown("shortest_way_back", found) is None
    assert not shown("non_intersecting", plane((2, 10), [11, 10, 9, 10, 6, 2]))
    assert not shown("non_intersecting", plane((2, 10), [11, 7], success=False))  # never finds them
    assert not shown("grasps_at_once", plane((2, 10), [11, 10, 6, 2, 1, 2]))
    assert shown("shortest_way_back", plane((2, 10), [3, 2, 6, 10, 6, 2]))
    assert shown("shortest_way_back", plane((2, 10), [3, 2, 6, 10, 10, 6, 2]))  # the border refuses a move
    assert not shown("shortest_way_back", plane((2, 10), [3, 2, 6, 10, 9, 5, 1, 2]))
    assert not shown("shortest_way_back", plane((2, 10), [3, 2, 6, 10, 6, 2], success=False))


def test_shares_and_their_cases() -> None:
    episodes = [stack(3, [0, 1, 2, 3, 4, 3]), stack(4, [0, 1, 2, 3, 4]), stack(5, [0, 1, 2, 3, 4, 5, 6, 5])]
    found = habits.shares("top-plate", episodes)
    assert found["habit_up_then_down"] == pytest.approx(2 / 3)
    assert found["habit_up_then_down_cases"] == 3
    assert math.isnan(found["habit_counts_plates"])
    assert found["habit_counts_plates_cases"] == 0
    assert habits.shares("hallway", []) == {}
