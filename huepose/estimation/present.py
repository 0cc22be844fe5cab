"""Whether the objects of a frame's answers are there at all.

Quality says whether a *pose* is right. Whether the object is there is another question, which even an object
without texture answers: `perception.presence` does, on all answers of a frame together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from huepose.believe.logistic import probability
from huepose.believe.presence import greatest_doubt, logits_of
from huepose.believe.quality import features, quality_fits
from huepose.estimation.config import Method, StandingConfig
from huepose.estimation.types import PoseEstimate
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import clear_view
from huepose.perception.presence import sights_of

Presence = Callable[[RgbdFrame, Sequence[PoseEstimate]], Sequence[float]]
"""Of the answers of a frame, the probability of each that its object is there."""


def presence_by(models: Mapping[str, ReferenceModel], method: Method) -> Presence:
    """By `perception.presence`, of the objects of these models, for answers of a method."""
    return lambda frame, answers: presences_of(frame, models, answers, method)


def presences_of(
    frame: RgbdFrame,
    models: Mapping[str, ReferenceModel],
    answers: Sequence[PoseEstimate],
    method: Method,
) -> list[float]:
    """Probability for each answer of a method that its object is there, 0 where none was found. Raises
    KeyError for an answer about an object that is not in `models`."""
    return [chance for chance, _ in presences_with_doubts(frame, models, answers, method)]


def presences_with_doubts(
    frame: RgbdFrame,
    models: Mapping[str, ReferenceModel],
    answers: Sequence[PoseEstimate],
    method: Method,
) -> list[tuple[float, str]]:
    """The same, each with what speaks most against the object, in words; empty where no pose was found."""
    poses = [(a.object, a.T_cam_obj) for a in answers if a.T_cam_obj is not None]
    seen = iter(_looked_at(frame, models, poses))
    out = []
    for answer in answers:
        if answer.T_cam_obj is None:
            out.append((0.0, ""))
        else:
            logit, doubt = next(seen)
            out.append((_chance(logit, answer, method), doubt))
    return out


def places_with_doubts(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], poses: Sequence[tuple[str, Float64]]
) -> list[tuple[float, str]]:
    """Of named objects at poses T_cam_obj (4, 4) that nobody estimated: the probability that they are there
    by what is seen alone, and what speaks most against it, in words."""
    return [(probability(logit), doubt) for logit, doubt in _looked_at(frame, models, poses)]


def _looked_at(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], poses: Sequence[tuple[str, Float64]]
) -> list[tuple[float, str]]:
    """Of named objects at poses T_cam_obj (4, 4): the logit that they are there, and the greatest doubt."""
    view = clear_view(frame, max((m.diameter_m for m in models.values()), default=0.0))
    if view is None:
        return [(-np.inf, "nothing stands there")] * len(poses)
    sights = sights_of(view, models, poses)
    return [(float(x), greatest_doubt(s)) for s, x in zip(sights, logits_of(sights), strict=True)]


def _chance(logit: float, answer: PoseEstimate, method: Method) -> float:
    """Probability that the object is there: what is seen, and what its pose says about it."""
    there = probability(logit + certainty(answer))
    return there * _own_texture(answer, method)


def certainty(answer: PoseEstimate) -> float:
    """How sure a pose is of itself, in log odds, 0 or more: one that is surely right speaks for its object;
    one that is not, for want of texture to tell its turn by, does not speak against it."""
    sure = min(max(answer.quality, 0.5), StandingConfig().most_sure)
    return float(np.log(sure / (1.0 - sure)))


def _own_texture(answer: PoseEstimate, method: Method) -> float:
    """1, or less where the same shape plainly wears another texture, and so is another thing, by what this
    method knows of textures."""
    if answer.terms is None:
        return 1.0
    own = quality_fits()[method].this_texture(features(answer.terms))
    return min(1.0, StandingConfig().other_texture * own / max(1.0 - own, 1e-9))
