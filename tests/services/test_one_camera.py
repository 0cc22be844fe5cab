"""Frames of a second camera epoch change nothing while the first one's come; a camera opened anew counts."""

import pytest

from huepose_services.runtime.one_camera import OneCamera

SECOND = 1_000_000_000


def heard(camera, *streams, until_s, start_s=0.0, poses=1):
    """(epoch, rate in Hz) at the same time, so many poses of each frame; returns the epochs that counted, in
    order."""
    times = sorted(
        (start_s + k / rate + 0.001 * number, epoch)
        for number, (epoch, rate) in enumerate(streams)
        for k in range(int((until_s - start_s) * rate))
    )
    stamps = [(int(at_s * SECOND), epoch) for at_s, epoch in times for _ in range(poses)]
    return [epoch for stamp_ns, epoch in stamps if camera.accepts(epoch, stamp_ns, stamp_ns)]


def test_another_epoch_ten_times_a_second_never_counts():
    camera = OneCamera()
    assert set(heard(camera, (1, 30.0), (2, 10.0), until_s=60.0)) == {1}
    assert camera.refused == 600
    assert camera.agrees(1, 60 * SECOND)
    assert not camera.agrees(2, 60 * SECOND)


def test_a_burst_does_not_count():
    camera = OneCamera()
    heard(camera, (1, 30.0), until_s=2.0)
    assert heard(camera, (2, 1000.0), start_s=2.0, until_s=2.05) == []
    assert heard(camera, (1, 30.0), start_s=2.05, until_s=3.0) != []


def test_a_camera_that_is_opened_anew_counts_after_half_a_second():
    camera = OneCamera()
    heard(camera, (1, 30.0), until_s=2.0)
    assert len(heard(camera, (2, 30.0), start_s=2.0, until_s=3.0)) in (14, 15, 16)
    assert heard(camera, (1, 1.0), start_s=3.0, until_s=3.1) == []


@pytest.mark.parametrize("poses", [1, 2])
def test_a_slow_camera_is_waited_for(poses):
    camera = OneCamera()
    heard(camera, (1, 1.0), until_s=3.0, poses=poses)
    assert set(heard(camera, (1, 1.0), (2, 1.5), start_s=3.0, until_s=30.0, poses=poses)) == {1}


def test_a_frame_that_is_shown_again_twice_a_second_is_heard():
    camera = OneCamera()
    assert all(camera.accepts(1, 7, k * SECOND // 2) for k in range(20))
    assert not camera.accepts(2, 8, 19 * SECOND // 2 + SECOND)


def test_what_is_said_again_of_a_camera_that_is_gone_holds_up_the_next_one_for_little():
    camera = OneCamera()
    heard(camera, (1, 30.0), until_s=2.0)
    assert all(camera.accepts(1, 59 * SECOND // 30, at_s * SECOND) for at_s in (2, 3, 4, 5))
    assert not camera.accepts(2, 6 * SECOND, 6 * SECOND)
    assert camera.accepts(2, 6 * SECOND, 13 * SECOND // 2 + 1)


def test_a_pose_that_is_said_again_of_a_camera_that_is_gone_holds_up_nobody():
    camera = OneCamera(again_counts=False)
    heard(camera, (1, 30.0), until_s=2.0, poses=2)
    assert all(camera.accepts(1, 59 * SECOND // 30, at_s * SECOND) for at_s in (2, 3, 4, 5))
    assert camera.agrees(2, 5 * SECOND)
    assert camera.accepts(2, 6 * SECOND, 6 * SECOND)


def test_who_was_there_first_and_says_less_gives_way():
    camera = OneCamera()
    heard(camera, (2, 10.0), until_s=5.0)
    counted = heard(camera, (2, 10.0), (1, 30.0), start_s=5.0, until_s=12.0)
    assert counted[-1] == 1
    assert set(counted[counted.index(1) :]) == {1}
