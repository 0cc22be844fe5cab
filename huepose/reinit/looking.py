"""How a request is answered: in which boxes of the frame its objects are looked for, and what the estimator
is asked there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

from huepose.estimation.types import ObjectQuery, PosePrior
from huepose.geometry import Box, Camera, RgbdFrame
from huepose.geometry.arrays import Bool, Float64
from huepose.reinit.types import Prior, RequestedObject

if TYPE_CHECKING:
    from huepose.perception.types import Detection
    from huepose.perception.view_detector import ViewDetector

SAME_BOX = 0.5
"""A found box with this IoU with the box of a tracked object lies on that object."""

FRESH_S, FRESH_MARGIN = 0.5, 0.08
"""Up to this age a prediction gives the box in which an object is looked for, grown by that share."""

NEW_TURNS = 2
"""This many objects that never had a turn have it at once. More would delay objects that the first look
finds, which are most (docs/detection_measured.md)."""


class Outlined(Protocol):
    """What the search needs to know of an object."""

    @property
    def middle_obj(self) -> Float64:
        """The middle (3,) of its bounds, object axes."""
        ...

    def box(self, T_cam_obj: Float64, camera: Camera) -> Box | None:
        """Its box at a pose (4, 4) in a camera's image; None outside of it."""
        ...


class Place(NamedTuple):
    """A box to look in, and the probability that the object is there."""

    box: Box
    score: float = 1.0


class Looks:
    """Decides where to look: in the box of a fresh prediction, else in those that a detector finds
    (`chosen`).

    One missing object at a time, in turns, is searched for with full effort: so a request costs the same
    however many are missing. Of those that never had a turn NEW_TURNS have it at once."""

    def __init__(self, detector: ViewDetector, outlines: Mapping[str, Outlined]) -> None:
        self._detector, self._outlines = detector, outlines
        self._turns: list[str] = []

    def places(
        self,
        frame: RgbdFrame,
        objects: Sequence[RequestedObject],
        waiting: Sequence[RequestedObject] = (),
    ) -> list[list[Place]]:
        """The places for each object, best first, then those for each of `waiting`: these are looked for
        where something new in the image looks like them."""
        every = [*objects, *waiting]
        predicted = [self._predicted(asked, frame) for asked in every]
        missing = (a for a, box in zip(objects, predicted, strict=False) if box is None)
        names = list(dict.fromkeys(asked.object for asked in missing))
        followed = {
            asked.object: _predicted(asked.others, frame, self._outlines[asked.object])
            for asked in every
            if asked.others
        }
        wanted: Counter[str] = Counter()
        for asked, box in zip(every, predicted, strict=True):
            if box is None:
                wanted[asked.object] += asked.wanted
        turn = self.turn(names) if names else []
        also = [asked.object for asked in waiting]
        seen = self._detector.detect(frame, names, turn, followed, wanted, also) if wanted else []
        tracked = [(a.object, box) for a, box in zip(every, predicted, strict=True) if box is not None]
        places: list[list[Place]] = []
        for asked, box in zip(every, predicted, strict=True):
            if box is not None:
                places.append([Place(box)])
                continue
            if asked.instance is None:
                mine = chosen(seen, asked.object, asked.wanted, tracked)
            else:
                mine = of_tracked(seen, asked.object, self._expected(asked, frame))
            places.append([Place(d.box, d.score) for d in mine])
        return places

    def turn(self, names: Sequence[str]) -> list[str]:
        """The objects whose turn it is: those that never had one, or the one whose turn is longest ago."""
        turn = [name for name in names if name not in self._turns][:NEW_TURNS]
        turn = turn or [min(names, key=self._turns.index)]
        self._turns = [name for name in self._turns if name not in turn] + turn
        return turn

    def _expected(self, asked: RequestedObject, frame: RgbdFrame) -> Box | None:
        """The box of a prediction of any age; None without one in the image."""
        if asked.prior is None:
            return None
        outline = self._outlines[asked.object]
        return outline.box(_predicted([asked.prior], frame, outline)[0], frame.camera)

    def _predicted(self, asked: RequestedObject, frame: RgbdFrame) -> Box | None:
        """The box of a fresh prediction, a little grown; None without one in the image."""
        prior, camera = asked.prior, frame.camera
        if prior is None or (frame.stamp_ns - prior.stamp_ns) * 1e-9 > FRESH_S:
            return None
        box = self._expected(asked, frame)
        box = None if box is None else box.grown(FRESH_MARGIN).clipped(camera.width, camera.height)
        return box if box is not None and box.w >= 1.0 and box.h >= 1.0 else None


def _predicted(priors: Sequence[Prior], frame: RgbdFrame, outline: Outlined) -> list[Float64]:
    return [prior.predicted(frame.stamp_ns, outline.middle_obj) for prior in priors]


def chosen(
    seen: Sequence[Detection], name: str, wanted: int, tracked: Sequence[tuple[str, Box]]
) -> list[Detection]:
    """Which places of a detector are looked at for new instances of an object, best first: as many as are
    wanted of those without a tracked object on them, and its best one, even if another object is tracked
    there: only estimates of both tell which fits better. tracked: names and boxes; no new instance is where
    one of the same object is tracked."""
    own, any_of_them = [box for other, box in tracked if other == name], [box for _, box in tracked]
    mine = [d for d in seen if d.object == name and _lies_on_none(d.box, own)]
    free = [d for d in mine if _lies_on_none(d.box, any_of_them)][:wanted]
    return [d for d in mine if d is mine[0] or d in free]


def of_tracked(seen: Sequence[Detection], name: str, expected: Box | None) -> list[Detection]:
    """Which place of a detector, of those best first, is looked at for a tracked instance of an object: the
    one that overlaps most with the box that is expected for it, if there is one."""
    mine = [d for d in seen if d.object == name]
    return sorted(mine, key=lambda d: 0.0 if expected is None else -d.box.iou(expected))[:1]


def _lies_on_none(box: Box, boxes: Sequence[Box]) -> bool:
    return all(box.iou(other) < SAME_BOX for other in boxes)


def query_of(
    asked: RequestedObject, box: Box, stamp_ns: int, middle_obj: Float64, masks: tuple[Bool, ...] = ()
) -> ObjectQuery:
    """The query for the estimator: an object with that middle (3,) in a box, with candidate masks (H, W), of
    a frame with that timestamp."""
    prior = asked.prior
    return ObjectQuery(
        asked.object,
        box=box,
        masks=masks,
        prior=None if prior is None else PosePrior(prior.predicted(stamp_ns, middle_obj)),
        instance=-1 if asked.instance is None else asked.instance,
        searched=not asked.known,
        others=tuple(other.predicted(stamp_ns, middle_obj) for other in asked.others),
    )
