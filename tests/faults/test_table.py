"""Every fault of the documentation is injected somewhere, and the checks on a pipeline can fail."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from huepose_services.chaos.faults import FAULTS
from huepose_services.chaos.outcome import Outcome, back_after, table
from huepose_services.chaos.system import (
    LivePipeline,
    SeenPose,
    gaps_s,
    longest_wrong,
    may_be_wrong,
    too_old,
    wrong,
)
from tests.faults import test_live

ROOT = Path(__file__).parents[2]


def test_the_documentation_says_where_each_of_the_25_faults_is_injected():
    page = (ROOT / "docs" / "reliability.md").read_text()
    page = page[page.index("## The faults") : page.index("## Measured")]
    rows = dict(re.findall(r"^\| (\d+) \| .* \| (.*) \|$", page, re.MULTILINE))
    assert sorted(map(int, rows)) == list(range(1, 26))
    live = {fault.number for fault in FAULTS}
    for number, where in rows.items():
        files = re.findall(r"`(tests/[\w/.]+)`", where)
        assert files or "chaos" in where, number
        assert ("chaos" in where) == (int(number) in live), number
        for name in files:
            assert (ROOT / name).exists(), name


def test_each_attack_in_the_documentation_has_a_test():
    page = (ROOT / "docs" / "reliability.md").read_text()
    page = page[page.index("## Attacks") : page.index("### The sandbox")]
    rows = re.findall(r"^\|.*\|$", page, re.MULTILINE)[2:]
    assert len(rows) == 21
    for row in rows:
        tests = re.findall(r"`(tests/[\w/.]+)::(\w+)`", row)
        assert tests, row
        for file, name in tests:
            assert f"def {name}(" in (ROOT / file).read_text(), name


def test_the_faults_of_test_live_exist():
    assert set(test_live.SHORT) <= {fault.name for fault in FAULTS}
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)


def pose(at, state="TRACKING", error=0.01, age_ms=20.0, frame=0):
    return SeenPose(at, age_ms, age_ms, "tea_box", 0, (1, frame), state, error)


def test_only_tracking_poses_count_as_wrong_or_too_old():
    poses = [pose(0.0), pose(0.1, error=0.11), pose(0.2, "SUSPECT", error=0.5), pose(0.3, error=None)]
    assert wrong(poses) == 1
    assert too_old([pose(0.0, age_ms=302.0), pose(0.1, "SUSPECT", age_ms=900.0), pose(0.2)], 300.0) == 1


def test_wrong_poses_in_a_row_are_counted_per_instance():
    wrong_one = pose(0.0, error=0.2)
    assert longest_wrong([wrong_one, wrong_one, pose(0.1), wrong_one]) == 2
    assert longest_wrong([wrong_one, pose(0.1, "SUSPECT", error=0.2), wrong_one]) == 1
    other = replace(wrong_one, instance=1)
    assert longest_wrong([wrong_one, other, wrong_one, other, other]) == 3


def test_as_many_poses_may_be_wrong_as_their_quality_allows():
    """Of 100 poses at 0.98, two wrong ones are expected; nine or more occur in 0.02 % of cases, eight in
    0.1 %."""
    unsure = [replace(pose(0.1 * k), quality=0.98) for k in range(100)]
    assert may_be_wrong(unsure) == 8
    assert may_be_wrong([replace(p, state="SUSPECT") for p in unsure]) == 0
    assert may_be_wrong([pose(0.0)] * 50) == 0  # sure of it: none


@pytest.mark.parametrize(
    ("times", "back"), [([0.1 * k for k in range(100)], 0.0), ([0.1, 3.0, 3.1, 3.3], 3.0), ([0.1], None)]
)
def test_time_until_poses_are_back(times, back):
    assert back_after([pose(at) for at in times], 0.0, max(times[-1] + 0.1, 1.0)) == back


def test_gaps_are_between_frames_not_messages():
    seen = [pose(1.0, frame=1), pose(1.01, frame=1), pose(2.0, frame=2)]
    assert gaps_s(seen, 0.5, 2.5) == pytest.approx([0.5, 1.0, 0.5])


def test_the_table_names_the_checks_that_failed():
    text = table([Outcome(1, "camera unplugged", 0.04, 2.5), Outcome(9, "half", broken=["2 too old"])])
    assert "| 1 | camera unplugged | 0.0 s | 2.5 s |" in text
    assert "NO: 2 too old" in text


def test_a_fault_is_over_when_all_workers_report_that_they_work():
    """A worker that hangs keeps its liveliness token, and the others go on: only its missing health shows
    it."""
    system = object.__new__(LivePipeline)
    system.workers = ("camera", "estimator")
    system.reader = SimpleNamespace(live={"a/live/camera", "a/live/estimator"})
    system.poses = [replace(pose(time.monotonic() + 60.0), name=name) for name in ("cup", "box", "can")]
    said = {"state": "ready", "publish_ns": time.monotonic_ns() + 60_000_000_000}
    system.health = {"camera": SimpleNamespace(**said), "estimator": SimpleNamespace(**said)}
    assert system.wait_until_steady(3, within_s=1.0, for_s=0.0)
    for change in ({"publish_ns": time.monotonic_ns()}, {"state": "starting"}):
        system.health["estimator"] = SimpleNamespace(**{**said, **change})
        assert not system.wait_until_steady(3, within_s=0.2, for_s=0.0)
