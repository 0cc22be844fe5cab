"""A recording has all that the tracker took: what did not arrive is requested; skipped frames are dropped
first."""

import threading
import time

import msgspec
import pytest

from huepose_protos import encode
from huepose_protos.examples import example
from huepose_protos.messages import FrameHeader, IntakeMessage, MemoryMessage
from huepose_services.recording.arrivals import Arrivals, Taken
from tests.services.conftest import until

from .test_arrivals import _Channel, _Sample

EPOCH = example(FrameHeader).camera_epoch
LATER = 1e9
"""A time after all waiting times."""


def _frame(number):
    return encode(msgspec.structs.replace(example(FrameHeader), frame_id=number, camera_epoch=EPOCH))


def _step(seq, frame=None, again=False, publish_ns=None):
    stamp = publish_ns or 10**12 + seq
    message = msgspec.structs.replace(
        example(IntakeMessage),
        **{"seq": seq, "frame_id": frame, "camera_epoch": None if frame is None else EPOCH},
        publish_ns=stamp,
    )
    return "huepose/a/cam0/tracker/" + ("again" if again else "intake"), encode(message)


def test_what_the_tracker_took_and_did_not_arrive_is_requested_until_it_arrives():
    taken = Taken()
    for number in (1, 2, 4):
        taken.frame(_frame(number))
    taken.message(*_step(11, 2))
    taken.message(*_step(14, 4))
    assert taken.wanted(0.0) == ([], [])  # it may still be on its way
    assert taken.wanted(LATER) == ([], [12, 13])
    taken.message(*_step(12, 3, again=True))
    assert taken.wanted(LATER + 1.0) == ([(EPOCH, 3)], [13])
    taken.frame(_frame(3))
    taken.message(*_step(13, again=True))
    assert taken.wanted(LATER + 2.0) == ([], [])
    assert taken.lost == 0


def test_frames_that_the_tracker_keeps_are_requested_at_the_beginning():
    taken = Taken()
    frames = [(EPOCH, number) for number in range(6)]
    memory = msgspec.structs.replace(example(MemoryMessage), frames=frames)
    taken.message("huepose/a/cam0/tracker/memory", encode(memory))
    assert taken.wanted(LATER) == (frames[:4], [])
    assert taken.wanted(LATER) == (frames[4:], [])


def test_what_never_arrives_is_counted_and_after_a_restart_nothing_older_is_requested():
    taken = Taken()
    taken.message(*_step(500))
    taken.message(*_step(3, publish_ns=10**13))
    assert taken.wanted(LATER) == ([], [])
    taken.message(*_step(5, publish_ns=10**13 + 1))
    asked = [taken.wanted(LATER * (n + 1)) for n in range(5)]
    assert asked == [([], [4])] * 4 + [([], [])]
    assert taken.lost == 1


def test_frames_from_before_the_recording_are_requested_and_do_not_count_as_lost():
    taken = Taken()
    taken.frame(_frame(5))
    frames = [(EPOCH, number) for number in (3, 4, 5, 6)]
    memory = msgspec.structs.replace(example(MemoryMessage), frames=frames)
    taken.message("huepose/a/cam0/tracker/memory", encode(memory))
    asked = [taken.wanted(LATER * (n + 1))[0] for n in range(5)]
    assert asked == [[(EPOCH, 3), (EPOCH, 4), (EPOCH, 6)]] * 4 + [[]]
    assert taken.lost == 1


@pytest.mark.parametrize("later", [EPOCH + 1, EPOCH - 1])
def test_a_frame_lost_after_the_camera_was_opened_again_is_counted(later):
    """Epochs are random numbers: they have no order."""
    taken = Taken()
    taken.frame(_frame(5))
    memory = msgspec.structs.replace(example(MemoryMessage), frames=[(EPOCH, 4), (later, 9), (later, 2)])
    taken.message("huepose/a/cam0/tracker/memory", encode(memory))
    for n in range(5):
        taken.wanted(LATER * (n + 1))
    assert taken.lost == 2


def test_a_slow_recorder_drops_frames_that_the_tracker_skipped():
    """Of ten frames the tracker takes each third; there is room for four."""
    samples = []
    for number in range(10):
        samples.append(_Sample("frame", _frame(number), bytes(10)))
        if number % 3 == 0:
            samples.append(_Sample(*_step(number, number)))

    def ask(frames, steps):
        return [_Sample("huepose/a/cam0/tracker/again", _frame(f[1]), bytes(10)) for f in frames]

    arrivals = Arrivals(_Channel(samples), ["all"], 40, ask)
    until(lambda: not samples)
    # A frame that was dropped before the tracker said that it took it is requested again.
    kept = set()

    def take():
        arrived = arrivals.take()
        kept.update({arrived.frame[1]} if arrived is not None and arrived.frame else ())

    until(lambda: kept >= {0, 3, 6, 9}, act=take)
    arrivals.close()
    assert not kept & {1, 2}
    assert arrivals.missed >= 4


def test_no_request_is_waited_for_after_the_end():
    asking = []

    def ask(frames, steps):
        asking.append(threading.current_thread())
        time.sleep(0.3)
        return []

    arrivals = Arrivals(_Channel([_Sample(*_step(1, 1))]), ["all"], 40, ask)
    until(lambda: asking)
    arrivals.close()
    assert not asking[0].is_alive()
