"""The detector without weights searches for what has no pose, and takes predictions for the rest."""

import numpy as np

from huepose.geometry import Box, Camera, RgbdFrame
from huepose.perception.types import Detection
from huepose_protos.messages import BufferSpec, FrameHeader, PerceptionRequest, Prior, RequestedObject
from huepose_services.convert import intrinsics_to_wire
from huepose_services.models import Outline
from huepose_services.runtime.clock import this_clock
from huepose_services.searched_boxes import SearchedBoxes

CAMERA = Camera(500.0, 500.0, 320.0, 240.0, 640, 480)
STAMP = 10_000_000_000
# A cube of 10 cm, 1 m away in the middle of the picture: 53 pixels wide.
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32) * 0.05
MIDDLE = Box(294.0, 214.0, 53.0, 53.0)
LEFT, RIGHT = Box(50, 200, 60, 60), Box(500, 200, 60, 60)


class Searcher:
    """Finds what it was told, and remembers what it was asked for."""

    def __init__(self, *detections):
        self.detections, self.asked = detections, []

    def detect(self, frame, names):
        self.asked.append(tuple(names))
        return [d for d in self.detections if d.object in names]


def _find(detector, *objects):
    outlines = {name: Outline(name, 1, CORNERS, 0.17) for name in ("cube", "can")}
    finder = SearchedBoxes(outlines, detector)
    finder.look(RgbdFrame(np.zeros((480, 640, 3), np.uint8), np.ones((480, 640), np.float32), CAMERA))
    header = FrameHeader(
        publish_ns=STAMP,
        camera_epoch=1,
        frame_id=7,
        capture_ns=STAMP,
        clock=this_clock(),
        frame="cam0_color_optical",
        intrinsics=intrinsics_to_wire(CAMERA, 0.0001),
        buffers=[BufferSpec(name="color", dtype="uint8", shape=(480, 640, 3), offset=0)],
    )
    request = PerceptionRequest(
        publish_ns=STAMP, seq=1, camera_epoch=1, deadline_ns=STAMP * 2, objects=list(objects)
    )
    return finder.find(header, request)


def _tracked(age_s=0.0):
    prior = Prior(
        translation=(0.0, 0.0, 1.0), quaternion=(0.0, 0.0, 0.0, 1.0), stamp_ns=STAMP - round(age_s * 1e9)
    )
    return RequestedObject(object="cube", instance=3, prior=prior)


def _new(name="cube", wanted=1):
    return RequestedObject(object=name, instance=None, wanted=wanted)


def test_what_is_tracked_is_not_searched_for():
    detector = Searcher(Detection("cube", LEFT, 0.9))
    (found,) = _find(detector, _tracked())
    assert Box(*found.box).iou(MIDDLE.grown(0.08)) > 0.95
    assert detector.asked == []


def test_an_old_prediction_is_not_trusted():
    detector = Searcher(Detection("cube", LEFT, 0.9))
    assert [d.box for d in _find(detector, _tracked(age_s=2.0))] == [LEFT]


def test_what_has_no_pose_is_searched_for_away_from_what_has_one():
    detector = Searcher(
        Detection("cube", MIDDLE, 0.9), Detection("cube", RIGHT, 0.5), Detection("can", LEFT, 0.8)
    )
    found = _find(detector, _tracked(), _new(), _new("can"))
    assert [(d.request.instance, d.request.object) for d in found] == [
        (3, "cube"),
        (None, "cube"),
        (None, "can"),
    ]
    assert [d.box for d in found[1:]] == [RIGHT, LEFT]
    assert detector.asked == [("cube", "can")]


def test_an_object_whose_model_is_not_here_yet_gets_nothing():
    detector = Searcher(Detection("cube", LEFT, 0.9))
    assert _find(detector, _new("bowl")) == []
    assert detector.asked == []
