"""Input and output of the estimator."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from huepose.believe.quality import QualityTerms
from huepose.believe.state import State
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.support.errors import InputError, require


@dataclass(frozen=True, eq=False)
class PosePrior:
    """A tracked pose T_cam_obj (4, 4) of the object, predicted to the frame's timestamp. It is refined and
    scored like any hypothesis."""

    T_cam_obj: Float64


@dataclass(frozen=True, eq=False)
class ObjectQuery:
    """One object to look for: in a box, or in given candidate masks (H, W), with an optional prior.

    With neither box nor masks, the bounds of the prior's outline are the box; with nothing at all, InputError
    is raised, as for a box or prior of another type, a pose of another shape, or numbers that are not finite.
    `instance` is copied to the estimate. searched: the place is a proposal, and the object may not be there;
    the estimate then has the probability that it is there (`present`), and its quality is never higher.
    others: poses T_cam_obj (4, 4) of other instances of the object; this one is not searched there.
    """

    object: str
    box: Box | None = None
    masks: tuple[Bool, ...] = ()
    prior: PosePrior | None = None
    instance: int = 0
    searched: bool = False
    others: tuple[Float64, ...] = ()

    def __post_init__(self) -> None:
        if self.box is not None:
            what, fix = f"box of '{self.object}'", "Make one: Box(x, y, w, h), in pixels."
            require(self.box, Box, what, "a Box", fix)
            if not all(map(math.isfinite, self.box)):
                raise InputError(what, found=str(self.box), expected="finite numbers", fix=fix)
        poses = []
        if self.prior is not None:
            what, fix = f"prior of '{self.object}'", "Make one: PosePrior(T_cam_obj)."
            require(self.prior, PosePrior, what, "a PosePrior", fix)
            poses = [("prior", self.prior.T_cam_obj)]
        for name, T in [*poses, *(("others", T) for T in self.others)]:
            if np.shape(T) != (4, 4) or not np.isfinite(T).all():
                found = f"{np.shape(T)} numbers" if np.shape(T) != (4, 4) else "numbers that are not finite"
                raise InputError(f"{name} of '{self.object}'", found=found, expected="poses (4, 4)")


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The estimate for one query. The defaults are those of an object of which no pose was found.

    found is False when nothing was there to estimate; then T_cam_obj, covariance and mask are None. T_cam_obj
    (4, 4) float64: object to camera, metres; covariance (6, 6): order tx ty tz rx ry rz, metres and radians,
    about the object's origin, camera axes; mask (H, W) bool: pixels of the object; box: of the pose, pixels.
    score: the dense score of the pose, comparable between poses on the same pixels; prior_score: that of the
    refined prior, None without one; prior_T_cam_obj (4, 4): the refined prior. margin: score above the best
    clearly different pose. quality: calibrated probability that the pose is right (method `paper`: its
    fitness in 0..1, which is no probability). state: as of a track; TRACKING over the acquisition level, else
    SUSPECT; LOST when not found. alternatives: other poses (4, 4) and their probabilities. seconds: wall time
    of this estimate. terms: from which the quality was computed. reason: if no pose was found, why, in one
    sentence (if no object of the frame was found, a fault of the frame comes first); if one was found, why it
    must not be acted on, if that is known; else empty. present: probability that the object is there at all,
    whatever its pose; None unless asked for (`ObjectQuery.searched`).
    """

    object: str
    instance: int = 0
    found: bool = False
    T_cam_obj: Float64 | None = None
    quality: float = 0.0
    state: State = State.LOST
    score: float = 0.0
    margin: float = 0.0
    covariance: Float64 | None = None
    mask: Bool | None = None
    box: Box | None = None
    prior_score: float | None = None
    prior_T_cam_obj: Float64 | None = None
    alternatives: tuple[tuple[Float64, float], ...] = ()
    seconds: float = 0.0
    terms: QualityTerms | None = None
    reason: str = ""
    present: float | None = None

    @property
    def chance(self) -> float:
        """The probability that its object is there; if that was not asked for, that its pose is right."""
        return self.quality if self.present is None else self.present
