"""The full method's search: what is found at once is not looked for again, what is poor is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.estimation.config import ConfirmConfig, FullPathConfig
from huepose.estimation.explanation import Explanation
from huepose.estimation.types import PoseEstimate, PosePrior
from huepose.geometry import Box, RgbdFrame, se3
from huepose.judge.terms import score
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth

TakePicture = Callable[..., RgbdFrame]


def explained(
    model: ReferenceModel, frame: RgbdFrame, box: Box, full: FullPathConfig
) -> tuple[PoseEstimate, Explanation]:
    estimator = Estimator({model.name: model}, EstimatorConfig(full=full, look_harder=True))
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


def test_a_prior_is_judged_on_what_is_believed_in_the_end(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    """The mask takes what stands in front of one half for the object, and is doubted in the harder look."""
    frame = take_picture([(tea_box.mesh, standing)])
    mask = render_depth(tea_box.mesh, standing, frame.camera) > 0
    right = mask & (np.arange(640) > np.nonzero(mask)[1].mean())[None, :]
    covered = replace(frame, depth=np.where(right, frame.depth - np.float32(0.1), frame.depth))
    query = ObjectQuery(tea_box.name, masks=(mask,), prior=PosePrior(standing))
    config = EstimatorConfig(
        full=FullPathConfig(poor=9.0), confirm=ConfirmConfig(look_anew_every=1), look_harder=True
    )
    answer, explanation = Estimator({tea_box.name: tea_box}, config).explain(covered, query)
    assert explanation.evidence is not None
    assert answer.prior_T_cam_obj is not None
    region = explanation.evidence.region
    doubted, believed = (
        score(tea_box, replace(region, hides=hides), answer.prior_T_cam_obj).total for hides in (0.0, 0.5)
    )
    assert answer.prior_score == pytest.approx(doubted)
    assert believed < doubted - 0.1


def test_what_is_not_there_is_looked_for_harder_and_not_believed(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    box = box_of(take_picture([(tea_box.mesh, standing)]), tea_box, standing)
    answer, explanation = explained(tea_box, take_picture([]), box, FullPathConfig())
    assert explanation.trail is not None
    assert len(explanation.trail.registered) == 2 * len(explanation.trail.retrieved)
    assert explanation.totals[0] < FullPathConfig().poor
    assert answer.quality < 0.2
    stream = Estimator({tea_box.name: tea_box}, EstimatorConfig())
    _, once = stream.explain(take_picture([]), ObjectQuery(tea_box.name, box))
    assert once.trail is not None
    assert len(once.trail.registered) == len(once.trail.retrieved)
