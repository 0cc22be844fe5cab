"""Perception that is nearly right: with it the tracker and the re-initialisation loop are measured."""

from __future__ import annotations

import numpy as np

from huepose.believe.state import State
from huepose.datasets.types import VISIBLE
from huepose.estimation.types import PoseEstimate
from huepose.geometry import se3
from huepose.model import ReferenceModel
from huepose.reinit.judge import displacement_m
from huepose.reinit.types import ObjectSlot, Request, RequestedObject
from studies.stress.films import Seen

SHIFT_M, TURN_RAD = 0.002, 0.02
"""Normal errors per axis, as a good single-frame estimate has them."""

SCORE, SCORE_PER_DIAMETER = 1.9, 2.5
"""Scores of the oracle's judge: of a right pose, and what is lost per diameter of displacement, up to 1.2."""


class Oracle:
    """The true pose of an object that is seen well enough, with normal errors, and a fair comparison of it
    with a tracked one."""

    def __init__(self, model: ReferenceModel, seed: int = 0) -> None:
        self._slot = ObjectSlot.of(model)
        self._rng = np.random.default_rng([seed, 50])

    def answer(self, request: Request, seen: Seen) -> list[PoseEstimate]:
        """Estimates of what was asked for and is there."""
        if seen.visib_fract < VISIBLE:
            return []
        return [self._estimate(asked, seen) for asked in request.objects[:1]]

    def _estimate(self, asked: RequestedObject, seen: Seen) -> PoseEstimate:
        slot, truth = self._slot, seen.T_cam_obj
        errors = np.concatenate([self._rng.normal(0, SHIFT_M, 3), self._rng.normal(0, TURN_RAD, 3)])
        T, prior_score, prior = se3.perturb(truth, errors), None, None
        if asked.prior is not None:
            prior = asked.prior.predicted(seen.frame.stamp_ns)
            off = displacement_m(prior, truth, slot) / slot.diameter_m
            prior_score = SCORE - min(SCORE_PER_DIAMETER * max(off - 0.1, 0.0), 1.2)
        instance = -1 if asked.instance is None else asked.instance
        covariance = np.diag([SHIFT_M**2] * 3 + [TURN_RAD**2] * 3)
        return PoseEstimate(
            asked.object, instance, True, T, 0.95, State.TRACKING, SCORE, 0.3, covariance, None, None,
            prior_score, prior, (), 0.1,
        )  # fmt: skip
