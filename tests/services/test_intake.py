"""What a recorder can request again."""

from types import SimpleNamespace

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame
from huepose.tracking import Tracker, TrackerConfig
from huepose_services import intake
from huepose_services.convert import frame_from_wire
from huepose_services.intake import InputCache
from huepose_services.runtime.config import BusConfig, Config
from tests.services.fake_bus import FakeBus, sent
from tests.services.sessions import open_bus
from tests.services.tracker_work import MS

PIXELS = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
FRAME = RgbdFrame(PIXELS, np.ones((48, 64), np.float32), Camera(60.0, 60.0, 31.5, 23.5, 64, 48))


@pytest.mark.parametrize("odometry", [True, False])
def test_the_frames_that_the_tracker_keeps_can_be_requested_and_no_others(odometry):
    bus = FakeBus("tracker")
    bus.session.declare_queryable = lambda key, channel: SimpleNamespace(handler=())
    tracker = Tracker({}, TrackerConfig(history_frames=3, older_frames=2, odometry=odometry))
    cache = InputCache(bus)
    no_camera_pose = {"camera_translation": None, "camera_quaternion": None}
    for number in range(1, 20):
        header, payload = sent(FRAME, frame_id=number, capture_ns=number * 33 * MS, **no_camera_pose)
        frame = frame_from_wire(header, payload)
        assert np.shares_memory(frame.color, np.frombuffer(payload, np.uint8)), "so it costs no memory"
        cache.frame(header, payload, frame, recorded=False)
        tracker.step(frame)
        del frame
    kept = {(frame.epoch, frame.frame_id) for frame in tracker._frames}
    assert len(kept) == 5
    assert set(cache._frames) == kept


def test_a_frame_that_comes_twice_is_kept_once(monkeypatch):
    """As a frame at which the tracker raised an error."""
    bus = FakeBus("tracker")
    bus.session.declare_queryable = lambda key, channel: SimpleNamespace(handler=())
    cache = InputCache(bus)
    for number in (1, 1, 2, 3):
        header, payload = sent(FRAME, frame_id=number)
        monkeypatch.setattr(intake, "_NEWEST_BYTES", len(payload))
        cache.frame(header, payload, frame_from_wire(header, payload), recorded=True)
    assert [frame_id for _, frame_id in cache._frames] == [3]


@pytest.mark.live
def test_no_thread_waits_for_requests_when_the_tracker_is_closed(base_port):
    """It would abort the process at its end, if that comes from an error."""
    config = Config(bus=BusConfig(base_port=base_port))
    bus = open_bus(config, "tracker")
    InputCache(bus)
    ((_, thread),) = bus.inbox._served
    assert thread.is_alive()
    bus.close()
    assert not thread.is_alive()
    bus.session.close()
