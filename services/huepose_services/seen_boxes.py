"""Boxes that a detector sees in the frame's own pixels, given to those who asked for them."""

from __future__ import annotations

from collections.abc import Mapping

from huepose.geometry import Box, RgbdFrame
from huepose.perception.types import Detection, Detector
from huepose_protos.messages import DetectedObject, FrameHeader, PerceptionRequest, RequestedObject
from huepose_services.boxes import ByOutline
from huepose_services.convert import box_to_wire, camera_from_wire
from huepose_services.models import Outline

_SAME_BOX = 0.5


class SeenBoxes(ByOutline):
    """Shown a frame by `look`, it answers `find` about that frame: a tracked instance gets the box that lies
    best on its prediction, a new one the best boxes that lie on nothing tracked."""

    def __init__(self, outlines: Mapping[str, Outline], detector: Detector) -> None:
        super().__init__(outlines)
        self._detector = detector
        self._frame: RgbdFrame | None = None

    def look(self, frame: RgbdFrame) -> None:
        """The frame that the next request is about."""
        self._frame = frame

    def detections(self, names: list[str]) -> list[Detection]:
        """What the detector sees of the named objects, best first."""
        return self._detector.detect(self._frame, names) if self._frame is not None and names else []

    def find(self, header: FrameHeader, request: PerceptionRequest) -> list[DetectedObject]:
        """Boxes, in the request's order."""
        detections = self.detections(list(dict.fromkeys(wanted.object for wanted in request.objects)))
        camera = camera_from_wire(header.intrinsics)
        priors = [self.prior_box(wanted, header, camera) for wanted in request.objects]
        tracked = [box for box in priors if box is not None]
        found: list[DetectedObject] = []
        for wanted, prior in zip(request.objects, priors, strict=True):
            mine = [d for d in detections if d.object == wanted.object]
            if wanted.instance is None:
                new = [d for d in mine if all(d.box.iou(other) < _SAME_BOX for other in tracked)]
                found += [detected(wanted, d) for d in new[: wanted.wanted]]
            elif mine:
                found.append(detected(wanted, mine[0] if prior is None else _nearest(mine, prior)))
        return found


def _nearest(detections: list[Detection], prior: Box) -> Detection:
    return max(detections, key=lambda d: (d.box.iou(prior), d.score))


def detected(wanted: RequestedObject, detection: Detection) -> DetectedObject:
    """A detection as the answer to a request."""
    score = min(max(detection.score, 0.0), 1.0)
    return DetectedObject(request=wanted, box=box_to_wire(detection.box), score=score)
