"""A warm-up: all that an estimator may do with an object, on a made-up frame, so that every kernel is
compiled before the first real one. Without it a first near tie or a first prior waits for the compiler."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from huepose.estimation.answer import confirm, refine_prior
from huepose.estimation.apparent_size import support
from huepose.estimation.explanation import Explanation
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.geometry import se3
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.judge.silhouette import projected_box
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render
from huepose.select.distinct import Ranked
from huepose.select.near_ties import decided

Explain = Callable[[RgbdFrame, ObjectQuery], tuple[PoseEstimate, Explanation]]


def warm_up(explain: Explain, model: ReferenceModel, full: bool) -> None:
    """Let an estimator look for an object that stands before a wall, and ask whether it is there; full: by
    the method of that name, for which there may be a prior, and a near tie between poses."""
    camera = Camera(320.0, 320.0, 159.5, 119.5, 320, 240)
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 3.0 * model.diameter_m]) - model.mesh.centre)
    picture = render([(model.mesh, T)], camera)
    wall = np.float32(4.0 * model.diameter_m)
    frame = RgbdFrame(picture.color, np.where(picture.depth > 0, picture.depth, wall), camera)
    box = projected_box(model, frame, T)
    if box is None:
        return
    _, seen = explain(frame, ObjectQuery(model.name, box, searched=True))
    if not full or seen.evidence is None:
        return
    region = seen.evidence.region
    refined = refine_prior(model, seen.evidence, T)
    confirm(model, region, refined)
    pose = refined.poses[0]
    turned = se3.perturb(pose, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1]))
    decided(model, region, Ranked.of(np.stack([pose, turned]), np.array([2.0, 1.95])))
    support(frame, model, pose, picture.depth > 0)
