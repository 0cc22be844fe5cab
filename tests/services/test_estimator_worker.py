"""What the estimator worker says where nothing is found in a picture."""

from collections import defaultdict
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from huepose.estimation.types import PoseEstimate
from huepose.geometry import Camera, RgbdFrame
from huepose_protos.examples import example
from huepose_protos.messages import Estimates, FrameHeader, Masks
from huepose_services.camera.publish import packed
from huepose_services.estimator import EstimatorWork
from huepose_services.runtime.config import Config
from huepose_services.runtime.health import Health

CAMERA = Camera(300.0, 300.0, 79.5, 59.5, 160, 120)


class _Bus:
    def __init__(self):
        self.keys, self.health = Config().keys, Health("estimator")
        self.inbox = SimpleNamespace(ring=lambda *_: None)
        self.logged, self.arriving, self.said = defaultdict(list), [], []
        self.log = SimpleNamespace(seldom=lambda kind, text: self.logged[kind].append(text))

    def take_with_payload(self, place, kind):
        return self.arriving.pop(0) if self.arriving else None

    def put_control(self, key, message):
        self.said.append(message)


class _Estimator:
    """Knows a cup, and answers as it was told."""

    objects, diameters_m = ("cup",), (0.12,)
    answers: tuple[PoseEstimate, ...] = ()

    def estimate(self, frame, queries):
        return list(self.answers)


def masks(times):
    """No object was detected in a picture of a wall a metre away, its depth so many times too large."""
    color = np.random.default_rng(0).integers(20, 220, (120, 160, 3), dtype=np.uint8)
    depth = np.full((120, 160), 1.0 * times, np.float32)
    picture = packed(RgbdFrame(color, depth, CAMERA), 0.0002)
    header = msgspec.structs.replace(
        example(FrameHeader), intrinsics=picture.intrinsics, buffers=picture.buffers
    )
    return msgspec.structs.replace(example(Masks), frame=header, objects=[]), picture.payload


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
    assert bus.logged["picture"] == [f"nothing is found: {answer.picture}"]
    work.step()
    assert bus.said[-1].picture == ""
    assert bus.health.message().warnings == []
