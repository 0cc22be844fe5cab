"""A slow recorder loses frames and counts them; what it keeps is in order."""

import pytest

from huepose_services.recording.arrivals import Arrivals, Arrived
from tests.services.conftest import until


class _Channel:
    """The used parts of zenoh: the samples, and a subscription that can be ended."""

    def __init__(self, samples):
        self._samples = samples
        self.handler = self

    def declare_subscriber(self, key, handler):
        return self

    def __iter__(self):
        while self._samples:
            yield self._samples.pop(0)

    def undeclare(self):
        pass


class _Sample:
    def __init__(self, key, data, pixels=None):
        self.key_expr = key
        self.attachment = None if pixels is None else _Bytes(data)
        self.payload = _Bytes(data if pixels is None else pixels)


class _Bytes(bytes):
    def to_bytes(self):
        return bytes(self)


@pytest.mark.parametrize("most", [25, 100])
def test_frames_beyond_the_memory_limit_are_lost_and_messages_never(most):
    samples = []
    for number in range(5):
        samples += [_Sample("frame", b"%d" % number, bytes(10)), _Sample("pose", b"p%d" % number)]
    arrivals = Arrivals(_Channel(samples), ["all"], most)
    arrivals.wait(5.0)
    until(lambda: not samples)
    arrivals.unsubscribe()
    assert arrivals.waiting
    out = []
    while (arrived := arrivals.take()) is not None:
        out.append(arrived)
    kept = min(5, most // 10)
    assert arrivals.missed == 5 - kept
    assert [a.header for a in out if a.key == "pose"] == [b"p%d" % n for n in range(5)]
    assert [a.header for a in out if a.key == "frame"] == [b"%d" % n for n in range(kept)]
    assert out[:2] == [Arrived("frame", b"0", bytes(10)), Arrived("pose", b"p0", b"")]
    assert not arrivals.waiting


def test_frames_that_are_never_written_count_as_missed():
    samples = [_Sample("frame", b"1", bytes(10)), _Sample("pose", b"p"), _Sample("frame", b"2", bytes(10))]
    arrivals = Arrivals(_Channel(samples), ["all"], 100)
    until(lambda: not samples)
    arrivals.close()
    arrivals.close()
    assert (arrivals.missed, arrivals.waiting) == (2, False)
