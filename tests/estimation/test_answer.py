"""The full method: every retrieved view is a candidate for selection, and so is a prior."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.estimation.explanation import Explanation
from huepose.estimation.types import PoseEstimate, PosePrior
from huepose.geometry import Box, RgbdFrame, se3
from huepose.judge.terms import score
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from tests.boxes import box_of
from tests.conftest import TakePicture


def explained(model: ReferenceModel, frame: RgbdFrame, box: Box) -> tuple[PoseEstimate, Explanation]:
    return Estimator({model.name: model}).explain(frame, ObjectQuery(model.name, box))


def test_the_best_of_the_views_is_the_answer(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    answer, _ = explained(tea_box, box_frame, box_of(box_frame, tea_box, standing))
    assert answer.T_cam_obj is not None
    assert np.linalg.norm(answer.T_cam_obj[:3, 3] - standing[:3, 3]) < 0.001
    assert se3.rotation_angle(answer.T_cam_obj, standing) < np.radians(0.5)


def test_an_absent_object_is_not_believed(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    box = box_of(take_picture([(tea_box.mesh, standing)]), tea_box, standing)
    answer, look = explained(tea_box, take_picture([]), box)
    assert len(look.ranked)
    assert answer.quality < 0.2


def test_a_prior_is_judged_once_and_in_the_region_of_the_others(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    mask = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    query = ObjectQuery(tea_box.name, masks=(mask,), prior=PosePrior(standing))
    config = EstimatorConfig(look_anew_every=1)
    answer, look = Estimator({tea_box.name: tea_box}, config).explain(box_frame, query)
    assert look.evidence is not None
    assert answer.prior_T_cam_obj is not None
    judged = score(tea_box, look.evidence.region, answer.prior_T_cam_obj).total
    assert answer.prior_score == pytest.approx(judged)
