"""Boxes of the detector that needs no weights: it searches for what has no pose; what is tracked is where its
prediction says."""

from __future__ import annotations

from collections.abc import Mapping

from huepose.geometry import Box, Camera
from huepose.model import ReferenceModel
from huepose.perception.colorpair_detector import ColorPairDetector
from huepose.perception.types import Detection
from huepose_protos.messages import DetectedObject, FrameHeader, PerceptionRequest, RequestedObject
from huepose_services.boxes import SAME_BOX, SeenBoxes, detected
from huepose_services.convert import camera_from_wire
from huepose_services.models import Outline


class SearchedBoxes(SeenBoxes):
    """As for any detector, but it is asked only for objects without a prediction that can be trusted.

    One of these at a time, by turns, is searched everywhere: a request costs the same whoever is missing."""

    def __init__(self, outlines: Mapping[str, Outline], detector: ColorPairDetector) -> None:
        super().__init__(outlines, detector)
        self._searcher = detector
        self._turns: list[str] = []

    def add(self, model: ReferenceModel) -> None:
        """Know one more object, or another model of it."""
        super().add(model)
        self._searcher.add(model)

    def remove(self, name: str) -> None:
        """Forget an object; nothing happens when it is not known."""
        super().remove(name)
        self._searcher.remove(name)

    def find(self, header: FrameHeader, request: PerceptionRequest) -> list[DetectedObject]:
        """Boxes, in the request's order."""
        camera = camera_from_wire(header.intrinsics)
        predicted = [self._predicted(wanted, header, camera) for wanted in request.objects]
        names = [w.object for w, box in zip(request.objects, predicted, strict=True) if box is None]
        seen = self.detections([name for name in dict.fromkeys(names) if name in self._outlines])
        taken = [box for box in predicted if box is not None]
        found: list[DetectedObject] = []
        for wanted, box in zip(request.objects, predicted, strict=True):
            if box is not None:
                found.append(detected(wanted, box))
                continue
            mine = [d for d in seen if d.object == wanted.object]
            free = [d for d in mine if all(d.box.iou(other) < SAME_BOX for other in taken)]
            found += [detected(wanted, d.box, d.score) for d in free[: wanted.wanted]]
        return found

    def detections(self, names: list[str]) -> list[Detection]:
        """What the detector sees of the named objects, best first."""
        if self._frame is None or not names:
            return []
        # Whose turn is longest ago comes first; who never had one, before all.
        turn = min(names, key=lambda name: self._turns.index(name) if name in self._turns else -1)
        self._turns = [name for name in self._turns if name != turn] + [turn]
        return self._searcher.detect(self._frame, names, (turn,))

    def _predicted(self, wanted: RequestedObject, header: FrameHeader, camera: Camera) -> Box | None:
        """The box of a fresh prediction; None where there is none in the image."""
        box = self.fresh_box(wanted, header, camera)
        box = None if box is None else box.clipped(camera.width, camera.height)
        return box if box is not None and box.w >= 1.0 and box.h >= 1.0 else None
