"""The tracker as its users see it: frames and corrections in, states and poses out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.estimation.types import PoseEstimate
from huepose.geometry import Camera, RgbdFrame, se3
from huepose.support.errors import InputError
from huepose.tracking import Applied, Correction, Tracker, TrackerConfig, evidence
from tests.onboarded import onboarded
from tests.tracking.conftest import correction, errors

EPOCH = 1


@pytest.mark.parametrize("name", ["tea_box", "soup_can"])
def test_a_moving_object_is_followed_for_30_frames(name, tea_box, soup_can, shoot, path) -> None:
    model = {"tea_box": tea_box, "soup_can": soup_can}[name]
    tracker = Tracker({name: model})
    for k in range(30):
        frame = shoot([(model.mesh, path(k))], k)
        if k == 0:
            assert tracker.correct(correction(frame, path(0), name=name)) is Applied.CATCHING_UP
        (pose,) = tracker.step(frame)
        assert pose.state is State.TRACKING
        assert (pose.frame_id, pose.stamp_ns, pose.epoch) == (frame.frame_id, frame.stamp_ns, EPOCH)
        mm, degrees = errors(pose, path(k))
        assert mm < 1.0
        assert degrees < 0.6 if name == "soup_can" else degrees < 0.3
        assert pose.applied_correction_seq == 1
    assert pose.velocity is not None
    truth = se3.difference(path(28), path(29)) * 30
    np.testing.assert_allclose(pose.velocity[:3], truth[:3], atol=0.03)
    np.testing.assert_allclose(pose.velocity[3:], truth[3:], atol=0.25)
    assert pose.covariance is not None
    delta = se3.difference(pose.T_cam_obj, path(29))
    assert (np.abs(delta) < 4 * np.sqrt(np.diag(pose.covariance))).all()


def test_an_object_whose_origin_is_far_from_it_is_tracked(tea_box, shoot, path) -> None:
    """As in a mesh in the coordinates of a building: the origin, 42 m off, moves on an arc as the object
    rotates."""
    away = np.array([25.0, 33.75, 0.0])
    vertices = (tea_box.mesh.vertices + away).astype(np.float32)
    model = onboarded(replace(tea_box.mesh, vertices=vertices), "far", searched=False)
    back = se3.make(np.eye(3), -away)
    tracker = Tracker({"far": model})
    for k in range(30):
        frame = shoot([(tea_box.mesh, path(k))], k)
        if k == 0:
            tracker.correct(correction(frame, path(0) @ back, name="far"))
        (pose,) = tracker.step(frame)
        assert pose.state is State.TRACKING
        assert pose.T_cam_obj is not None
        # About the box's own origin; a step of single precision at that distance is 4 micrometres.
        mm, degrees = errors(replace(pose, T_cam_obj=pose.T_cam_obj @ se3.inverse(back)), path(k))
        assert (mm < 1.0, degrees < 0.3) == (True, True)
    went = se3.difference(path(28) @ back, path(29) @ back)[:3] * 30
    np.testing.assert_allclose(pose.velocity[:3], went, atol=0.05 * np.linalg.norm(went))


def test_every_fifth_frame_is_enough(tea_box, film, path) -> None:
    tracker = Tracker({"tea_box": tea_box})
    for frame in film(46, 5):
        if frame.frame_id == 0:
            tracker.correct(correction(frame, path(0)))
        (pose,) = tracker.step(frame)
        mm, degrees = errors(pose, path(frame.frame_id))
        assert pose.state is State.TRACKING
        assert mm < 1.5
        assert degrees < 0.6


def test_other_sides_confirm_an_object_however_far_it_rotates_between_two_frames(tea_box, film, path) -> None:
    tracker = Tracker({"tea_box": tea_box})
    states = []
    for frame in film(46, 5):
        if frame.frame_id == 0:
            tracker.correct(correction(frame, path(0), quality=0.8))
        (pose,) = tracker.step(frame)
        states.append(pose.state)
    assert states[0] is State.SUSPECT, "one uncertain answer of perception"
    assert states[-1] is State.TRACKING, "its print agreed over more than 100 degrees of viewpoints"


def test_an_occluded_object_is_suspect_within_2_and_lost_within_5_frames(
    tea_box, soup_can, shoot, path, started
) -> None:
    wall = se3.make(np.eye(3), np.array([0.0, 0.0, 0.12]))
    states = []
    for k in range(6, 14):
        frame = shoot([(tea_box.mesh, path(k)), (soup_can.mesh, wall)], k)
        (pose,) = started.step(frame)
        states.append(pose.state)
        if pose.state is State.LOST:
            assert pose.T_cam_obj is None
            assert pose.velocity is None
            assert pose.covariance is None
    assert State.TRACKING not in states[1:]
    assert State.LOST in states[:5]
    assert set(states[states.index(State.LOST) :]) == {State.LOST}


@pytest.mark.parametrize("per_frame", [1, 3])
def test_an_object_out_of_view_for_a_tenth_of_a_second_is_not_lost_at_any_frame_rate(
    tea_box, shoot, path, per_frame: int
) -> None:
    """At 30 and at 90 Hz. An object that stays away is lost after a sixth of a second."""
    tracker, states = Tracker({"tea_box": tea_box}), []
    for k in range(20 * per_frame):
        at = k / per_frame
        there = at < 4 or 7 <= at < 12
        frame = shoot([(tea_box.mesh, path(at))] if there else [], k)
        frame = replace(frame, stamp_ns=frame.stamp_ns // per_frame)
        if k == 0:
            tracker.correct(correction(frame, path(0)))
        (pose,) = tracker.step(frame)
        states.append(pose.state)
    assert State.LOST not in states[: 12 * per_frame]
    assert states[12 * per_frame - 1] is State.TRACKING
    assert 4.6 < (states.index(State.LOST) + 1) / per_frame - 12 <= 5.0


@pytest.mark.parametrize("per_frame", [1, 3])
def test_a_barely_visible_object_is_tracked_equally_long_at_any_frame_rate(
    tea_box, shoot, path, monkeypatch, per_frame: int
) -> None:
    """A third of a second at 30 and at 90 Hz."""
    tracker, sure = Tracker({"tea_box": tea_box}), []
    monkeypatch.setattr(evidence, "scarce", lambda terms: True)
    for k in range(12 * per_frame):
        frame = shoot([(tea_box.mesh, path(k / per_frame))], k)
        frame = replace(frame, stamp_ns=frame.stamp_ns // per_frame)
        if k == 0:
            tracker.correct(correction(frame, path(0)))
        tracker.step(frame)
        sure.append(tracker._tracks["tea_box", 0].belief.evidence)
    given_up = next(k for k, one in enumerate(sure) if one < TrackerConfig().lost_quality)
    assert 0.25 < given_up / per_frame / 30 < 0.34


@pytest.mark.parametrize("per_frame", [1, 3])
def test_the_velocity_of_an_unseen_object_decays_equally_fast_at_any_frame_rate(
    tea_box, shoot, path, per_frame: int
) -> None:
    """To 0.85 a thirtieth of a second, at 30 and at 90 Hz."""
    tracker, speeds = Tracker({"tea_box": tea_box}), []
    for k in range(12 * per_frame):
        at = k / per_frame
        frame = shoot([(tea_box.mesh, path(at))] if at < 8 else [], k)
        frame = replace(frame, stamp_ns=frame.stamp_ns // per_frame)
        if k == 0:
            tracker.correct(correction(frame, path(0)))
        (pose,) = tracker.step(frame)
        if at >= 8:
            assert pose.velocity is not None
            speeds.append(np.linalg.norm(pose.velocity[3:]))
    assert speeds[-1] / speeds[per_frame - 1] == pytest.approx(0.85**3, rel=0.02)


def test_an_object_taken_away_is_lost_until_it_is_back(tea_box, shoot, path, started) -> None:
    states = [started.step(shoot([], k))[0].state for k in range(6, 12)]
    assert states[1] is not State.TRACKING
    assert states[4] is State.LOST
    back = shoot([(tea_box.mesh, path(12))], 12)
    assert started.step(back)[0].state is State.SUSPECT, "found, but not believed at once"
    for k in range(13, 16):
        (pose,) = started.step(shoot([(tea_box.mesh, path(k))], k))
    assert pose.state is State.TRACKING
    assert errors(pose, path(15))[0] < 1.0


def test_a_lost_object_is_tracked_as_soon_as_a_correction_has_reached_the_newest_frame(
    tea_box, shoot, path
) -> None:
    # With no tries the tracker searches for nothing.
    started = Tracker({"tea_box": tea_box}, TrackerConfig(tries_per_s=0.0))
    started.step(shoot([(tea_box.mesh, path(5))], 5))
    started.correct(correction(shoot([], 5), path(5)))
    states = [started.step(shoot([], k))[0].state for k in range(6, 14)]
    assert states[-1] is State.LOST
    back = shoot([(tea_box.mesh, path(14))], 14)
    assert started.step(back)[0].state is State.LOST
    started.correct(correction(back, path(14), seq=2))
    (pose,) = started.poses()
    assert pose.state is State.TRACKING
    assert errors(pose, path(14))[0] < 1.0


def test_a_suspect_object_returns_by_its_own_evidence(tea_box, shoot, path, started) -> None:
    assert started.step(shoot([], 6))[0].state is State.SUSPECT
    states = []
    for k in range(7, 11):
        (pose,) = started.step(shoot([(tea_box.mesh, path(k))], k))
        states.append(pose.state)
    assert states[-1] is State.TRACKING
    assert errors(pose, path(10))[0] < 1.0


def test_a_new_epoch_forgets_everything(tea_box, shoot, path, started) -> None:
    frame = shoot([(tea_box.mesh, path(0))], 0, epoch=2)
    assert started.step(frame) == []
    assert started.instances == ()
    assert started.correct(correction(frame, path(0))) is Applied.APPLIED
    assert started.poses()[0].epoch == 2


def test_after_the_clock_is_set_back_the_newest_frame_is_the_one_received_last(film, started, path) -> None:
    """Fifteen frames come half a second ahead of their time; then the clock is right again."""
    for k, frame in enumerate(film(25, first=6), start=6):
        ahead_ns = 500_000_000 if 10 <= k < 25 else 0
        (pose,) = started.step(replace(frame, stamp_ns=frame.stamp_ns + ahead_ns))
        assert pose.frame_id == k
        assert pose.state is State.TRACKING, k
        assert errors(pose, path(k))[0] < 3.0, k


def test_frames_that_are_not_newer_are_ignored(film, started) -> None:
    frames = film(6)
    before = started.poses()[0]
    assert started.step(frames[5]) == []
    assert started.step(frames[2]) == []
    np.testing.assert_array_equal(started.poses()[0].T_cam_obj, before.T_cam_obj)


def test_an_image_that_is_given_twice_is_ignored_whatever_its_number(tea_box, film, path) -> None:
    """A program asks its camera more often than that takes images, and counts them itself. Late estimates are
    still taken."""
    tracker, frames = Tracker({"tea_box": tea_box}), film(6)
    for k, frame in enumerate(frames):
        tracker.step(replace(frame, frame_id=2 * k))
        assert tracker.step(replace(frame, frame_id=2 * k + 1)) == []
    assert tracker.correct(correction(frames[2], path(2))) is Applied.CATCHING_UP
    (pose,) = [tracker.step(replace(frame, frame_id=12 + k)) for k, frame in enumerate(film(3, first=6))][-1]
    assert pose.state is State.TRACKING


def test_another_image_with_the_same_number_and_timestamp_is_refused(tea_box, shoot, path) -> None:
    """Those of RgbdFrame if none are given."""
    tracker = Tracker({"tea_box": tea_box})
    first, second = (replace(shoot([(tea_box.mesh, path(k))], 0), stamp_ns=0) for k in (0, 3))
    tracker.correct(Correction.first("tea_box", path(0), first, 1.0))
    assert len(tracker.step(first)) == 1
    assert tracker.step(first) == []
    found = "frame 0: found another image with the same number and timestamp, 0 ns"
    with pytest.raises(InputError, match=found):
        tracker.step(second)


@pytest.mark.parametrize("apart_ns", [0, 33, 33_333])
def test_frames_without_time_between_them_are_refused(tea_box, shoot, path, apart_ns: int) -> None:
    """No timestamps, or timestamps in milliseconds or microseconds. A single one may come from a clock that
    was set back."""
    tracker = Tracker({"tea_box": tea_box})
    frames = [replace(shoot([(tea_box.mesh, path(k))], k), stamp_ns=k * apart_ns) for k in range(4)]
    tracker.correct(Correction.first("tea_box", path(0), frames[0], 1.0))
    for frame in frames[:3]:
        tracker.step(frame)
    with pytest.raises(InputError, match="in nanoseconds"):
        tracker.step(frames[3])
    assert len(tracker.step(replace(frames[3], stamp_ns=1_000_000_000))) == 1


def test_two_instances_that_cross_are_told_apart(tea_box, shoot) -> None:
    def at(k: int) -> tuple[np.ndarray, np.ndarray]:
        a = se3.make(se3.rotation_exp(np.array([1.7, 0.1 * k, 0.0])), np.array([-0.1 + 0.01 * k, 0, 0.55]))
        b = se3.make(se3.rotation_exp(np.array([1.9, 0.0, 0.4])), np.array([0.1 - 0.01 * k, 0.01, 0.75]))
        return a, b

    tracker = Tracker({"tea_box": tea_box})
    for k in range(21):
        frame = shoot([(tea_box.mesh, T) for T in at(k)], k)
        if k == 0:
            for i, T in enumerate(at(0)):
                tracker.correct(correction(frame, T, instance=i))
        poses = tracker.step(frame)
    assert [p.instance for p in poses] == [0, 1]
    assert errors(poses[0], at(20)[0])[0] < 1.0
    if poses[1].T_cam_obj is not None:
        assert errors(poses[1], at(20)[1])[0] < 10.0, (
            "it was occluded for a while; it is never on the other one"
        )


def test_a_new_instance_does_not_get_the_surface_of_a_tracked_one(tea_box, film, path) -> None:
    """It is not published for a single frame."""
    tracker = Tracker({"tea_box": tea_box})
    frames = film(8)
    near = se3.perturb(path(0), np.array([0.004, 0, 0, 0, 0.03, 0]))
    tracker.correct(correction(frames[0], path(0), instance=0))
    for frame in frames[:3]:
        tracker.step(frame)
    assert tracker.correct(correction(frames[0], near, instance=1)) is Applied.CATCHING_UP
    for frame in frames[3:]:
        assert [(p.instance, p.state) for p in tracker.step(frame)] == [(0, State.TRACKING)]


@pytest.mark.parametrize(("worse", "holds"), [(0.05, "tea_box"), (0.2, "also")])
def test_of_a_tracked_object_and_a_late_one_on_the_same_surface_one_is_believed(
    tea_box, film, path, worse: float, holds: str
) -> None:
    """The comparison is the same in this frame and in the next ones."""
    tracker = Tracker({"tea_box": tea_box, "also": replace(tea_box, name="also")})
    frames = film(8)
    tracker.correct(correction(frames[0], path(0)))
    for frame in frames[:6]:
        tracker.step(frame)
    track = tracker._tracks["tea_box", 0]
    first = track.hypotheses[0]
    terms = replace(first.terms, total=first.terms.total - worse)
    track.hypotheses = (replace(first, terms=terms),)
    tracker.correct(correction(frames[5], path(5), name="also"))
    assert [p.object for p in tracker.poses() if p.state is State.TRACKING] == [holds]
    for frame in frames[6:]:
        assert len([p for p in tracker.step(frame) if p.state is State.TRACKING]) == 1


def test_of_two_tracks_that_meet_on_one_surface_one_is_lost(tea_box, shoot, path) -> None:
    beside = se3.make(np.eye(3), np.array([0.15, 0.0, 0.0]))
    both = shoot([(tea_box.mesh, path(0)), (tea_box.mesh, beside @ path(0))], 0)
    tracker = Tracker({"tea_box": tea_box})
    tracker.correct(correction(both, path(0), instance=0))
    tracker.correct(correction(both, beside @ path(0), instance=1))
    assert [p.state for p in tracker.step(both)] == [State.TRACKING] * 2
    track = tracker._tracks["tea_box", 1]
    track.hypotheses = (replace(track.hypotheses[0], T_cam_obj=path(0)),)
    for k in range(1, 7):
        poses = tracker.step(shoot([(tea_box.mesh, path(0))], k))
        assert sum(p.state is State.TRACKING for p in poses) == 1
    assert [p.state for p in poses].count(State.LOST) == 1


def test_the_same_frames_give_the_same_poses_bit_for_bit(tea_box, film, path) -> None:
    def run() -> list[bytes]:
        tracker = Tracker({"tea_box": tea_box})
        out = []
        for frame in film(31, 5):
            if frame.frame_id == 0:
                tracker.correct(correction(frame, path(0)))
            for pose in tracker.step(frame):
                assert pose.T_cam_obj is not None
                out.append(pose.T_cam_obj.tobytes() + np.float64(pose.quality).tobytes())
        return out

    assert run() == run()


def test_objects_and_instances_are_added_and_removed(soup_can, started) -> None:
    started.add_object(soup_can)
    assert set(started.objects) == {"tea_box", "soup_can"}
    assert started.instances == (("tea_box", 0),)
    started.remove_instance("tea_box", 0)
    assert started.instances == ()
    started.remove_object("tea_box")
    assert started.objects == ("soup_can",)
    started.remove_object("never_known")


def test_frames_without_valid_depth_break_nothing(started) -> None:
    camera = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)
    for k in range(6, 12):
        depth = np.full((240, 320), [0.0, np.nan, np.inf, -np.inf, 65.535, 0.0][k - 6], np.float32)
        frame = RgbdFrame(np.zeros((240, 320, 3), np.uint8), depth, camera, k, k * 33_333_333, EPOCH)
        (pose,) = started.step(frame)
        assert pose.T_cam_obj is None or se3.is_rigid(pose.T_cam_obj)
        assert np.isfinite(pose.quality)
    assert pose.state is State.LOST


def test_configuration_is_checked() -> None:
    with pytest.raises(InputError, match="history_frames"):
        TrackerConfig(history_frames=1)
    with pytest.raises(InputError, match="older_frames"):
        TrackerConfig(older_frames=-1)
    with pytest.raises(InputError, match="qualities"):
        TrackerConfig(suspect_quality=0.9)


def test_arguments_of_another_type_are_refused(tea_box) -> None:
    with pytest.raises(InputError, match=r"found str; expected reference models.*load_models\(dir\)"):
        Tracker("bundles")
    with pytest.raises(InputError, match="frame: found None; expected an RgbdFrame"):
        Tracker({"tea_box": tea_box}).step(None)
    with pytest.raises(InputError, match=r"found PoseEstimate; .* Make one: Correction\.of\(pose, frame\)"):
        Tracker({"tea_box": tea_box}).correct(PoseEstimate("tea_box"))
