"""Two result files with known wins and losses are compared."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from huepose.evaluation.comparison import Change, Comparison, compare
from huepose.evaluation.measured import read_measured, unit_of
from huepose.support.errors import InputError

from .results import write_estimates, write_perception, write_track


def compared(before: Path, after: Path, margin: float = 0.1) -> tuple[Comparison, dict[str, Change]]:
    comparison = compare(read_measured(before), read_measured(after), "set", margin)
    return comparison, {change.figure.key: change for change in comparison.changes}


def answers(wrong: set[int], instances: int = 40, seeds: int = 1) -> dict[tuple[int, int], bool]:
    return {(i, seed): i not in wrong for seed in range(seeds) for i in range(instances)}


def test_a_file_compared_with_itself_is_the_same(tmp_path: Path) -> None:
    path = write_estimates(tmp_path / "a.json", answers({3, 7}))
    comparison, changes = compared(path, path)
    assert comparison.paired == comparison.units == 40
    assert {c.verdict for c in changes.values() if c.figure.judged} == {"same"}
    assert {(c.change, c.interval95) for c in changes.values()} == {(0.0, (0.0, 0.0))}
    assert (comparison.won, comparison.lost, comparison.moved.same) == ([], [], 40)


def test_wins_losses_and_changes_are_counted_correctly(tmp_path: Path) -> None:
    before = write_estimates(tmp_path / "a.json", answers({0, 1, 2}))
    after = write_estimates(tmp_path / "b.json", answers({2, 25}))
    comparison, changes = compared(before, after)
    add = changes["recall_add"]
    assert (add.before, add.after, add.change) == (92.5, 95.0, pytest.approx(2.5))
    assert (add.wins, add.losses, add.verdict) == (2, 1, "open")
    assert add.interval95[0] < 0.0 < add.interval95[1]
    assert add.sign_test_p == 1.0
    # ADD is 10 mm where right and 50 mm where wrong; ADD-S is 10 mm in both.
    assert changes["auc_add"].change == pytest.approx(100.0 * (0.05 - 0.01) / 0.1 / 40)
    assert (changes["recall_adds"].wins, changes["recall_adds"].losses) == (0, 0)
    # Quality is always 0.9, so its mean does not change.
    assert changes["quality"].change == 0.0
    assert changes["brier"].change == pytest.approx((0.01 - 0.81) / 40)
    assert comparison.won == [("000001", 0, 0, 5, 0), ("000001", 0, 1, 5, 0)]
    assert comparison.lost == [("000002", 6, 1, 5, 0)]
    groups = {name: changes[0] for name, changes in comparison.groups.items()}
    assert (groups["000001"].wins, groups["000001"].losses, groups["000001"].change) == (2, 0, 10.0)
    assert (groups["000002"].wins, groups["000002"].losses, groups["000002"].change) == (0, 1, -5.0)


def test_many_losses_are_worse_and_many_wins_are_better(tmp_path: Path) -> None:
    good = write_estimates(tmp_path / "a.json", answers({0}))
    bad = write_estimates(tmp_path / "b.json", answers({0, *range(10, 18)}))
    comparison, changes = compared(good, bad)
    assert [c.figure.key for c in comparison.worse] == ["recall_add", "auc_add"]
    assert changes["recall_add"].sign_test_p == pytest.approx(2 / 2**8)
    assert changes["recall_adds"].verdict == "same"
    comparison, changes = compared(bad, good)
    assert (comparison.worse, changes["recall_add"].verdict) == ([], "better")
    assert compared(good, bad, margin=50.0)[0].worse == []


def test_the_boxes_of_an_instance_are_one_unit(tmp_path: Path) -> None:
    """Two instances lost in four boxes each are two units, not eight."""
    before = write_estimates(tmp_path / "a.json", answers(set(), seeds=4))
    after = write_estimates(tmp_path / "b.json", answers({5, 9}, seeds=4))
    comparison, changes = compared(before, after)
    add = changes["recall_add"]
    assert (comparison.paired, comparison.units, add.losses) == (160, 40, 8)
    assert (add.sign_test_p, add.verdict) == (0.5, "open")
    assert add.interval95[1] == 0.0


def test_a_missing_pose_is_wrong_and_counts_zero_in_auc(tmp_path: Path) -> None:
    before = write_estimates(tmp_path / "a.json", answers(set()))
    after = write_estimates(tmp_path / "b.json", {**answers(set()), (4, 0): None})
    comparison, changes = compared(before, after)
    assert (changes["recall_adds"].losses, changes["auc_adds"].change) == (1, pytest.approx(-90.0 / 40))
    assert (comparison.moved.both, comparison.moved.found, comparison.moved.states) == (39, 1, 1)


def test_rows_that_only_one_file_has_are_listed(tmp_path: Path) -> None:
    before = write_estimates(tmp_path / "a.json", answers(set(), 10))
    after = write_estimates(tmp_path / "b.json", {(i, 0): True for i in range(2, 11)}, method="colorpair")
    comparison, _ = compared(before, after)
    assert (comparison.paired, comparison.settings) == (8, {"method": ("full", "colorpair")})
    assert comparison.only_before == [("000001", 0, 0, 5, 0), ("000001", 0, 1, 5, 0)]
    assert comparison.only_after == [("000001", 2, 2, 5, 0)]


def test_the_motion_of_poses_between_files_is_measured(tmp_path: Path) -> None:
    before = write_estimates(tmp_path / "a.json", answers(set(), 10))
    after = write_estimates(tmp_path / "b.json", answers(set(), 10), x_m=0.002, turn=0.01)
    moved = compared(before, after)[0].moved
    assert (moved.median_mm, moved.largest_mm) == (pytest.approx(2.0), pytest.approx(2.0))
    assert moved.largest_deg == pytest.approx(0.5729577951)
    assert (moved.both, moved.same) == (10, 0)


def test_false_poses_are_counted_by_frame_and_as_a_mean_over_seeds(tmp_path: Path) -> None:
    before = write_estimates(tmp_path / "a.json", answers(set(), seeds=2), [(0, 0), (0, 1), (1, 0)])
    after = write_estimates(tmp_path / "b.json", answers(set(), seeds=2), [(0, 0), (0, 1), (2, 0), (2, 1)])
    change = compared(before, after)[1]["false_per_100_frames"]
    assert (change.before, change.after) == (pytest.approx(15.0), pytest.approx(20.0))
    assert (change.wins, change.losses, change.verdict) == (1, 1, "open")


def test_false_tracking_is_counted_from_the_states(tmp_path: Path) -> None:
    """Two seconds. From one second on the pose is wrong; only the second tracker reports SUSPECT."""
    right = [i < 30 for i in range(60)]
    before = write_track(tmp_path / "a.json", right, ["TRACKING"] * 60, sequences=3)
    after = write_track(tmp_path / "b.json", right, ["TRACKING"] * 30 + ["SUSPECT"] * 30, sequences=3)
    comparison, changes = compared(before, after)
    assert (comparison.paired, comparison.units) == (180, 12)
    false = changes["false_tracking_rate"]
    assert (false.before, false.after, false.wins, false.losses) == (50.0, 0.0, 90, 0)
    assert false.verdict == "better"
    assert (changes["coverage_tracking"].before, changes["coverage_tracking"].after) == (100.0, 50.0)
    assert changes["coverage_tracking"].verdict == "worse"
    assert changes["recall_add"].verdict == "same"
    summary = json.loads((tmp_path / "b.json").read_text())["summary"]
    assert summary["coverage_tracking"] == changes["coverage_tracking"].after
    assert list(comparison.groups) == ["run0", "run1", "run2"]


@pytest.mark.parametrize(("good", "state"), [(True, "SUSPECT"), (False, "TRACKING")])
def test_an_object_that_is_no_longer_confirmed_has_coverage_0(tmp_path: Path, good: bool, state: str) -> None:
    before = write_track(tmp_path / "a.json", [True] * 60, ["TRACKING"] * 60, sequences=3)
    after = write_track(tmp_path / "b.json", [good] * 60, [state] * 60, sequences=3)
    comparison, changes = compared(before, after)
    coverage = changes["coverage_tracking"]
    assert (coverage.before, coverage.after, coverage.verdict) == (100.0, 0.0, "worse")
    assert coverage in comparison.worse
    summary = json.loads((tmp_path / "b.json").read_text())["summary"]
    assert summary["coverage_tracking"] == coverage.after


def test_many_sequences_are_the_units_of_resampling(tmp_path: Path) -> None:
    right, states = [True] * 60, ["TRACKING"] * 60
    path = write_track(tmp_path / "a.json", right, states, sequences=10)
    comparison, _ = compared(path, path)
    assert (comparison.unit, comparison.units) == ("a sequence with all its seeds", 10)


@pytest.mark.parametrize(("sequences", "drawn"), [(9, "half seconds"), (10, "sequences")])
def test_one_file_and_two_draw_the_same_units(tmp_path: Path, sequences: int, drawn: str) -> None:
    right, states = [True] * 20, ["TRACKING"] * 20
    path = write_track(tmp_path / "a.json", right, states, sequences)
    record = json.loads(path.read_text())
    units = unit_of(record["rows"])
    assert record["summary"]["interval95_over"] == units.many == drawn
    comparison, _ = compared(path, path)
    assert (comparison.unit, comparison.units) == (units.one, len(set(units.of)))


def test_half_seconds_are_counted_from_the_first_frame_of_a_sequence() -> None:
    """Timestamps may start at any value."""
    rows = [{"sequence": "run", "stamp_ns": 1_900_000_000 + i * 100_000_000} for i in range(10)]
    assert len(set(unit_of(rows).of)) == 2


def test_a_track_without_pose_is_lost(tmp_path: Path) -> None:
    right = [True] * 60
    before = write_track(tmp_path / "a.json", right, ["TRACKING"] * 60)
    after = write_track(tmp_path / "b.json", right, ["TRACKING"] * 59 + ["LOST"])
    _, changes = compared(before, after)
    assert (changes["recall_add"].losses, changes["auc_adds"].change) == (1, pytest.approx(-1.5))


@pytest.mark.parametrize("sequences", [1, 3])
def test_more_tracked_poses_of_no_instance_are_worse(tmp_path: Path, sequences: int) -> None:
    """A robot acts on them, although no instance has a worse pose."""
    right, states = [True] * 60, ["TRACKING"] * 60
    before = write_track(tmp_path / "a.json", right, states, sequences)
    after = write_track(tmp_path / "b.json", right, states, sequences, phantoms=6)
    comparison, changes = compared(before, after)
    assert changes["phantoms"].change == pytest.approx(10.0 / sequences)
    assert [change.figure.key for change in comparison.worse] == ["phantoms"]
    there = {change.figure.key: change.change for change in comparison.groups["run0"]}
    assert there["phantoms"] == pytest.approx(10.0)
    back, changes = compared(after, before)
    assert (back.worse, changes["phantoms"].verdict) == ([], "better")


def test_changes_of_perception_are_compared(tmp_path: Path) -> None:
    before = write_perception(tmp_path / "a.json", [True] * 10 + [False] * 2, [0])
    after = write_perception(tmp_path / "b.json", [True] * 9 + [False, True, False], [0, 1, 1])
    comparison, changes = compared(before, after)
    found = changes["recall_iou50"]
    assert (found.wins, found.losses, found.change) == (1, 1, 0.0)
    assert (comparison.won, comparison.lost) == ([("000001", 10, 0, 5)], [("000001", 9, 0, 5)])
    assert changes["mask_iou"].after == pytest.approx(80.0)
    assert (changes["false_per_100_frames"].change, comparison.moved) == (pytest.approx(100 * 2 / 12), None)


def test_frames_without_objects_count_among_those_with_false_positives(tmp_path: Path) -> None:
    """Five frames with an object, 95 without; a false positive in eight of these, then in two."""
    before = write_perception(tmp_path / "a.json", [True] * 5, range(10, 18), frames=100)
    after = write_perception(tmp_path / "b.json", [True] * 5, [10, 40], frames=100)
    change = compared(before, after)[1]["false_per_100_frames"]
    assert (change.before, change.after) == (pytest.approx(8.0), pytest.approx(2.0))
    assert (change.wins, change.losses) == (7, 1)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ("[1]", "a JSON list"),
        ('{"stages": []}', "no rows"),
        ('{"rows": [{"variant": "all"}]}', "rows with variant"),
        ('{"rows": [{"scene": "1", "add_m": 0.1}]}', "an incomplete row"),
    ],
)
def test_the_error_names_a_file_that_is_no_result(tmp_path: Path, content: str, found: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(content)
    with pytest.raises(InputError, match=found) as error:
        read_measured(path)
    assert "other.json" in str(error.value)


def test_the_error_names_two_rows_of_one_instance(tmp_path: Path) -> None:
    path = write_perception(tmp_path / "a.json", [True, True])
    record = json.loads(path.read_text())
    path.write_text(json.dumps({**record, "rows": record["rows"] * 2}))
    with pytest.raises(InputError, match="two rows of scene 000001, image 0, instance 0, object 5"):
        read_measured(path)


def test_files_without_common_rows_or_of_different_kinds_are_refused(tmp_path: Path) -> None:
    first = write_estimates(tmp_path / "a.json", {(1, 0): True})
    second = write_estimates(tmp_path / "b.json", {(2, 0): True})
    with pytest.raises(InputError, match="no row in common"):
        compared(first, second)
    with pytest.raises(InputError, match="two of the same kind"):
        compared(first, write_perception(tmp_path / "c.json", [True]))
