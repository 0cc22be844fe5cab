"""Right and wrong poses of the same frames, as the tracker would judge them: is its probability one?

While tracking goes well there is hardly a wrong pose to learn from. So every n-th frame of a film is judged
at poses that the tracker's refinement reaches from the true one, and from wrong ones: shifted, turned, and
turned over so that the shape nearly fits. Each counts as right or wrong by where it ended, not by where it
began.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.believe.logistic import probability
from huepose.evaluation import metrics
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.judge.borders import continued
from huepose.model.types import ReferenceModel
from huepose.tracking import evidence
from huepose.tracking.refined import best_of
from huepose.tracking.subject import Subject
from huepose.tracking.usual import Usual
from studies.stress.films import Seen

WRONG = 6
UNDECIDED = 0.0
"""Log-odds of a pose beforehand: nothing is known."""

LEAST_VISIBLE = 0.3

UNTIL_SETTLED = 12
"""Passes of the refinement. The tracker goes on with an unfinished one in its next frames; here there are
none, and a pose that is still on its way is neither right nor wrong."""


def challenge(frames: Sequence[Seen], model: ReferenceModel, every: int) -> tuple[Float64, Bool]:
    """Qualities (N,) and which poses were right (N,), over the frames in which the object is visible."""
    rng = np.random.default_rng([0, 90])
    subject, usual = Subject.of(model), Usual()
    qualities: list[float] = []
    right: list[bool] = []
    for seen in frames[::every]:
        if seen.visib_fract < LEAST_VISIBLE:
            continue
        truth = seen.T_cam_obj
        for i, start in enumerate([truth, *wrong_starts(truth, model, rng)]):
            step = best_of(subject.surface, seen.frame, [(start, "still")], more_passes=UNTIL_SETTLED)
            add = metrics.add(model.eval_points, step.T_cam_obj, truth)
            goes_on = continued(subject.contours, step.T_cam_obj, seen.frame)
            odds = evidence.log_odds(step.terms, usual.baseline, UNDECIDED, goes_on)
            qualities.append(probability(odds))
            right.append(add < metrics.RECALL_FRACTION * model.diameter_m)
            if i == 0:
                usual = usual.after(step.terms)
    return np.array(qualities), np.array(right, bool)


def wrong_starts(truth: Float64, model: ReferenceModel, rng: np.random.Generator) -> list[Float64]:
    """Poses off by up to half a diameter and by up to half a turn, and near-symmetric rotations of the
    object."""
    out = []
    for _ in range(WRONG):
        shift = rng.normal(0.0, 0.15 * model.diameter_m, 3)
        axis = rng.normal(size=3)
        turn = axis / np.linalg.norm(axis) * rng.uniform(0.1, np.pi)
        out.append(se3.perturb(truth, np.concatenate([shift, turn])))
    return out + [
        truth @ turn for turn in model.near_symmetries[1:][:: max(1, len(model.near_symmetries) // 3)]
    ]
