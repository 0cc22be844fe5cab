"""Faults of a camera's images are reported soon, and only while they last."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from huepose.geometry import Camera
from huepose_services.camera.condition import CHANGE_SAID_NS, Condition
from huepose_services.camera.live import Shot

SECOND = 1_000_000_000
CAMERA = Camera(60.0, 60.0, 31.5, 23.5, 64, 48)
RATE_HZ = 30.0
FARTHEST_M = 6.5


def shot(at_ns, **changes):
    noise = np.random.default_rng(at_ns % 2**32).integers(90, 110, (48, 64, 3))
    good = Shot(
        noise.astype(np.uint8),
        np.full((48, 64), 0.7, np.float32),
        CAMERA,
        at_ns,
        at_ns,
        at_ns,
        depth_ns=at_ns,
    )
    return replace(good, **changes)


def said_after(condition, seconds, change=lambda one: one, rate_hz=RATE_HZ, start_s=0.0, counted=0):
    """Feeds images; gives the complaints by kind, each with the time at which it first came."""
    first = {}
    for k in range(int(seconds * rate_hz)):
        now = round((start_s + k / rate_hz) * SECOND)
        condition.look(change(shot(now)), now)
        condition.count(counted + k, now)
        for kind, text in condition.complaints(now).items():
            first.setdefault(kind, (k / rate_hz, text))
    return first


def test_good_images_give_no_complaint():
    assert said_after(Condition(RATE_HZ, FARTHEST_M), 20.0) == {}
    assert said_after(Condition(RATE_HZ, FARTHEST_M), 20.0, rate_hz=0.9 * RATE_HZ) == {}


def holes(one):
    """Only each eighth column has depth: more than of a broken sensor, less than of a good one."""
    depth = np.zeros_like(one.depth)
    depth[:, ::8] = 0.7
    return replace(one, depth=depth)


@pytest.mark.parametrize(
    ("kind", "words", "change"),
    [
        ("dark", "its image is black", lambda one: replace(one, color=one.color // 10)),
        ("depth", "no depth: under 1 %", lambda one: replace(one, depth=np.zeros_like(one.depth))),
        ("depth", "no depth: under 1 %", lambda one: replace(one, depth=np.full_like(one.depth, np.nan))),
        ("depth", "no depth: under 1 %", lambda one: replace(one, depth=np.full_like(one.depth, np.inf))),
        (
            "depth",
            "half of it farther than 7 m, and is not sent: is the depth scale right?",
            lambda one: replace(one, depth=10.0 * one.depth),
        ),
        (
            "apart",
            "depth is 67 ms older than colour",
            lambda one: replace(one, depth_ns=one.device_ns - 66_700_000),
        ),
        (
            "apart",
            "depth is 40 ms newer than colour",
            lambda one: replace(one, depth_ns=one.device_ns + 40_000_000),
        ),
    ],
)
def test_each_fault_is_named_within_a_second_and_forgotten_when_it_is_over(kind, words, change):
    condition = Condition(RATE_HZ, FARTHEST_M)
    said = said_after(condition, 3.0, change)
    assert list(said) == [kind]
    assert 0.4 < said[kind][0] < 1.0
    assert words in said[kind][1]
    assert said_after(condition, 1.0, start_s=3.0, counted=90) == {}


def grey(one):
    return replace(one, color=np.repeat(one.color[..., :1], 3, axis=2))


def test_images_without_colour_are_named_only_if_they_last():
    condition = Condition(RATE_HZ, FARTHEST_M)
    assert said_after(condition, 1.5, grey) == {}
    assert said_after(condition, 0.5, start_s=1.5, counted=45) == {}
    said = said_after(condition, 3.0, grey, start_s=2.0, counted=60)
    assert list(said) == ["grey"]
    assert 1.9 < said["grey"][0] < 2.2
    assert "its image has no colour" in said["grey"][1]
    assert said_after(condition, 1.0, start_s=5.0, counted=150) == {}


def test_a_falling_rate_is_stated_from_images_after_the_fall_alone():
    condition = Condition(RATE_HZ, FARTHEST_M)
    assert said_after(condition, 3.0) == {}
    said = said_after(condition, 3.0, rate_hz=12.0, start_s=3.0, counted=90)
    assert said["rate"][0] < 1.5
    assert "it gives 12 images a second instead of 30" in said["rate"][1]
    again = said_after(condition, 3.0, start_s=6.0, counted=126)
    assert condition.complaints(9 * SECOND) == {}, again


@pytest.mark.parametrize("rate_hz", [RATE_HZ, 0.85 * RATE_HZ])
def test_a_camera_that_gives_no_more_images_is_not_called_slow(rate_hz):
    condition = Condition(RATE_HZ, FARTHEST_M)
    assert said_after(condition, 3.0, rate_hz=rate_hz) == {}
    for k in range(60):  # the worker goes on counting, and no image comes
        now = 3 * SECOND + k * SECOND // 20
        condition.count(int(3 * rate_hz), now)
        assert condition.complaints(now) == {}


def test_a_rate_below_that_of_the_workers_checks_is_stated_correctly():
    condition = Condition(RATE_HZ, FARTHEST_M)
    assert said_after(condition, 3.0) == {}
    said = []
    for k in range(60):  # two a second
        now = 3 * SECOND + k * SECOND // 20
        condition.count(90 + k // 10, now)
        said += [(now / SECOND - 3.0, text) for text in condition.complaints(now).values()]
    assert said[0][0] < 2.0
    assert "it gives 2 images a second instead of 30" in said[0][1]


def rates_said(asked_hz, gives_hz, seconds, condition=None, from_s=0.0):
    """The complaints about the rate of a camera, each with its time; its images are counted 20 times a
    second."""
    condition, said = condition or Condition(asked_hz, FARTHEST_M), []
    for k in range(int(20 * seconds)):
        at_s = from_s + k / 20
        condition.count(1 + int(at_s * gives_hz + 1e-6), round(at_s * SECOND))
        said += [(at_s, text) for text in condition.complaints(round(at_s * SECOND)).values()]
    return said


@pytest.mark.parametrize(
    ("asked_hz", "gives_hz", "stated", "within_s"),
    [(30.0, 1.0, "1", 6.0), (30.0, 0.6, "0.", 12.0), (1.0, 0.5, "0.5", 15.0), (0.5, 0.25, "0.25", 30.0)],
)
def test_a_rate_of_one_image_a_second_or_less_is_named_all_the_time(asked_hz, gives_hz, stated, within_s):
    said = rates_said(asked_hz, gives_hz, 40.0)
    assert said[0][0] < within_s
    assert f"it gives {stated}" in said[0][1]
    assert f"images a second instead of {asked_hz:g}" in said[0][1]
    assert len(said) == round(20 * (40.0 - said[0][0])), "it is said all the time"


@pytest.mark.parametrize(("asked_hz", "gives_hz"), [(1.0, 1.0), (1.0, 0.9), (0.5, 0.45), (2.0, 1.8)])
def test_a_slow_camera_at_its_configured_rate_gives_no_complaint(asked_hz, gives_hz):
    assert rates_said(asked_hz, gives_hz, 60.0) == []


def test_an_image_with_depth_of_another_time_is_not_used():
    condition = Condition(RATE_HZ, FARTHEST_M)
    assert condition.look(shot(SECOND), SECOND)
    # Up to about half a period: sensors that are not synchronised. Nearly a whole one: another image's depth.
    assert condition.look(shot(SECOND, depth_ns=SECOND - 20_000_000), SECOND)
    assert not condition.look(shot(SECOND, depth_ns=SECOND - 30_000_000), SECOND)
    assert condition.look(shot(SECOND, depth_ns=None), SECOND), "an unknown time of depth is no fault"


def test_one_bad_image_gives_no_complaint():
    condition = Condition(RATE_HZ, FARTHEST_M)
    bad = iter([False] * 30 + [True] + [False] * 59)
    assert (
        said_after(condition, 3.0, lambda one: replace(one, color=one.color * 0) if next(bad) else one) == {}
    )


def test_another_size_or_focal_length_is_reported_for_a_while():
    condition = Condition(RATE_HZ, FARTHEST_M)
    condition.look(shot(SECOND), SECOND)
    condition.look(shot(2 * SECOND, camera=replace(CAMERA, fx=90.0)), 2 * SECOND)
    assert "from 64 x 48, fx 60.0 to 64 x 48, fx 90.0" in condition.complaints(2 * SECOND)["change"]
    assert condition.complaints(2 * SECOND + CHANGE_SAID_NS) == {}
    condition.look(shot(3 * SECOND, camera=replace(CAMERA, cx=31.500001)), 3 * SECOND)
    text = condition.complaints(3 * SECOND)["change"]
    assert "from 64 x 48, fx 90.0, cx 31.5 to 64 x 48, fx 60.0, cx 31.500001" in text
    condition.reopened()
    condition.look(shot(3 * SECOND), 3 * SECOND)
    assert condition.complaints(3 * SECOND) == {}


def test_holes_are_not_reported_as_missing_depth():
    assert said_after(Condition(RATE_HZ, FARTHEST_M), 3.0, holes) == {}


def test_images_show_the_same_only_if_all_pixels_are_equal():
    one = shot(SECOND)
    assert one.shows_the_same(shot(SECOND, number=2, device_ns=5))
    assert not one.shows_the_same(shot(2 * SECOND))
    assert not one.shows_the_same(shot(SECOND, depth=one.depth + np.float32(1e-4)))
    black = shot(SECOND, color=one.color * 0)
    assert not black.shows_the_same(black), "a covered lens gives the same image repeatedly"


def test_millimetres_read_as_metres_are_recognised():
    said = said_after(
        Condition(RATE_HZ, FARTHEST_M), 2.0, lambda one: replace(one, depth=1242.0 * np.ones_like(one.depth))
    )
    begun_s, text = said["depth"]
    assert begun_s < 0.6
    assert "depth looks like millimetres read as metres" in text
    assert "a camera of your own gives metres, so multiply by 0.001" in text


@pytest.mark.parametrize("farther", [1242.0, 20.0])
def test_the_text_of_a_fault_does_not_change_while_the_depth_varies(farther):
    def varying(one):
        return replace(one, depth=np.float32(farther * (1.0 + 0.002 * (one.number % 5))) * one.depth)

    condition, said = Condition(RATE_HZ, FARTHEST_M), set()
    for k in range(60):
        now = round(k / RATE_HZ * SECOND)
        condition.look(varying(shot(now)), now)
        said.add(condition.complaints(now).get("depth"))
    said.remove(None)
    assert len(said) == 1


def test_an_unchanging_image_and_a_constant_timestamp_are_named():
    """A camera of one's own may show one image on purpose, so this is only reported."""
    still = shot(0)

    def same(one):
        return replace(still, number=one.number, device_ns=one.device_ns, depth_ns=None)

    (said,) = said_after(Condition(RATE_HZ, FARTHEST_M), 2.0, same).values()
    assert said[1].startswith("it gives the same image again and again")
    frozen = said_after(
        Condition(RATE_HZ, FARTHEST_M), 2.0, lambda one: replace(one, device_ns=5, depth_ns=None)
    )
    assert [text for _, text in frozen.values()] == [
        "all its images have the same timestamp: each needs that of its own capture"
    ]


@pytest.mark.parametrize(
    ("seconds", "says"),
    [
        (0.5, None),
        (-30.0, None),
        (3600.0, "its timestamps are 3600 s ahead of"),
        (1.8e9, "so the time of arrival is taken instead. Give the time.monotonic_ns()"),
        (-63524.0, "64000 s behind"),
    ],
)
def test_timestamps_of_another_clock_are_named_if_they_should_be_of_this_one(seconds, says):
    """For example of wall time, or seconds instead of nanoseconds."""
    for clock_is_host in (True, False):
        condition = Condition(RATE_HZ, FARTHEST_M)
        for k in range(60):
            now = round(k / RATE_HZ * SECOND)
            stamp = now + round(seconds * SECOND)
            condition.look(replace(shot(now), device_ns=stamp, depth_ns=None), now, clock_is_host)
        said = condition.complaints(now)
        assert list(said) == (["clock"] if says and clock_is_host else [])
        assert (says or "") in said.get("clock", says or "")


def _still_from(second):
    """Changes all shots from a second on: the image of that second, with their own timestamps."""

    def still(one):
        if one.device_ns < second * SECOND:
            return one
        return replace(shot(second * SECOND), number=one.number, device_ns=one.device_ns, depth_ns=None)

    return still


def test_an_image_that_stops_changing_means_that_the_camera_has_stopped():
    condition = Condition(RATE_HZ, FARTHEST_M)
    ((kind, (begun_s, text)),) = said_after(condition, 4.0, _still_from(2)).items()
    assert kind == "stopped"
    assert 2.4 <= begun_s < 2.5
    assert "the camera has stopped" in text
    assert "camera.check: false" in text
    assert said_after(condition, 1.0, start_s=4.0, counted=120) == {}
    condition.reopened()
    assert list(said_after(condition, 3.0, _still_from(5), start_s=5.0)) == ["again"], (
        "unchanged from the first image on"
    )


def test_a_slow_sensor_whose_images_are_sent_three_times_is_not_reported():
    def of_10_hz(one):
        k = round(one.number * RATE_HZ / SECOND)
        kept = shot(round(k // 3 * 3 / RATE_HZ * SECOND))
        return replace(kept, number=one.number, device_ns=one.device_ns, depth_ns=None)

    condition = Condition(RATE_HZ, FARTHEST_M)
    sent = [of_10_hz(shot(round(k / RATE_HZ * SECOND))) for k in range(6)]
    assert [b.shows_the_same(a) for a, b in pairwise(sent)] == [True, True, False, True, True]
    assert said_after(condition, 10.0, of_10_hz) == {}


def test_one_changed_depth_value_makes_another_image():
    def nearly(one):
        still = _still_from(2)(one)
        still.depth[5, 5] += 1e-4 * (one.number % 2)
        return still

    assert said_after(Condition(RATE_HZ, FARTHEST_M), 5.0, nearly) == {}


def test_with_the_check_off_an_unchanging_image_does_not_mean_stopped():
    condition = Condition(RATE_HZ, FARTHEST_M, check=False)
    assert list(said_after(condition, 5.0, _still_from(2))) == ["again"]
