"""Faults that cannot be injected into a running pipeline from outside: of clocks, networks and files."""

from __future__ import annotations

import json
import time
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame
from huepose.model.io import model_path
from huepose_protos import PoseClient
from huepose_protos.examples import example
from huepose_protos.messages import PoseMessage
from huepose_services.builtin import builtin_bundles
from huepose_services.camera.publish import FramePublisher, packed
from huepose_services.runtime import clock, worker
from huepose_services.runtime.config import Config
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.runtime.work import Work
from tests.services.conftest import free_port_range, processes
from tests.services.fake_bus import FakeBus

POSE = example(PoseMessage)
SECOND = 1_000_000_000


def test_5_setting_the_wall_clock_does_not_change_capture_times(monkeypatch):
    """Timestamps are of a clock that cannot be set; their offset to the wall clock is the current one."""
    bus = FakeBus("camera")
    publisher = FramePublisher(bus, Config())
    camera = Camera(60.0, 60.0, 31.5, 23.5, 64, 48)
    frame = RgbdFrame(np.zeros((48, 64, 3), np.uint8), np.ones((48, 64), np.float32), camera)
    picture = packed(frame, 1e-4)
    wall = time.time_ns
    for number, step_s in enumerate((0, 3600, -3600)):
        monkeypatch.setattr(clock.time, "time_ns", lambda s=step_s: wall() + s * SECOND)
        publisher.publish(picture, 1, number, clock.now_ns())
    before, forth, back = bus.headers
    assert before.capture_ns <= forth.capture_ns <= back.capture_ns
    offsets = [h.clock.realtime_offset_ns for h in bus.headers]
    assert offsets[1] - offsets[0] == pytest.approx(3600 * SECOND, abs=SECOND)
    assert offsets[2] - offsets[0] == pytest.approx(-3600 * SECOND, abs=SECOND)


@pytest.mark.parametrize(("skew_s", "known"), [(0.0, True), (0.05, True), (3600.0, False), (-3600.0, False)])
def test_23_a_subscriber_with_a_wrong_clock_does_not_take_old_poses_for_new(skew_s, known):
    """The age of messages is of the subscriber's clock; the pose predicted to now needs both clocks."""
    with PoseClient(f"tcp/127.0.0.1:{free_port_range(1)}") as client:
        now = time.monotonic_ns()
        offset_ns = time.time_ns() - now - round(skew_s * SECOND)
        for back in (3, 2, 1):
            stamp = now - back * SECOND // 100
            client._add(
                "lab/cam0",
                msgspec.structs.replace(
                    POSE, clock_id="another", realtime_offset_ns=offset_ns, capture_ns=stamp, publish_ns=stamp
                ),
                time.monotonic(),
            )
        assert client.latest(max_age_s=5.0) is not None
        assert client.silent_s() < 5.0
        there = client.at()
        assert (there is not None) == known
        if there is not None:
            assert there.ahead_s < 0.1, "it is predicted for a tenth of a second at most"
            grown = np.diag(there.covariance)[:3] > np.array(POSE.covariance).reshape(6, 6).diagonal()[:3]
            assert grown.all(), "and its uncertainty grows"
        client._arrived = {key: at - 5.0 for key, at in client._arrived.items()}
        assert client.latest(max_age_s=4.0) is None


def test_14_a_damaged_model_is_named_and_the_pipeline_ends(tmp_path):
    bundles = tmp_path / "bundles"
    bundles.mkdir()
    whole = model_path(builtin_bundles(0), "tea_box").read_bytes()
    damaged = bytearray(whole)
    damaged[len(whole) // 2] ^= 0xFF
    model_path(bundles, "tea_box").write_bytes(damaged)
    path = tmp_path / "pipeline.yaml"
    settings = {
        "bundles": str(bundles),
        "objects": [{"name": "tea_box"}],
        "bus": {"base_port": free_port_range(10)},
        "workers": ["camera", "segmenter"],
    }
    path.write_text(json.dumps(settings))
    with processes() as start:
        up = start("up", path)
        _, said = up.communicate(timeout=100.0)
    assert up.returncode == 2, said
    assert "tea_box.huepose" in said
    assert "Traceback" not in said


class _Work(Work):
    """A worker's work whose first `fails` steps fail, as a network's that gets no memory on its GPU."""

    def __init__(self, fails):
        self.fails, self.steps, self.finished = fails, 0, False

    def due_ns(self):
        return clock.now_ns()

    def step(self):
        self.steps += 1
        if self.steps <= self.fails:
            raise RuntimeError("Failed to allocate memory for requested buffer of size 2147483648")
        self.finished = True


def _looped(work):
    health = Health("detector")
    bus = SimpleNamespace(
        health=health,
        log=Log("detector"),
        inbox=SimpleNamespace(wait=lambda seconds: None),
        say_health=lambda: None,
    )
    pulse = SimpleNamespace(running=lambda: None, ready=lambda: None, beat=lambda: None)
    worker._loop(bus, work, SimpleNamespace(requested=False), pulse, reload=lambda: None)
    return health


def test_20_a_network_that_gets_no_memory_for_a_while_is_counted_and_retried(capfd):
    work = _Work(fails=9)
    health = _looped(work)
    assert (work.steps, health.errors) == (10, 9)
    assert "Failed to allocate memory" in health.last_error
    assert "going on" in capfd.readouterr().err


def test_20_a_network_that_never_gets_memory_ends_its_worker(capfd):
    with pytest.raises(RuntimeError, match="Failed to allocate memory"):
        _looped(_Work(fails=100))
