"""The reasons against an answer, in cases with a known problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation import Estimator, ObjectQuery
from huepose.estimation.explanation import Explanation
from huepose.estimation.reasons import (
    covering,
    displacement,
    only_orientation_in_doubt,
    overlap,
    reasons,
    why_absent,
)
from huepose.estimation.types import PoseEstimate
from huepose.geometry import RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.select.distinct import NONE, Ranked
from tests.boxes import box_of


def turned(T: np.ndarray, degrees: float, axis: int) -> np.ndarray:
    return se3.compose(T, se3.make(se3.rotation_exp(np.radians(degrees) * np.eye(3)[axis]), np.zeros(3)))


@pytest.fixture(scope="module")
def looked(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> tuple[PoseEstimate, Explanation]:
    box = box_of(box_frame, tea_box, standing)
    return Estimator({"tea_box": tea_box}).explain(box_frame, ObjectQuery("tea_box", box))


def test_there_is_no_reason_against_a_plain_view(
    tea_box: ReferenceModel, looked: tuple[PoseEstimate, Explanation]
) -> None:
    assert reasons(tea_box, *looked) == []


def test_a_near_tie_is_named(tea_box: ReferenceModel, looked: tuple[PoseEstimate, Explanation]) -> None:
    answer, explanation = looked
    twin = np.stack([explanation.ranked.poses[0], turned(explanation.ranked.poses[0], 180.0, 2)])
    close = replace(explanation, ranked=Ranked.of(twin, np.array([2.0, 1.97])))
    (said,) = reasons(tea_box, answer, close)
    assert said.startswith("a near tie: rotated 180 deg about its z axis, shifted")
    assert said.endswith("it is behind by 0.03 only")


def test_a_mask_on_something_else_is_named(
    tea_box: ReferenceModel, looked: tuple[PoseEstimate, Explanation]
) -> None:
    answer, explanation = looked
    other = np.zeros((480, 640), bool)
    other[:30, :30] = True
    assert reasons(tea_box, answer, replace(explanation, masks=(other,))) == [
        "the masks show something else: the best mask covers 0 % of the pose, which is 0 % of the mask"
    ]


def test_a_pose_in_the_air_is_named_as_a_free_space_violation(
    tea_box: ReferenceModel, looked: tuple[PoseEstimate, Explanation]
) -> None:
    answer, explanation = looked
    nearer = se3.compose(se3.make(np.eye(3), [0.0, 0.0, -0.1]), explanation.ranked.poses[0])
    said = reasons(tea_box, answer, replace(explanation, ranked=Ranked.of(nearer[None], np.ones(1))))
    assert any("depth shows what lies behind the object" in text for text in said)
    assert any(text.startswith("the texture agrees little") for text in said)


def test_without_depth_or_views_that_is_the_only_reason(
    tea_box: ReferenceModel, looked: tuple[PoseEstimate, Explanation]
) -> None:
    answer, explanation = looked
    assert reasons(tea_box, answer, replace(explanation, evidence=None)) == [
        "no depth in the box: nothing to look at"
    ]
    assert reasons(tea_box, answer, replace(explanation, ranked=NONE)) == [
        "no view of the object was proposed"
    ]


def test_the_reason_for_an_absent_object_is_what_was_measured(
    looked: tuple[PoseEstimate, Explanation],
) -> None:
    terms = looked[0].terms
    assert terms is not None
    through = replace(terms, violation=0.35, color=0.12, seen=0.9, occluded=0.0, box_iou=0.8)
    assert why_absent(through, 0.04, 0.12) == (
        "The object is not in this box (it is with a probability of 0.04; 0.12 is needed): depth shows what "
        "lies behind the object on 35 % of the pose, and the texture agrees little (correlation 0.12)."
    )
    poor = replace(terms, total=0.71, violation=0.0, color=0.5, seen=0.9, occluded=0.0, box_iou=0.8)
    assert why_absent(poor, 0.04, 0.12).endswith("0.12 is needed): the best pose scores 0.71.")
    assert why_absent(None, 0.0, 0.12).startswith("No view of the object")


def test_only_the_orientation_is_in_doubt_if_nothing_else_is(standing: np.ndarray) -> None:
    over = turned(standing, 180.0, 2)
    beside = se3.compose(se3.make(np.eye(3), [0.05, 0.0, 0.0]), standing)

    def doubted(quality: float, *others: tuple[np.ndarray, float]) -> bool:
        answer = PoseEstimate("tea_box", T_cam_obj=standing, quality=quality, alternatives=others)
        return only_orientation_in_doubt(answer, "full")

    assert doubted(0.5, (over, 0.45))
    assert not doubted(0.1, (over, 0.09)), "none of them fits"
    assert not doubted(0.5, (beside, 0.45)), "the other one is not rotated"
    assert not doubted(0.5)


def test_masks_in_numbers_and_words() -> None:
    mask, other = np.zeros((4, 4), bool), np.zeros((4, 4), bool)
    mask[:2], other[:, :2] = True, True
    assert overlap(mask, other) == pytest.approx(1 / 3)
    assert overlap(mask & ~mask, mask & ~mask) == 0.0
    assert covering(mask, other, "it") == "the best mask covers 50 % of it, which is 50 % of the mask"


def test_displacements_in_words(tea_box: ReferenceModel, standing: np.ndarray) -> None:
    assert displacement(tea_box, turned(standing, 90.0, 2), standing) == (
        "rotated 90 deg about its z axis, shifted 0 mm"
    )
    beside = se3.compose(se3.make(np.eye(3), [0.012, 0.0, 0.0]), standing)
    assert displacement(tea_box, beside, standing) == "rotated 0 deg, shifted 12 mm"
    skew = se3.compose(standing, se3.make(se3.rotation_exp(np.array([1.0, 1.0, 0.0])), np.zeros(3)))
    assert displacement(tea_box, skew, standing) == "rotated 81 deg, shifted 0 mm"
