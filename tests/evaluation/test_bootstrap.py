from collections.abc import Sequence

import numpy as np
import pytest

from huepose.evaluation.bootstrap import Share, difference_intervals, frame_intervals, sign_test


def test_the_interval_of_independent_frames_equals_that_of_the_mean() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(50.0, 20.0, 400)
    low, high = frame_intervals({"x": values}, list(range(400)))["x"]
    assert (low + high) / 2 == pytest.approx(values.mean(), abs=0.3)
    assert high - low == pytest.approx(2 * 1.96 * 20.0 / 20.0, rel=0.1)


def test_instances_of_one_frame_count_as_one_draw() -> None:
    values = np.repeat([0.0, 100.0] * 20, 10)
    alone = frame_intervals({"x": values}, list(range(400)))["x"]
    together = frame_intervals({"x": values}, [k // 10 for k in range(400)])["x"]
    assert together[1] - together[0] == pytest.approx(np.sqrt(10) * (alone[1] - alone[0]), rel=0.15)


def test_fewer_than_two_frames_have_no_interval() -> None:
    assert frame_intervals({"x": np.zeros(0)}, []) == {"x": None}
    assert frame_intervals({"x": np.array([1.0, 2.0])}, ["a", "a"]) == {"x": None}


@pytest.mark.parametrize("frames", [5, 8, 40])
def test_intervals_of_few_frames_cover_the_true_mean_about_as_often_as_stated(frames: int) -> None:
    """In 95 % of draws; with five frames in 92 %, with plain percentiles in 85 %."""
    rng, held = np.random.default_rng(1), 0
    for _ in range(500):
        low, high = frame_intervals({"x": rng.normal(50.0, 20.0, frames)}, range(frames))["x"]
        held += low <= 50.0 <= high
    assert 0.89 < held / 500 < 0.98


def paired_world(
    rng: np.random.Generator, units: int, boxes: int, shift: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rows before and after, `boxes` of each unit. The units vary; the change varies by unit and by box."""
    hard = rng.normal(50.0, 30.0, (units, 1)) + rng.normal(0.0, 5.0, (units, boxes))
    changed = shift + rng.normal(0.0, 6.0, (units, 1)) + rng.normal(0.0, 3.0, (units, boxes))
    return hard.ravel(), (hard + changed).ravel()


def coverage_of(
    worlds: int, rng: np.random.Generator, units: int, boxes: int, drawn: Sequence[int], shift: float = -2.0
) -> float:
    """The share of simulated worlds whose interval covers the true change; `drawn`: the unit of each row."""
    held = 0
    for world in range(worlds):
        before, after = paired_world(rng, units, boxes, shift)
        pairs = {"x": (Share.of(before), Share.of(after))}
        low, high = difference_intervals(pairs, drawn, resamples=1000, seed=world)["x"]
        held += low <= shift <= high
    return held / worlds


@pytest.mark.parametrize(("units", "least"), [(5, 0.88), (8, 0.92), (40, 0.92)])
def test_intervals_of_a_change_cover_the_true_one_about_as_often_as_stated(units: int, least: float) -> None:
    """In 95 % of draws; with five units in 92 %, with plain percentiles in 85 %."""
    number = np.repeat(np.arange(units), 3).tolist()
    assert least < coverage_of(500, np.random.default_rng(units), units, 3, number) < 0.98


def test_intervals_are_too_narrow_if_boxes_are_drawn_as_independent() -> None:
    assert coverage_of(200, np.random.default_rng(3), 12, 5, range(60)) < 0.75


def test_variation_common_to_both_does_not_widen_the_interval_of_the_change() -> None:
    before = np.random.default_rng(0).normal(50.0, 30.0, 50)
    low, high = difference_intervals({"x": (Share.of(before), Share.of(before + 1.5))}, range(50))["x"]
    assert (low, high) == (pytest.approx(1.5), pytest.approx(1.5))


def test_an_unchanged_recall_is_called_worse_about_once_in_forty() -> None:
    """One row in twenty flips, either way: percentile intervals are worst for rare steps."""
    rng, units, worlds = np.random.default_rng(9), 60, 500
    worse = 0
    for world in range(worlds):
        flipped, up = rng.random(units) < 0.05, rng.random(units) < 0.5
        pairs = {"x": (Share.of(100.0 * (flipped & ~up)), Share.of(100.0 * (flipped & up)))}
        _, high = difference_intervals(pairs, range(units), resamples=1000, seed=world)["x"]
        worse += high < 0.0
    assert 0.005 < worse / worlds < 0.045


def test_a_share_may_count_different_rows_before_and_after() -> None:
    """Coverage, for example: of 4 frames, 2 count before and 3 after."""
    before = Share.of(np.array([100.0, 100.0, 0.0, 0.0]), np.array([True, True, False, False]))
    after = Share.of(np.array([100.0, 0.0, 100.0, 0.0]), np.array([True, True, True, False]))
    assert (before.value, after.value) == (100.0, pytest.approx(200.0 / 3.0))
    low, high = difference_intervals({"x": (before, after)}, ["a", "a", "a", "b"])["x"]
    # Draws without the first unit have no row that counts; all others give this difference.
    assert (low, high) == (pytest.approx(-100.0 / 3.0), pytest.approx(-100.0 / 3.0))


def test_one_unit_has_no_interval() -> None:
    rows = Share.of(np.array([1.0, 2.0]))
    assert difference_intervals({"x": (rows, rows)}, ["a", "a"]) == {"x": None}
    none = Share.of(np.array([1.0, 2.0]), np.array([False, False]))
    assert none.value is None
    assert difference_intervals({"x": (none, none)}, ["a", "b"]) == {"x": None}


@pytest.mark.parametrize(
    ("wins", "losses", "p"), [(0, 0, 1.0), (1, 0, 1.0), (5, 0, 0.0625), (0, 6, 0.03125), (2, 8, 0.109375)]
)
def test_the_sign_test_uses_the_binomial_distribution(wins: int, losses: int, p: float) -> None:
    assert sign_test(wins, losses) == pytest.approx(p)
    assert sign_test(losses, wins) == pytest.approx(p)
