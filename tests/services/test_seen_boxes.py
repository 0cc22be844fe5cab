"""Boxes of a detector that looks at pixels, for those who asked."""

import numpy as np
import pytest

from huepose.geometry import Box, Camera, RgbdFrame
from huepose.perception.types import Detection
from huepose_protos.messages import BufferSpec, FrameHeader, PerceptionRequest, Prior, RequestedObject
from huepose_services.convert import intrinsics_to_wire
from huepose_services.models import Outline
from huepose_services.runtime.clock import this_clock
from huepose_services.seen_boxes import SeenBoxes

CAMERA = Camera(500.0, 500.0, 320.0, 240.0, 640, 480)
STAMP = 1_000_000_000
# A cube of 10 cm, 1 m away in the middle of the picture: 50 pixels wide, a little more for its near side.
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32) * 0.05
MIDDLE = Box(294.0, 214.0, 53.0, 53.0)
LEFT, RIGHT = Box(50, 200, 60, 60), Box(500, 200, 60, 60)


class Seen:
    """Sees what it was told, of those objects that are asked for."""

    def __init__(self, *detections):
        self.detections, self.asked = detections, []

    def detect(self, frame, names):
        self.asked.append((frame, tuple(names)))
        return [d for d in self.detections if d.object in names]


def _header():
    return FrameHeader(
        publish_ns=STAMP,
        camera_epoch=1,
        frame_id=7,
        capture_ns=STAMP,
        clock=this_clock(),
        frame="cam0_color_optical",
        intrinsics=intrinsics_to_wire(CAMERA, 0.0001),
        buffers=[BufferSpec(name="color", dtype="uint8", shape=(480, 640, 3), offset=0)],
    )


def _prior():
    return Prior(translation=(0.0, 0.0, 1.0), quaternion=(0.0, 0.0, 0.0, 1.0), stamp_ns=STAMP)


def _answer(detector, *objects):
    finder = SeenBoxes({"cube": Outline("cube", 1, CORNERS, 0.17)}, detector)
    frame = RgbdFrame(np.zeros((480, 640, 3), np.uint8), np.ones((480, 640), np.float32), CAMERA)
    finder.look(frame)
    request = PerceptionRequest(
        publish_ns=STAMP, seq=1, camera_epoch=1, deadline_ns=STAMP * 2, objects=list(objects)
    )
    return finder.find(_header(), request)


def _new(name="cube", wanted=1):
    return RequestedObject(object=name, instance=None, wanted=wanted)


def test_a_new_object_gets_the_best_boxes_and_no_more_than_wanted():
    detector = Seen(
        Detection("cube", LEFT, 0.9), Detection("cube", RIGHT, 0.5), Detection("can", MIDDLE, 0.8)
    )
    found = _answer(detector, _new(), _new("can", 2))
    assert [(d.request.object, d.box, d.score) for d in found] == [("cube", LEFT, 0.9), ("can", MIDDLE, 0.8)]
    assert [d.box for d in _answer(detector, _new(wanted=3))] == [LEFT, RIGHT]
    assert detector.asked[0][1] == ("cube", "can")


def test_a_tracked_instance_gets_the_box_at_its_prediction_and_a_new_one_another():
    detector = Seen(Detection("cube", LEFT, 0.9), Detection("cube", MIDDLE, 0.4))
    tracked = RequestedObject(object="cube", instance=3, prior=_prior())
    found = _answer(detector, tracked, _new(wanted=2))
    assert [(d.request.instance, d.box) for d in found] == [(3, MIDDLE), (None, LEFT)]


def test_what_is_not_seen_gets_nothing():
    assert _answer(Seen(), _new(), RequestedObject(object="cube", instance=3, prior=_prior())) == []


@pytest.mark.parametrize("score", [3.5, -1.0])
def test_scores_stay_on_the_scale_of_the_wire(score):
    (found,) = _answer(Seen(Detection("cube", LEFT, score)), _new())
    assert found.score == min(max(score, 0.0), 1.0)
