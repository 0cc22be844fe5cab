"""A second camera epoch is ignored while frames of the first come; a camera that was opened again counts."""

import pytest

from huepose_services.runtime.one_camera import OneCamera

SECOND = 1_000_000_000


def accepted(camera, *streams, until_s, start_s=0.0, poses=1):
    """Offers streams (epoch, rate in Hz) at the same time, with so many poses of each frame; gives the
    accepted epochs, in order."""
    times = sorted(
        (start_s + k / rate + 0.001 * number, epoch)
        for number, (epoch, rate) in enumerate(streams)
        for k in range(int((until_s - start_s) * rate))
    )
    stamps = [(int(at_s * SECOND), epoch) for at_s, epoch in times for _ in range(poses)]
    return [epoch for stamp_ns, epoch in stamps if camera.accepts(epoch, stamp_ns, stamp_ns)]


def test_another_epoch_ten_times_a_second_is_never_accepted():
    camera = OneCamera()
    assert set(accepted(camera, (1, 30.0), (2, 10.0), until_s=60.0)) == {1}
    assert camera.refused == 600
    assert camera.agrees(1, 60 * SECOND)
    assert not camera.agrees(2, 60 * SECOND)


def test_a_burst_of_another_epoch_is_not_accepted():
    camera = OneCamera()
    accepted(camera, (1, 30.0), until_s=2.0)
    assert accepted(camera, (2, 1000.0), start_s=2.0, until_s=2.05) == []
    assert accepted(camera, (1, 30.0), start_s=2.05, until_s=3.0) != []


def test_a_camera_that_was_opened_again_is_accepted_after_half_a_second():
    camera = OneCamera()
    accepted(camera, (1, 30.0), until_s=2.0)
    assert len(accepted(camera, (2, 30.0), start_s=2.0, until_s=3.0)) in (14, 15, 16)
    assert accepted(camera, (1, 1.0), start_s=3.0, until_s=3.1) == []


@pytest.mark.parametrize("poses", [1, 2])
def test_a_slow_camera_is_waited_for(poses):
    camera = OneCamera()
    accepted(camera, (1, 1.0), until_s=3.0, poses=poses)
    assert set(accepted(camera, (1, 1.0), (2, 1.5), start_s=3.0, until_s=30.0, poses=poses)) == {1}


def test_a_frame_that_is_repeated_twice_a_second_is_accepted():
    camera = OneCamera()
    assert all(camera.accepts(1, 7, k * SECOND // 2) for k in range(20))
    assert not camera.accepts(2, 8, 19 * SECOND // 2 + SECOND)


def test_repeated_messages_of_a_camera_that_ended_delay_the_next_one_only_shortly():
    camera = OneCamera()
    accepted(camera, (1, 30.0), until_s=2.0)
    assert all(camera.accepts(1, 59 * SECOND // 30, at_s * SECOND) for at_s in (2, 3, 4, 5))
    assert not camera.accepts(2, 6 * SECOND, 6 * SECOND)
    assert camera.accepts(2, 6 * SECOND, 13 * SECOND // 2 + 1)


def test_a_repeated_pose_of_a_camera_that_ended_does_not_delay_the_next_one():
    camera = OneCamera(again_counts=False)
    accepted(camera, (1, 30.0), until_s=2.0, poses=2)
    assert all(camera.accepts(1, 59 * SECOND // 30, at_s * SECOND) for at_s in (2, 3, 4, 5))
    assert camera.agrees(2, 5 * SECOND)
    assert camera.accepts(2, 6 * SECOND, 6 * SECOND)


def test_a_slower_first_camera_gives_way_to_a_faster_one():
    camera = OneCamera()
    accepted(camera, (2, 10.0), until_s=5.0)
    counted = accepted(camera, (2, 10.0), (1, 30.0), start_s=5.0, until_s=12.0)
    assert counted[-1] == 1
    assert set(counted[counted.index(1) :]) == {1}
