"""When frames are due."""

from types import SimpleNamespace

import pytest

from huepose_services.camera.schedule import Schedule
from huepose_services.runtime.clock import SECOND
from huepose_services.runtime.config import CameraConfig

STAMPS = {3: 0, 4: 40_000_000, 7: 140_000_000, 9: 150_000_000}


def _source(stamps=STAMPS):
    return SimpleNamespace(image_ids=tuple(stamps), stamp_ns=stamps.__getitem__)


def _schedule(stamps=STAMPS, **camera):
    return Schedule(_source(stamps), CameraConfig(source="bop", **camera), 1000)


def test_recorded_times_are_kept_exactly():
    schedule = _schedule(rate="recorded", once=True)
    assert [schedule.due_ns(i) - 1000 for i in range(4)] == list(STAMPS.values())


def test_once_ends_and_a_loop_does_not():
    once, loop = _schedule(once=True), _schedule()
    assert [once.image(i) for i in range(5)] == [3, 4, 7, 9, None]
    assert [loop.image(i) for i in range(6)] == [3, 4, 7, 9, 3, 4]


def test_the_first_pass_has_the_images_numbers_and_later_ones_new_ones():
    schedule = _schedule()
    ids = [schedule.frame_id(i) for i in range(12)]
    assert ids[:4] == [3, 4, 7, 9]
    assert ids == sorted(set(ids))


def test_a_loop_at_a_fixed_rate_never_drifts():
    schedule = _schedule(rate=30.0)
    for i in (1, 4, 4001):
        assert schedule.due_ns(i) - 1000 == pytest.approx(i * SECOND / 30, abs=i / 4 + 1)


def test_time_never_goes_back_and_a_recorders_jump_is_cut():
    schedule = _schedule({0: 5, 1: 3, 2: 10**15}, rate="recorded")
    dues = [schedule.due_ns(i) for i in range(6)]
    assert dues == sorted(dues)
    assert dues[2] - dues[1] == 10 * SECOND


def test_a_loop_at_recorded_times_goes_on_with_the_usual_gap():
    schedule = _schedule({0: 0, 1: 30, 2: 60, 3: 90}, rate="recorded")
    assert [schedule.due_ns(i) - 1000 for i in (3, 4, 5)] == [90, 120, 150]


def test_postponing_moves_only_what_is_to_come():
    schedule = _schedule(rate="recorded")
    schedule.postpone(500)
    assert schedule.due_ns(1) == 1000 + 500 + STAMPS[4]
