"""What the estimator worker says where nothing is found in a picture."""

from collections import defaultdict
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from huepose.estimation.apparent_size import SCALES
from huepose.estimation.types import PoseEstimate
from huepose.geometry import Camera, RgbdFrame
from huepose_protos.examples import example
from huepose_protos.messages import Estimates, FrameHeader, Masks
from huepose_services import estimator as worker
from huepose_services.camera.publish import packed
from huepose_services.estimator import LOOK_EVERY_NS, EstimatorWork, make
from huepose_services.runtime.config import Config, EstimatorConfig
from huepose_services.runtime.health import Health

CAMERA = Camera(300.0, 300.0, 79.5, 59.5, 160, 120)


class _Bus:
    def __init__(self):
        self.keys, self.health = Config().keys, Health("estimator")
        self.inbox = SimpleNamespace(ring=lambda *_: None)
        self.logged, self.arriving, self.said, self.healths = defaultdict(list), [], [], []
        self.log = SimpleNamespace(seldom=lambda kind, text: self.logged[kind].append(text))

    def take_with_payload(self, place, kind):
        return self.arriving.pop(0) if self.arriving else None

    def say_health(self):
        self.healths.append(self.health.message().warnings)

    def put_control(self, key, message):
        self.said.append(message)


class _Estimator:
    """Knows a cup, and answers as it was told."""

    objects, diameters_m = ("cup",), (0.12,)
    answers: tuple[PoseEstimate, ...] = ()

    def estimate(self, frame, queries):
        return list(self.answers)

    def sizes_seen(self, frame, answers):
        return [np.where(np.isclose(SCALES, 0.1), 6.0, 0.0)]


def masks(times, *names):
    """A picture of a wall a metre away, its depth so many times too large, in which these were detected."""
    color = np.random.default_rng(0).integers(20, 220, (120, 160, 3), dtype=np.uint8)
    depth = np.full((120, 160), 1.0 * times, np.float32)
    picture = packed(RgbdFrame(color, depth, CAMERA), 0.0002)
    header = replace(example(FrameHeader), intrinsics=picture.intrinsics, buffers=picture.buffers)
    seen = example(Masks).objects[0]
    asked = [replace(seen.detection.request, object=name, prior=None) for name in names]
    objects = [replace(seen, detection=replace(seen.detection, request=one), masks=[]) for one in asked]
    return replace(example(Masks), frame=header, objects=objects), picture.payload


@pytest.mark.parametrize("times", [10.0, 0.05, 20.0])
def test_depth_of_another_unit_is_named_in_answer_health_and_log(times):
    bus = _Bus()
    work = EstimatorWork(bus, _Estimator(), SimpleNamespace(changes=lambda: []))
    bus.arriving = [masks(times), masks(1.0)]
    work.step()
    (answer,) = bus.said
    assert isinstance(answer, Estimates)
    assert "depth scale" in answer.picture
    assert bus.health.message().warnings == [answer.picture]
    assert bus.healths == [[answer.picture]], "told at once, not with the next sign of life"
    assert bus.logged["picture"] == [f"nothing is found: {answer.picture}"]
    work.step()
    assert bus.said[-1].picture == ""
    assert bus.health.message().warnings == []


def test_a_wrong_camera_matrix_is_warned_of_after_some_looks(monkeypatch):
    bus, estimator, now = _Bus(), _Estimator(), [0]
    monkeypatch.setattr(worker, "now_ns", lambda: now[0])
    estimator.answers = (PoseEstimate("cup", T_cam_obj=np.eye(4), found=True, state="TRACKING"),)
    work = EstimatorWork(bus, estimator, SimpleNamespace(changes=lambda: []))

    def warned_after(seconds):
        now[0] += int(seconds * 1e9)
        bus.arriving = [masks(1.0, "cup")]
        work.step()
        return [text for text in bus.health.message().warnings if "fx and fy" in text]

    every_s = LOOK_EVERY_NS * 1e-9
    first = [warned_after(s) for s in (0.0, 0.1, every_s, 0.1)]
    assert first == [[], [], [], []]  # two looks
    (said,) = warned_after(every_s)
    assert said.startswith("The picture shows objects 10 % larger")
    assert "estimator.check_sizes: false" in said
    assert [answer.sizes for answer in bus.said] == [""] * 5
    warned_after(0.0)
    assert said.startswith(bus.said[-1].sizes)
    assert bus.said[-1].sizes.endswith("the mesh is too small.")
    estimator.sizes_seen = lambda frame, answers: [np.where(np.isclose(SCALES, 0.0), 9.0, 0.0)]
    assert [warned_after(every_s) for _ in range(3)][-1] == []
    assert bus.said[-1].sizes == ""


def test_sizes_are_not_looked_at_where_the_owner_trusts_them(monkeypatch):
    bus = _Bus()
    bus.inbox.queue = lambda *_: None
    monkeypatch.setattr(worker.models, "load", lambda config: {})
    monkeypatch.setattr(worker, "Follower", lambda *_: None)
    sizes = [
        make(bus, Config(estimator=EstimatorConfig(threads=1, check_sizes=check)))._sizes
        for check in (True, False)
    ]
    assert [one.wanted(1, 0) for one in sizes] == [True, False]
