"""Right and wrong poses of the same frames, as the tracker would judge them: is its probability one?

While tracking goes well there is hardly a wrong pose to learn from. So every n-th frame of a film is judged
at poses that the tracker's refinement reaches from the true one, and from wrong ones: shifted, turned, and
turned over so that the shape nearly fits. Each counts as right or wrong by where it ended, not by where it
began.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from huepose.believe.logistic import probability
from huepose.evaluation import metrics
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.judge.borders import outline
from huepose.model.types import ReferenceModel
from huepose.tracking import evidence
from huepose.tracking.step import Subject, best_of
from studies.hard_moments.film import Film

EVERY = 10
WRONG = 6
UNDECIDED = 0.0
"""Log-odds of a pose beforehand: nothing is known."""

LEAST_VISIBLE = 0.3

UNTIL_SETTLED = 12
"""Passes of the refinement. The tracker goes on with an unfinished one in its next frames; here there are
none, and a pose that is still on its way is neither right nor wrong."""


def challenge(
    film: Film, models: Mapping[str, ReferenceModel], seed: int = 0, every: int = EVERY
) -> tuple[Float64, Bool]:
    """Qualities (N,) and which poses were right (N,), over the frames of a film and its visible objects."""
    rng = np.random.default_rng([seed, 90])
    subjects = {name: Subject.of(models[name]) for name in set(film.script.objects)}
    baseline: dict[int, float] = {}
    qualities: list[float] = []
    right: list[bool] = []
    for seen in film:
        if seen.frame.frame_id % every:
            continue
        for k, name in enumerate(film.script.objects):
            if seen.visib_fract[k] < LEAST_VISIBLE:
                continue
            model, subject, truth = models[name], subjects[name], seen.T_cam_obj[k]
            starts = [truth, *wrong_starts(truth, model, rng)]
            for i, start in enumerate(starts):
                step = best_of(subject.surface, seen.frame, [(start, "still")], more_passes=UNTIL_SETTLED)
                add = metrics.add(model.eval_points, step.T_cam_obj, truth)
                goes_on = outline(subject.contours, step.T_cam_obj, seen.frame).goes_on
                odds = evidence.log_odds(step.terms, baseline.get(k), UNDECIDED, goes_on)
                qualities.append(probability(odds))
                right.append(add < metrics.RECALL_FRACTION * model.diameter_m)
                if i == 0:
                    baseline[k] = evidence.baseline_after(baseline.get(k), step.terms.total)
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
