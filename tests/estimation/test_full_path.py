"""The full method's search: what is found at once is not looked for again, what is poor is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.estimation.config import FullPathConfig
from huepose.estimation.explanation import Explanation
from huepose.estimation.types import PoseEstimate
from huepose.geometry import Box, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth

TakePicture = Callable[..., RgbdFrame]


def explained(
    model: ReferenceModel, frame: RgbdFrame, box: Box, full: FullPathConfig
) -> tuple[PoseEstimate, Explanation]:
    estimator = Estimator({model.name: model}, EstimatorConfig(full=full))
    return estimator.explain(frame, ObjectQuery(model.name, box))


def box_of(frame: RgbdFrame, model: ReferenceModel, T: np.ndarray) -> Box:
    box = Box.of_mask(render_depth(model.mesh, T, frame.camera) > 0)
    assert box is not None
    return box


def test_what_is_plainly_right_is_looked_for_once(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)])
    box = box_of(frame, tea_box, standing)
    answer, once = explained(tea_box, frame, box, FullPathConfig())
    assert once.trail is not None
    assert len(once.trail.registered) == len(once.trail.retrieved) <= 30
    harder, twice = explained(tea_box, frame, box, FullPathConfig(poor=9.0))
    assert twice.trail is not None
    assert len(twice.trail.retrieved) > len(once.trail.retrieved)
    assert len(twice.trail.registered) == 2 * len(twice.trail.retrieved)
    for found in (answer, harder):
        assert found.T_cam_obj is not None
        assert np.linalg.norm(found.T_cam_obj[:3, 3] - standing[:3, 3]) < 0.001
        assert se3.rotation_angle(found.T_cam_obj, standing) < np.radians(0.5)


def test_what_is_not_there_is_looked_for_harder_and_not_believed(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    box = box_of(take_picture([(tea_box.mesh, standing)]), tea_box, standing)
    answer, explanation = explained(tea_box, take_picture([]), box, FullPathConfig())
    assert explanation.trail is not None
    assert len(explanation.trail.registered) == 2 * len(explanation.trail.retrieved)
    assert explanation.totals[0] < FullPathConfig().poor
    assert answer.quality < 0.2
    stream = Estimator({tea_box.name: tea_box}, EstimatorConfig(look_harder=False))
    _, once = stream.explain(take_picture([]), ObjectQuery(tea_box.name, box))
    assert once.trail is not None
    assert len(once.trail.registered) == len(once.trail.retrieved)
