"""Every fault of the list is injected somewhere, and what must hold is asked in words that can be false."""

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


def test_each_of_the_25_is_in_the_table_of_the_manual_with_where_it_is_injected():
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


def test_each_attack_of_the_manual_is_a_test():
    page = (ROOT / "docs" / "reliability.md").read_text()
    page = page[page.index("## Attacks") : page.index("### The sandbox")]
    rows = re.findall(r"^\|.*\|$", page, re.MULTILINE)[2:]
    assert len(rows) == 21
    for row in rows:
        tests = re.findall(r"`(tests/[\w/.]+)::(\w+)`", row)
        assert tests, row
        for file, name in tests:
            assert f"def {name}(" in (ROOT / file).read_text(), name


def test_the_short_ones_are_among_all():
    assert set(test_live.SHORT) <= {fault.name for fault in FAULTS}
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)


def pose(at, state="TRACKING", error=0.01, age_ms=20.0, frame=0):
    return SeenPose(at, age_ms, age_ms, "tea_box", 0, (1, frame), state, error)


def test_wrong_and_old_poses_to_act_on_are_counted_and_others_are_not():
    poses = [pose(0.0), pose(0.1, error=0.11), pose(0.2, "SUSPECT", error=0.5), pose(0.3, error=None)]
    assert wrong(poses) == 1
    assert too_old([pose(0.0, age_ms=302.0), pose(0.1, "SUSPECT", age_ms=900.0), pose(0.2)], 300.0) == 1


def test_wrong_poses_in_a_row_are_those_of_one_instance():
    wrong_one = pose(0.0, error=0.2)
    assert longest_wrong([wrong_one, wrong_one, pose(0.1), wrong_one]) == 2
    assert longest_wrong([wrong_one, pose(0.1, "SUSPECT", error=0.2), wrong_one]) == 1
    other = replace(wrong_one, instance=1)
    assert longest_wrong([wrong_one, other, wrong_one, other, other]) == 3


def test_as_many_may_be_wrong_as_they_say():
    """Of 100 at 0.98 two are to be expected; nine or more come about in 0.02 % of cases, eight in 0.1 %."""
    unsure = [replace(pose(0.1 * k), quality=0.98) for k in range(100)]
    assert may_be_wrong(unsure) == 8
    assert may_be_wrong([replace(p, state="SUSPECT") for p in unsure]) == 0
    assert may_be_wrong([pose(0.0)] * 50) == 0  # sure of it: none


@pytest.mark.parametrize(
    ("times", "back"), [([0.1 * k for k in range(100)], 0.0), ([0.1, 3.0, 3.1, 3.3], 3.0), ([0.1], None)]
)
def test_when_poses_were_back(times, back):
    assert back_after([pose(at) for at in times], 0.0, max(times[-1] + 0.1, 1.0)) == back


def test_gaps_are_between_frames_not_messages():
    seen = [pose(1.0, frame=1), pose(1.01, frame=1), pose(2.0, frame=2)]
    assert gaps_s(seen, 0.5, 2.5) == pytest.approx([0.5, 1.0, 0.5])


def test_the_table_says_what_did_not_hold():
    text = table([Outcome(1, "camera unplugged", 0.04, 2.5), Outcome(9, "half", broken=["2 too old"])])
    assert "| 1 | camera unplugged | 0.0 s | 2.5 s |" in text
    assert "NO: 2 too old" in text


def test_all_workers_have_to_say_that_they_work_before_a_fault_is_over():
    """One that hangs keeps its token, and others track on: it is seen by its silence alone."""
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
