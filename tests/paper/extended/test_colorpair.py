"""The method `colorpair` alone: colour pairs find a printed box, and distinguish its pose from its flip."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.geometry import Box, RgbdFrame, se3
from huepose.judge.pairs import CLOSE_PAIRS, pair_image
from huepose.model.types import ReferenceModel
from huepose.paper.extended.colorpair import ColorpairPathConfig, estimate_by_pairs
from huepose.paper.extended.hypotheses import HypothesesConfig
from huepose.paper.extended.pair_score import CLOSE_PAIR_SAMPLES
from huepose.propose.evidence import Evidence, gather
from huepose.rendering.render import render_depth
from tests.boxes import box_of
from tests.conftest import TakePicture
from tests.judge.regions import pair_score, seen_by_pairs


@pytest.fixture
def evidence(tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray) -> Evidence:
    """Evidence of the box on the table."""
    mask = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    found = gather(box_frame, [mask], Box.of_mask(mask), tea_box.diameter_m)
    assert found is not None
    return found


def test_colour_pairs_alone_find_the_box(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], light=(0.9, 0.75, 0.6))
    box = box_of(frame, tea_box, standing)
    estimator = Estimator({"tea_box": tea_box}, EstimatorConfig(method="colorpair"))
    (answer,) = estimator.estimate(frame, [ObjectQuery("tea_box", box)])
    assert answer.found
    assert answer.T_cam_obj is not None
    assert np.linalg.norm(answer.T_cam_obj[:3, 3] - standing[:3, 3]) < 0.003
    assert se3.rotation_angle(answer.T_cam_obj, standing) < np.radians(2.0)
    (again,) = estimator.estimate(frame, [ObjectQuery("tea_box", box)])
    np.testing.assert_array_equal(again.T_cam_obj, answer.T_cam_obj)


def test_the_pair_score_prefers_the_right_pose_to_flips_and_small_errors_in_any_light(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    for light in ((1.0, 1.0, 1.0), (0.9, 0.6, 0.45)):
        frame = take_picture([(tea_box.mesh, standing)], light=light)
        region, picture = seen_by_pairs(tea_box, frame, standing)
        right = pair_score(tea_box, region, picture, standing)
        flips = [
            pair_score(tea_box, region, picture, standing @ turn) for turn in tea_box.near_symmetries[1:]
        ]
        assert len(flips) >= 1
        assert right.total > max(f.total for f in flips) + 0.1
        moved = [se3.perturb(standing, d) for d in np.diag([0.01] * 3 + [np.radians(8.0)] * 3)]
        assert right.total > max(pair_score(tea_box, region, picture, T).total for T in moved)


def test_totals_are_pair_scores_and_behind_is_the_gap_to_the_first(
    tea_box: ReferenceModel, evidence: Evidence
) -> None:
    found = estimate_by_pairs(tea_box, evidence, ColorpairPathConfig(), np.random.default_rng(0))
    region = evidence.region
    picture = pair_image(tea_box, region.crop, region.median_depth_m)
    first = pair_score(tea_box, region, picture, found.poses[0], CLOSE_PAIRS, CLOSE_PAIR_SAMPLES)
    assert found.totals[0] == pytest.approx(first.total, abs=1e-12)
    assert len(found) > 1
    assert found.behind[0] == 0.0
    assert (np.diff(found.behind) >= 0.0).all()


def test_starts_from_shape_are_a_separate_source(tea_box: ReferenceModel, evidence: Evidence) -> None:
    nothing_votes = HypothesesConfig(frames=False, triangles=False, ppf=False)
    counts = {
        shapes: len(
            estimate_by_pairs(
                tea_box,
                evidence,
                ColorpairPathConfig(shapes=shapes, hypotheses=nothing_votes),
                np.random.default_rng(0),
            )
        )
        for shapes in (False, True)
    }
    assert counts[False] == 0
    assert counts[True] > 0
