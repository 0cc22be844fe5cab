"""A cube in the middle of an image, a detector with given results, and requests: shared by the tests of box
finders."""

import numpy as np

from huepose.geometry import Box, Camera, RgbdFrame
from huepose_protos.messages import (
    BufferSpec,
    FrameHeader,
    Intrinsics,
    PerceptionRequest,
    Prior,
    RequestedObject,
)
from huepose_services.convert import to_wire
from huepose_services.models import Outline
from huepose_services.runtime.clock import this_clock

CAMERA = Camera(500.0, 500.0, 320.0, 240.0, 640, 480)
STAMP = 10_000_000_000
# Of 10 cm, 1 m away: 50 pixels wide, a little more for its near side.
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32) * 0.05
MIDDLE = Box(294.0, 214.0, 53.0, 53.0)
LEFT, RIGHT = Box(50, 200, 60, 60), Box(500, 200, 60, 60)


class FakeDetector:
    """A detector that gives its detections of the requested objects, and of waiting objects that are
    `noticed`; it keeps the requests."""

    def __init__(self, *detections, noticed=()):
        self.detections, self.asked, self.thorough, self.followed = detections, [], [], {}
        self.waiting, self.noticed, self.wanted = [], noticed, []

    def detect(self, frame, names, thorough=(), followed=None, wanted=None, waiting=()):
        self.asked.append(tuple(names))
        self.followed = followed
        self.wanted.append(dict(wanted or {}))
        self.thorough.append(list(thorough))
        self.waiting.append(tuple(waiting))
        seen = {*names, *(name for name in waiting if name in self.noticed)}
        return [d for d in self.detections if d.object in seen]


def outlines(*names):
    """Objects that all have the cube's outline."""
    return {name: Outline(CORNERS, 0.17) for name in names}


def answer(finder, *objects, waiting=()):
    """The answer of a box finder to a request about a frame."""
    depth = np.ones((480, 640), np.float32)
    frame = RgbdFrame(np.zeros((480, 640, 3), np.uint8), depth, CAMERA, 7, STAMP, 1)
    header = FrameHeader(
        publish_ns=STAMP,
        camera_epoch=1,
        frame_id=7,
        capture_ns=STAMP,
        clock=this_clock(),
        frame="cam0_color_optical",
        intrinsics=to_wire(Intrinsics, CAMERA, depth_scale_m=0.0001),
        buffers=[BufferSpec(name="color", dtype="uint8", shape=(480, 640, 3), offset=0)],
    )
    request = PerceptionRequest(
        publish_ns=STAMP,
        seq=1,
        camera_epoch=1,
        deadline_ns=STAMP * 2,
        objects=list(objects),
        waiting=list(waiting),
    )
    return finder.find(header, request, lambda: frame)


def tracked(age_s=0.0):
    """A request for the cube as instance 3, with its pose of `age_s` ago."""
    prior = Prior(
        translation=(0.0, 0.0, 1.0), quaternion=(0.0, 0.0, 0.0, 1.0), stamp_ns=STAMP - round(age_s * 1e9)
    )
    return RequestedObject(object="cube", instance=3, prior=prior)


def new(name="cube", wanted=1, others=()):
    """A request for new instances; others: priors of the tracked ones."""
    return RequestedObject(object=name, instance=None, wanted=wanted, others=list(others))
