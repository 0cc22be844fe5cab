"""What the loop asks for and when, on a clock that the test turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.reinit import ObjectSlot, ReinitConfig, ReinitLoop
from huepose.support.errors import InputError
from huepose.tracking.types import State

from .conftest import MS, asked, estimate, pose, result, track


def test_first_request_asks_for_what_was_never_seen() -> None:
    loop = ReinitLoop(objects=[("mug", 2)])
    request = loop.tick(0, [])
    assert asked(request) == [("mug", None)]
    assert request is not None
    assert request.objects[0].wanted == 2
    assert request.objects[0].prior is None
    assert [(s.object, s.missing) for s in loop.searching()] == [("mug", 2)]


def test_requests_come_at_the_period_and_one_at_a_time() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    assert loop.tick(250 * MS, []) is None, "one in flight"
    loop.answer(100 * MS, result(first, 0))
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    loop.answer(100 * MS, result(first, 0))
    assert loop.tick(199 * MS, []) is None, "not due yet"
    assert loop.tick(200 * MS, []) is not None


def test_lost_first_then_doubtful_then_stalest() -> None:
    loop = ReinitLoop(objects=[("a", 1), ("b", 1), ("c", 1), ("d", 1)])
    tracks = [track("a"), track("b", state=State.SUSPECT), track("c", state=State.LOST), track("d")]
    first = loop.tick(0, tracks)
    assert asked(first) == [("c", None), ("b", 0)]
    loop.answer(50 * MS, result(first, 0, estimate("c")))
    tracks = [track("a"), track("b"), track("c", applied=1), track("d")]
    second = loop.tick(200 * MS, tracks)
    assert asked(second) == [("a", 0), ("d", 0)], "never looked at before those that were"


def test_objects_that_are_nowhere_do_not_starve_the_others() -> None:
    loop = ReinitLoop(objects=[("gone_1", 1), ("gone_2", 1), ("here", 1)])
    seen: list[int] = []
    for k in range(15):
        request = loop.tick(k * 200 * MS, [track("here", stamp_ms=k * 200)])
        names = [name for name, _ in asked(request)]
        assert "gone_1" in names or "gone_2" in names
        if "here" in names:
            seen.append(k)
        loop.answer(k * 200 * MS + 50 * MS, result(request, k * 200))
    assert len(seen) >= 2
    assert max(np.diff(seen)) <= 5, "looked at every second"


def test_priors_carry_what_was_published() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    velocity = np.array([0.1, 0, 0, 0, 0, 1.0])
    t = track(velocity=velocity, stamp_ms=40)
    request = loop.tick(0, [t])
    assert request is not None
    prior = request.objects[0].prior
    assert prior is not None
    assert prior.stamp_ns == 40 * MS
    np.testing.assert_array_equal(prior.velocity, velocity)
    ahead = prior.predicted(140 * MS)
    np.testing.assert_allclose(ahead[:3, 3], pose()[:3, 3] + [0.01, 0, 0], atol=1e-12)
    assert se3.rotation_angle(ahead, pose()) == pytest.approx(0.1)


def test_what_is_on_its_way_is_not_asked_for_again() -> None:
    loop = ReinitLoop(objects=[("mug", 1), ("cup", 1)])
    request = loop.tick(0, [])
    loop.answer(100 * MS, result(request, 10, estimate("mug")))
    assert asked(loop.tick(200 * MS, [])) == [("cup", None)]


def test_removed_objects_are_not_asked_for() -> None:
    loop = ReinitLoop(objects=[("mug", 1), ("cup", 1)])
    loop.remove("mug")
    request = loop.tick(0, [])
    assert asked(request) == [("cup", None)]
    assert loop.answer(MS, result(request, 0, estimate("mug"))) == []


def test_configuration_is_checked() -> None:
    with pytest.raises(InputError, match="deadline_ms"):
        ReinitConfig(deadline_ms=0)
    with pytest.raises(InputError, match="least_quality"):
        replace(ReinitConfig(), least_quality=0.95)
    with pytest.raises(InputError, match="max_instances"):
        ObjectSlot("mug", 0)
