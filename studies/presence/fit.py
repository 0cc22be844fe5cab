"""Fitting presence: from answers at a detector's places, of which it is known whether the object is there, to
the weights of `perception.presence`.

A pose's own certainty enters as it does in the verdict (`estimation.present`), so that the sum of all is a
probability.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huepose.believe.logistic import Logistic, probabilities
from huepose.believe.presence import Sight, features, logits_of
from huepose.datasets.boxes import truth_box
from huepose.datasets.types import Sample
from huepose.estimation import Estimator, EstimatorConfig
from huepose.estimation.present import certainty
from huepose.estimation.types import ObjectQuery
from huepose.evaluation.estimate_protocol import PoseEstimator
from huepose.evaluation.perception_protocol import SAME
from huepose.evaluation.targets import Targets
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.model import load_models
from huepose.perception.clear_view import clear_view
from huepose.perception.colorpair_detector import ColorPairDetector
from huepose.perception.config import DetectorConfig
from huepose.perception.presence import alike, outlined, sight
from huepose.perception.types import Detector
from huepose.support.progress import progress
from studies.likelihood import logistic
from studies.presence.sets import samples, scaled

PLACES = 2
"""Of each object, the best that are looked at."""

PLAUSIBLE = 0.01
"""Poses that are the object's with less than this probability say where nothing is; they are so many, and so
easily told, that the weights would be made for them and not for what is doubtful."""


@dataclass(frozen=True, eq=False)
class SeenPlaces:
    """The poses of a frame: names of their objects, what is seen there, how sure each pose is of itself
    (N,), in log odds, and whether its object is there (N,)."""

    names: tuple[str, ...]
    sights: tuple[Sight, ...]
    certain: Float64
    there: Bool


def seen_in(folder: Path, bundles: Path) -> Sequence[SeenPlaces]:
    """What is seen in the frames of a folder, everything asked for."""
    kept = folder / "seen.pkl"
    if kept.exists():
        return list(pickle.loads(kept.read_bytes()))
    targets = Targets(load_models(bundles))
    models = targets.models_by_name
    detector = ColorPairDetector(models, DetectorConfig(proposals=3, min_score=0.02))
    estimator = Estimator(models, EstimatorConfig(found_level=0.0, threads=1))
    out = [look(sample, smaller, targets, detector, estimator)
           for sample, smaller in progress(list(samples(folder)), folder.name)]  # fmt: skip
    kept.write_bytes(pickle.dumps(out))
    return out


def look(
    sample: Sample, smaller: float, targets: Targets, detector: Detector, estimator: PoseEstimator
) -> SeenPlaces:
    """All objects of `targets` are asked for in a frame, which is so much smaller than its labels. An object
    is there where the box of what its pose explains overlaps the box of one of its labels by IoU 0.5."""
    models = targets.models_by_name
    view = clear_view(sample.frame, max(m.diameter_m for m in models.values()))
    count: dict[str, int] = {}
    queries: list[ObjectQuery] = []
    for d in detector.detect(sample.frame, list(models)):
        count[d.object] = count.get(d.object, 0) + 1
        if count[d.object] <= PLACES:
            queries.append(ObjectQuery(d.object, box=d.box, instance=len(queries)))
    answers = estimator.estimate(sample.frame, queries) if queries and view is not None else []
    boxes = [
        (model.name, scaled(box, smaller))
        for t in sample.truths
        if t.T_cam_obj is not None and (model := targets.model_of(t)) is not None
        if (box := truth_box(t, model.mesh, sample.frame.camera)) is not None
    ]
    regions = {name: view.region(m.diameter_m) for name, m in models.items()} if view is not None else {}
    names, sights, certain, there = [], [], [], []
    for answer in answers:
        own = None if answer.mask is None else Box.of_mask(answer.mask)
        if view is None or answer.T_cam_obj is None or own is None:
            continue
        names.append(answer.object)
        model, T_cam_obj = models[answer.object], answer.T_cam_obj
        plain = sight(view, regions[model.name], model, T_cam_obj)
        named = [(model.name, T_cam_obj)]
        sights.extend(outlined(view, models, named, alike(view, models, named, [plain])))
        certain.append(certainty(answer))
        there.append(any(n == answer.object and b.iou(own) >= SAME for n, b in boxes))
    return SeenPlaces(tuple(names), tuple(sights), np.array(certain), np.array(there, dtype=bool))


def fit_presence(frames: Sequence[SeenPlaces], start: Logistic) -> Logistic:
    """The weights of largest likelihood on the plausible poses of these frames; `start` says which those
    are."""
    frames = [frame for frame in frames if frame.names]
    plausible = np.concatenate([chances(frame, start) for frame in frames]) >= PLAUSIBLE
    there = np.concatenate([frame.there for frame in frames])[plausible]
    certain = np.concatenate([frame.certain for frame in frames])[plausible]
    rows = [features(s) for frame in frames for s in frame.sights]
    x = np.array([list(row.values()) for row in rows])[plausible]
    return logistic(x, there, np.ones(len(there)), list(rows[0]), certain)


def chances(frame: SeenPlaces, fit: Logistic) -> Float64:
    """Probability (N,) that each object is there."""
    return probabilities(logits_of(frame.sights, fit) + frame.certain)
