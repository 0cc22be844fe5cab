"""Is the object of an estimate there at all?

Quality is the probability that a *pose* is right if the frame shows this object. At a place that a search
proposes, anything else may be. `perception.presence` gives the probability that it is the object, even for an
object without texture. The quality of a pose is never higher than that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from huepose.believe.logistic import probability
from huepose.believe.presence import greatest_doubt, logits_of
from huepose.believe.quality import features, quality_fits
from huepose.believe.state import State
from huepose.estimation.config import Method
from huepose.estimation.types import PoseEstimate
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView, clear_view, thin, whole_view
from huepose.perception.presence import sights_of

MOST_SURE = 0.99
"""A pose of higher quality is no stronger evidence for its object. Chosen."""

OTHER_TEXTURE = 2.0
"""Another texture is evidence against the object only if it is this many times likelier than the object's
own. Chosen."""


class PresenceIn:
    """Presence in one frame. models: all known objects by name, of which the largest decides what counts as a
    plane; method: the one that made the estimates."""

    def __init__(self, frame: RgbdFrame, models: Mapping[str, ReferenceModel], method: Method) -> None:
        self._models, self._method = models, method
        self._largest_m = max((m.diameter_m for m in list(models.values())), default=0.0)
        self._frame, self._view = frame, clear_view(frame, self._largest_m)

    def with_presence(self, answer: PoseEstimate) -> PoseEstimate:
        """The estimate with the probability that its object is there (`present`), 0 if no pose was found. If
        its quality is a probability, its poses get no higher probability than that. Raises KeyError for an
        object that is not in `models`."""
        if answer.T_cam_obj is None:
            return replace(answer, present=0.0)
        logit, _ = self._judged([(answer.object, answer.T_cam_obj)], refined=True)[0]
        present = _chance(logit, answer, self._method)
        fit = quality_fits().get(self._method)
        if fit is None:
            return replace(answer, present=present)
        share = min(1.0, present / max(answer.quality, 1e-9))
        quality = answer.quality * share
        return replace(
            answer,
            present=present,
            quality=quality,
            state=State.TRACKING if quality >= fit.level else State.SUSPECT,
            alternatives=tuple((T, p * share) for T, p in answer.alternatives),
        )

    def places(self, poses: Sequence[tuple[str, Float64]], refined: bool = True) -> list[tuple[float, str]]:
        """For named objects at poses T_cam_obj (4, 4), refined or rough: the probability that each is there,
        from the frame alone, and the strongest evidence against it, in words."""
        return [(probability(logit), doubt) for logit, doubt in self._judged(poses, refined)]

    def _judged(self, poses: Sequence[tuple[str, Float64]], refined: bool) -> list[tuple[float, str]]:
        """The logit that each object is there, and the strongest evidence against it."""
        out = []
        for name, T_cam_obj in poses:
            model, view = self._models[name], self._view
            if thin(model) and self._whole is not None:
                view = self._whole.given_back([T_cam_obj], model)
            if view is None:
                out.append((-np.inf, "nothing is there"))
                continue
            sights = sights_of(view, self._models, [(name, T_cam_obj)], verifying=refined)
            out.append((float(logits_of(sights)[0]), greatest_doubt(sights[0])))
        return out

    @cached_property
    def _whole(self) -> ClearView | None:
        return whole_view(self._frame, self._largest_m) if self._view is None else self._view.whole


def _chance(logit: float, answer: PoseEstimate, method: Method) -> float:
    """Probability that the object is there, from the frame and from its pose."""
    there = probability(logit + certainty(answer))
    return there * _own_texture(answer, method)


def certainty(answer: PoseEstimate) -> float:
    """How sure a pose is, in log odds, 0 or more. A pose that is surely right is evidence for its object. One
    that is not, for lack of texture that fixes its rotation, is no evidence against it."""
    sure = min(max(answer.quality, 0.5), MOST_SURE)
    return float(np.log(sure / (1.0 - sure)))


def _own_texture(answer: PoseEstimate, method: Method) -> float:
    """1, or less if the same shape clearly has another texture, so that it is another object, according to
    the fit of this method."""
    if answer.terms is None:
        return 1.0
    own = quality_fits()[method].this_texture(features(answer.terms))
    return min(1.0, OTHER_TEXTURE * own / max(1.0 - own, 1e-9))
