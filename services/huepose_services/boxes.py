"""Boxes of requested objects: from a detector, or from the prediction of a track.

There is one class for each `detector.kind`: SeenBoxes (yolo), SearchedBoxes (views).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from huepose.geometry import Box, Camera, RgbdFrame
from huepose.model import ReferenceModel
from huepose.perception.exchanged import ChannelOrder, order_of_channels
from huepose.perception.types import Detection
from huepose.perception.view_detector import ViewDetector
from huepose.perception.yolo import YoloDetector
from huepose.reinit.looking import Looks, chosen, of_tracked
from huepose_protos.messages import (
    DetectedObject,
    FrameHeader,
    PerceptionRequest,
    Prior,
    RequestedObject,
)
from huepose_services.convert import (
    box_to_wire,
    camera_from_wire,
    prior_from_wire,
    requested_from_wire,
)
from huepose_services.following import Retired
from huepose_services.models import Outline, outline
from huepose_services.networks import never_boxed
from huepose_services.runtime.clock import SECOND

_HINT_NS = 3 * SECOND

Pixels = Callable[[], RgbdFrame]
"""The frame that a request is about. Raises WireError if its header and payload do not fit together."""


class BoxFinder:
    """Answers a request with boxes in one frame; an object that is not visible gets none. outlines: of all
    known objects, by name."""

    def __init__(self, outlines: Mapping[str, Outline]) -> None:
        self._outlines = dict(outlines)

    def add(self, model: ReferenceModel) -> None:
        """Add an object, or replace its model."""
        self._outlines[model.name] = outline(model)

    def remove(self, name: str) -> None:
        """Remove an object; nothing happens if it is not known."""
        self._outlines.pop(name, None)

    def find(self, header: FrameHeader, request: PerceptionRequest, pixels: Pixels) -> list[DetectedObject]:
        """Boxes in the order of the request; for objects that wait, only where something looks like them.
        pixels: called by finders that look at the frame."""
        raise NotImplementedError

    def lacks(self) -> str:
        """A sentence about the objects that never get a box; empty if there are none."""
        return ""

    def order_of_channels(
        self, frame: RgbdFrame, names: Sequence[str], seen: Mapping[str, float]
    ) -> ChannelOrder:
        """What a frame shows about the order of its colour channels, judged by the objects of these names.
        seen: scores of the objects that were searched for in it."""
        return ChannelOrder()

    def prior_box(self, name: str, prior: Prior | None, header: FrameHeader, camera: Camera) -> Box | None:
        """The box of a tracked instance at its predicted pose; None without a prior, or outside the
        image."""
        outline = self._outlines.get(name)
        if prior is None or outline is None:
            return None
        T_cam_obj = prior_from_wire(prior).predicted(header.capture_ns, outline.middle_obj)
        return outline.box(T_cam_obj, camera)

    def assigned(
        self, detections: Sequence[Detection], header: FrameHeader, request: PerceptionRequest
    ) -> list[DetectedObject]:
        """Assign detections, best first, to the objects of a request: a tracked instance gets the box that
        `of_tracked` returns, a new one those of `chosen`."""
        camera = camera_from_wire(header.intrinsics)
        tracked = [
            (wanted.object, box)
            for wanted in request.objects
            for prior in (wanted.prior, *wanted.others)
            if (box := self.prior_box(wanted.object, prior, header, camera)) is not None
        ]
        found: list[DetectedObject] = []
        for wanted in (*request.objects, *request.waiting):
            if wanted.instance is None:
                mine = chosen(detections, wanted.object, wanted.wanted, tracked)
            else:
                prior = self.prior_box(wanted.object, wanted.prior, header, camera)
                mine = of_tracked(detections, wanted.object, prior)
            found += [detected(wanted, d.box, d.score) for d in mine]
        return found


class SeenBoxes(BoxFinder):
    """The boxes of a network that detects objects."""

    def __init__(self, outlines: Mapping[str, Outline], detector: YoloDetector) -> None:
        super().__init__(outlines)
        self._detector = detector

    def lacks(self) -> str:
        """A sentence about the objects for which the network has no class."""
        return never_boxed(self._detector, self._outlines)

    def find(self, header: FrameHeader, request: PerceptionRequest, pixels: Pixels) -> list[DetectedObject]:
        """Boxes in the order of the request."""
        asked = (*request.objects, *request.waiting)
        frame, names = pixels(), list(dict.fromkeys(wanted.object for wanted in asked))
        return self.assigned(self._detector.detect(frame, names) if names else [], header, request)


class SearchedBoxes(BoxFinder):
    """The boxes of the detector that needs no training on the objects, and of predictions: see `Looks`."""

    def __init__(self, outlines: Mapping[str, Outline], detector: ViewDetector) -> None:
        super().__init__(outlines)
        self._searcher = detector
        self._looks = Looks(detector, self._outlines)

    def add(self, model: ReferenceModel) -> None:
        """Add an object, or replace its model."""
        super().add(model)
        self._searcher.add(model)

    def remove(self, name: str) -> None:
        """Remove an object; nothing happens if it is not known."""
        super().remove(name)
        self._searcher.remove(name)

    def find(self, header: FrameHeader, request: PerceptionRequest, pixels: Pixels) -> list[DetectedObject]:
        """Boxes in the order of the request."""
        asked, waiting = (
            [wanted for wanted in some if wanted.object in self._outlines]
            for some in (request.objects, request.waiting)
        )
        places = self._looks.places(
            pixels(), list(map(requested_from_wire, asked)), list(map(requested_from_wire, waiting))
        )
        return [
            detected(wanted, place.box, place.score)
            for wanted, mine in zip((*asked, *waiting), places, strict=True)
            for place in mine
        ]

    def order_of_channels(
        self, frame: RgbdFrame, names: Sequence[str], seen: Mapping[str, float]
    ) -> ChannelOrder:
        """Judged by one of the objects; they take turns, as in `find`."""
        known = [name for name in names if name in self._outlines]
        asked = self._looks.turn(known)[:1] if known else []
        return order_of_channels(frame, self._searcher, asked, seen) if asked else ChannelOrder()


class Hints:
    """Boxes that a user gave: for three seconds, or until the object has a pose, it is searched for
    there."""

    def __init__(self) -> None:
        self._boxes: dict[str, tuple[Box, int]] = {}
        self._retired = Retired()

    def point(self, name: str, box: Box, now_ns: int, retired: tuple[int, int] | None = None) -> None:
        """Take a box that a user gave now. retired: camera epoch and number; instances below ended by it."""
        self._boxes[name] = (box, now_ns + _HINT_NS)
        self._retired.add(name, retired)

    def applied(
        self, found: list[DetectedObject], header: FrameHeader, request: PerceptionRequest, now_ns: int
    ) -> list[DetectedObject]:
        """The boxes that were found; the objects with a hint get the hint instead."""
        for wanted in request.objects:
            box, until_ns = self._boxes.get(wanted.object, (None, 0))
            if box is None:
                continue
            instance = wanted.instance
            if instance is not None and self._retired.includes(wanted.object, header.camera_epoch, instance):
                continue  # a request from before the reset
            if instance is not None or now_ns > until_ns:
                del self._boxes[wanted.object]
                continue
            clipped = box.clipped(header.intrinsics.width, header.intrinsics.height)
            if clipped.w >= 1.0 and clipped.h >= 1.0:
                others = [d for d in found if d.request is not wanted]
                found = [*others, detected(wanted, clipped)]
        return found


def detected(wanted: RequestedObject, box: Box, score: float = 1.0) -> DetectedObject:
    """A box as the answer to a request."""
    return DetectedObject(request=wanted, box=box_to_wire(box), score=min(max(score, 0.0), 1.0))
