"""Whether the object of an answer is there at all.

Quality says whether a *pose* is right if it is this object that is seen. At a place that a search proposes,
it may be anything else. `perception.presence` says how likely it is the object, which even one without
texture answers, and no pose of it is surer than that.
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
"""No pose speaks more for its object than one of this quality. Chosen."""

OTHER_TEXTURE = 2.0
"""Another texture must be so many times likelier than the own one before it speaks against it. Chosen."""


class PresenceIn:
    """Presence in one frame. models: all known objects by name, of which the largest decides what is taken
    for a plane; method: the one that answers."""

    def __init__(self, frame: RgbdFrame, models: Mapping[str, ReferenceModel], method: Method) -> None:
        self._models, self._method = models, method
        self._largest_m = max((m.diameter_m for m in list(models.values())), default=0.0)
        self._frame, self._view = frame, clear_view(frame, self._largest_m)

    def asked(self, answer: PoseEstimate) -> PoseEstimate:
        """An answer that says how likely its object is there, 0 where no pose was found, and is no surer of
        its poses than that, if its quality is a probability. Raises KeyError for an object that is not in
        `models`."""
        if answer.T_cam_obj is None:
            return replace(answer, present=0.0)
        logit, _ = self._looked([(answer.object, answer.T_cam_obj)], refined=True)[0]
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
        """Of named objects at poses T_cam_obj (4, 4), refined ones or rough: the probability that they are
        there by what is seen alone, and what speaks most against it, in words."""
        return [(probability(logit), doubt) for logit, doubt in self._looked(poses, refined)]

    def _looked(self, poses: Sequence[tuple[str, Float64]], refined: bool) -> list[tuple[float, str]]:
        """The logit that each is there, and the greatest doubt."""
        out = []
        for name, T_cam_obj in poses:
            model, view = self._models[name], self._view
            if thin(model) and self._whole is not None:
                view = self._whole.given_back([T_cam_obj], model)
            if view is None:
                out.append((-np.inf, "nothing stands there"))
                continue
            sights = sights_of(view, self._models, [(name, T_cam_obj)], verifying=refined)
            out.append((float(logits_of(sights)[0]), greatest_doubt(sights[0])))
        return out

    @cached_property
    def _whole(self) -> ClearView | None:
        return whole_view(self._frame, self._largest_m) if self._view is None else self._view.whole


def _chance(logit: float, answer: PoseEstimate, method: Method) -> float:
    """Probability that the object is there: what is seen, and what its pose says about it."""
    there = probability(logit + certainty(answer))
    return there * _own_texture(answer, method)


def certainty(answer: PoseEstimate) -> float:
    """How sure a pose is of itself, in log odds, 0 or more: one that is surely right speaks for its object;
    one that is not, for want of texture to tell its turn by, does not speak against it."""
    sure = min(max(answer.quality, 0.5), MOST_SURE)
    return float(np.log(sure / (1.0 - sure)))


def _own_texture(answer: PoseEstimate, method: Method) -> float:
    """1, or less where the same shape plainly wears another texture, and so is another thing, by what this
    method knows of textures."""
    if answer.terms is None:
        return 1.0
    own = quality_fits()[method].this_texture(features(answer.terms))
    return min(1.0, OTHER_TEXTURE * own / max(1.0 - own, 1e-9))
