"""A prior that is plainly right is the answer without a search; a wrong one never is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery, PosePrior
from huepose.estimation.answer import CLEAR_MARGIN, looks_in_full
from huepose.geometry import RgbdFrame, se3
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.select.distinct import Ranked
from huepose.support.stages import listening
from tests.boxes import box_of
from tests.conftest import TakePicture, standing_pose

NOT_IN_FULL = next(i for i in range(9) if not looks_in_full(i, 3))


def test_a_share_of_the_frames_is_looked_at_in_full_whatever_the_stride() -> None:
    for stride in (1, 2, 3, 6, 7):
        share = np.mean([looks_in_full(i * stride, 3) for i in range(3000)])
        assert 0.28 < share < 0.39
    assert all(looks_in_full(i, 1) for i in range(20))


def test_a_plainly_right_prior_needs_no_views_and_a_wrong_one_is_not_confirmed(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    frame = replace(box_frame, frame_id=NOT_IN_FULL)
    box = box_of(frame, tea_box, standing)
    near = PosePrior(se3.perturb(standing, np.array([0.004, -0.003, 0.005, 0.04, -0.03, 0.03])))
    turned = PosePrior(se3.compose(standing, se3.make(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))))
    models = {"tea_box": tea_box}
    always = Estimator(models, EstimatorConfig(look_anew_every=1))
    for estimator, prior, sought in (
        (Estimator(models), near, False),
        (Estimator(models), turned, True),
        (always, near, True),
    ):
        with listening() as clock:
            (answer,) = estimator.estimate(frame, [ObjectQuery("tea_box", box, prior=prior)])
        assert ("retrieval" in clock.totals()) == sought
        assert answer.T_cam_obj is not None
        assert np.linalg.norm(answer.T_cam_obj[:3, 3] - standing[:3, 3]) < 0.002
        assert se3.rotation_angle(answer.T_cam_obj, standing) < np.radians(1.0)
        assert sought or answer.margin <= CLEAR_MARGIN


@pytest.mark.parametrize("turned_deg", [0.0, 60.0])
def test_a_search_that_leads_back_to_the_prior_is_no_other_answer(
    soup_can: ReferenceModel, take_picture: TakePicture, turned_deg: float
) -> None:
    """For a can, nearby rotations lead back, often to a slightly better total; a rotated can is noticed."""
    for yaw_rad in np.linspace(0.0, 5.0, 6):
        T = standing_pose(yaw_rad, 0.0, 0.0)
        frame = take_picture([(soup_can.mesh, T)], frame_id=NOT_IN_FULL)
        axis = se3.rotation_exp(np.array([0.0, 0.0, np.radians(turned_deg)]))
        around = se3.make(axis, soup_can.mesh.centre - axis @ soup_can.mesh.centre)
        near = se3.perturb(T @ around, np.array([0.002, -0.001, 0.002, 0.01, -0.01, 0.01]))
        query = ObjectQuery("soup_can", box_of(frame, soup_can, T), prior=PosePrior(near))
        with listening() as clock:
            (answer,) = Estimator({"soup_can": soup_can}).estimate(frame, [query])
        assert ("retrieval" in clock.totals()) == (turned_deg > 0.0)
        assert answer.T_cam_obj is not None
        assert se3.rotation_angle(answer.T_cam_obj, T) < np.radians(2.0)


def test_a_prior_that_a_rotation_beats_in_its_light_is_not_confirmed(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    def beaten(model: ReferenceModel, region: Region, found: Ranked) -> tuple[Ranked, bool]:
        return Ranked(found.poses[::-1], found.totals[::-1], found.behind), True

    monkeypatch.setattr("huepose.estimation.answer.in_their_light", beaten)
    frame = replace(box_frame, frame_id=NOT_IN_FULL)
    query = ObjectQuery("tea_box", box_of(frame, tea_box, standing), prior=PosePrior(standing))
    with listening() as clock:
        Estimator({"tea_box": tea_box}).estimate(frame, [query])
    assert "retrieval" in clock.totals()


def test_a_confirmed_prior_of_an_object_without_near_symmetries_is_an_answer_without_rivals(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    frame = replace(box_frame, frame_id=NOT_IN_FULL)
    box = box_of(frame, tea_box, standing)
    alone = replace(tea_box, near_symmetries=tea_box.near_symmetries[:1])
    (answer,) = Estimator({"tea_box": alone}).estimate(
        frame, [ObjectQuery("tea_box", box, prior=PosePrior(standing))]
    )
    assert answer.state == "TRACKING"
    assert answer.alternatives == ()
