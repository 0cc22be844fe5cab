"""The thread around a camera: whatever the camera does, `take` returns in time and `trouble` gives the
reason."""

import asyncio
import threading
import time

import numpy as np
import pytest

from huepose.geometry import Camera
from huepose_services.camera.live import CameraError, Shot
from huepose_services.camera.reader import Reader

CAMERA = Camera(60.0, 60.0, 3.5, 2.5, 8, 6)


def _shot(number, color=None):
    now = time.monotonic_ns()
    number_of_color = number if color is None else color
    return Shot(
        np.full((6, 8, 3), number_of_color, np.uint8), np.ones((6, 8), np.float32), CAMERA, number, now, now
    )


class Device:
    """Plugged in or not; `behave` makes each read."""

    name, if_silent, once = "test camera", "Plug it in.", False
    device_clock_is_host = True
    is_sensor = True

    def __init__(self, behave, plugged=True):
        self.plugged, self.behave, self.opened, self.closed, self.reads = plugged, behave, 0, 0, 0
        self.release = threading.Event()

    def open(self):
        if not self.plugged:
            raise CameraError("none is connected. Plug it in.")
        self.opened += 1
        return self

    def read(self, timeout_s):
        self.reads += 1
        return self.behave(self, timeout_s)

    def close(self):
        self.closed += 1
        self.reads_until_closed = self.reads


def _paced(device, timeout_s):
    time.sleep(0.005)
    return _shot(device.reads)


@pytest.fixture
def reader_of():
    started = []

    def start(device, rate_hz=30.0):
        started.append((Reader(device, rate_hz), device))
        return started[-1][0]

    yield start
    for reader, device in started:
        device.release.set()
        reader.close()


def test_a_missing_camera_is_reported_at_once_and_opened_when_it_is_plugged_in(reader_of):
    device = Device(_paced, plugged=False)
    reader = reader_of(device)
    assert reader.take(0.1) is None
    assert reader.trouble == "test camera: none is connected. Plug it in."
    device.plugged = True
    taken = reader.take(5.0)
    assert taken is not None
    assert (taken.opening, taken.device_clock_is_host) == (1, True)
    assert reader.trouble is None


def test_the_newest_image_is_given_once(reader_of, wait_until):
    device = Device(lambda d, s: _shot(d.reads) if d.reads <= 5 else time.sleep(0.01))
    reader = reader_of(device)
    wait_until(lambda: device.reads > 6)
    assert reader.take(0.0).shot.number == 5
    assert reader.take(0.0) is None
    assert reader.skipped == 4


def test_a_read_that_hangs_does_not_block_take_and_is_reported(reader_of, wait_until):
    device = Device(lambda d, s: d.release.wait(30.0) and None)
    reader = reader_of(device)
    start = time.monotonic()
    assert reader.take(0.05) is None
    assert time.monotonic() - start < 5.0
    wait_until(lambda: reader.trouble is not None, 5.0)
    assert "reading" in reader.trouble
    assert reader.stuck_s() > 1.0


def test_a_camera_that_is_unplugged_is_closed_and_opened_again(reader_of, wait_until):
    def behave(device, timeout_s):
        if device.reads == 3:
            raise RuntimeError("xioctl(VIDIOC_QBUF) failed: No such device")
        return _paced(device, timeout_s)

    device = Device(behave)
    reader = reader_of(device)
    seen = set()
    wait_until(lambda: (taken := reader.take(0.1)) and seen.add(taken.opening) is None and 2 in seen)
    assert device.closed == 1


def test_the_last_image_repeated_is_not_a_new_image(reader_of, wait_until, monkeypatch):
    monkeypatch.setattr("huepose_services.camera.reader._SILENT_NS", 1_000_000_000)
    frozen = _shot(7)

    def behave(device, timeout_s):
        time.sleep(0.005)
        return frozen

    device = Device(behave)
    reader = reader_of(device)
    assert reader.take(2.0).shot is frozen
    assert reader.take(0.05) is None
    wait_until(lambda: device.closed > 0)
    assert reader.repeated >= device.reads_until_closed - 1 > 10
    assert "no new image" in reader.trouble


@pytest.mark.parametrize("is_sensor", [True, False])
def test_the_last_image_with_new_timestamps_is_not_a_new_image_of_a_sensor(
    reader_of, wait_until, monkeypatch, is_sensor
):
    monkeypatch.setattr("huepose_services.camera.reader._SILENT_NS", 1_000_000_000)

    def behave(device, timeout_s):
        time.sleep(0.005)
        return _shot(device.reads, color=7)

    device = Device(behave)
    device.is_sensor = is_sensor
    reader = reader_of(device)
    if is_sensor:
        wait_until(lambda: device.closed > 0)
        assert reader.repeated >= device.reads_until_closed - 1 > 10
        assert "no new image" in reader.trouble
    else:
        wait_until(lambda: (taken := reader.take(0.1)) and taken.shot.number > 50)
        assert (reader.repeated, device.closed) == (0, 0)


@pytest.mark.parametrize("error", [asyncio.CancelledError, SystemExit, GeneratorExit])
def test_a_base_exception_does_not_end_the_reading(reader_of, wait_until, error):
    def behave(device, timeout_s):
        if device.reads == 3:
            raise error("of its own")
        return _paced(device, timeout_s)

    device = Device(behave)
    reader = reader_of(device)
    wait_until(lambda: reader.trouble is not None)
    assert reader.trouble == "test camera: of its own"
    wait_until(lambda: (taken := reader.take(0.1)) and taken.opening == 2)
    assert device.closed == 1


@pytest.mark.parametrize("blocks", [True, False])
def test_a_camera_at_its_slow_rate_gives_no_trouble(reader_of, wait_until, monkeypatch, blocks):
    """Whether `read` waits for an image in one call, or returns None until there is one."""
    for limit in ("_SLOW_NS", "_SILENT_NS"):
        monkeypatch.setattr(f"huepose_services.camera.reader.{limit}", 20_000_000)

    def behave(device, timeout_s):
        time.sleep(0.5 if blocks else 0.05)
        return _shot(device.reads) if blocks or device.reads % 10 == 0 else None

    device = Device(behave)
    reader, troubles = reader_of(device, rate_hz=2.0), set()
    wait_until(lambda: troubles.add(reader.trouble) or reader.pictures == 4)
    assert troubles == {None}
    assert (reader.openings, device.closed) == (1, 0)


def test_an_error_that_names_a_file_in_another_encoding_can_be_sent(reader_of, wait_until):
    def behave(device, timeout_s):
        raise OSError("no caf\udce9.png")

    reader = reader_of(Device(behave))
    wait_until(lambda: reader.trouble is not None)
    assert reader.trouble.encode() == rb"test camera: no caf\udce9.png"
