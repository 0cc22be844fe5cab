"""Why a pose is wrong: every cause on a constructed case, in the words that one reads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.estimation.explanation import Explanation, Trail
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.evaluation.diagnosis import Diagnosis, diagnose
from huepose.geometry import Box, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.propose.evidence import gather
from huepose.rendering.render import render_depth
from huepose.select.distinct import Ranked

from .conftest import estimate_of

NOTHING = np.zeros((0, 4, 4))
Look = Callable[..., Diagnosis]


def turned(T: np.ndarray, degrees: float, axis: int) -> np.ndarray:
    return se3.compose(T, se3.make(se3.rotation_exp(np.radians(degrees) * np.eye(3)[axis]), np.zeros(3)))


def moved(T: np.ndarray, metres: float) -> np.ndarray:
    return se3.compose(se3.make(np.eye(3), [metres, 0.0, 0.0]), T)


def answer_of(T: np.ndarray | None) -> PoseEstimate:
    return estimate_of(ObjectQuery("tea_box", Box(0, 0, 9, 9)), T)


@pytest.fixture(scope="module")
def look(
    tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray
) -> Callable[..., Diagnosis]:
    """A function of poses of the answer, retrieved views, searched poses, the truth and the mask that is
    believed: the diagnosis on a picture of the box standing there."""
    frame = take_picture([(tea_box.mesh, standing)])
    shown = render_depth(tea_box.mesh, standing, frame.camera) > 0
    box = Box.of_mask(shown)
    assert box is not None

    def call(
        poses, retrieved=NOTHING, searched=NOTHING, truth=standing, mask=shown, answer=None
    ) -> Diagnosis:
        evidence = gather(frame, [shown], box, tea_box.diameter_m)
        trail = Trail(retrieved, retrieved, searched)
        explanation = Explanation(
            box, (shown,), evidence, Ranked.of(poses, np.zeros(len(poses))), trail=trail
        )
        T = answer if answer is not None else poses[0] if len(poses) else None
        return diagnose(tea_box, answer_of(T), explanation, [truth], mask)

    return call


def test_a_right_pose_that_no_view_was_near(look: Look, standing: np.ndarray) -> None:
    wrong = turned(standing, 180.0, 0)
    found = look(wrong[None], retrieved=wrong[None], searched=wrong[None])
    assert found.cause == "not proposed"
    assert found.line.startswith("not proposed: turned 180 deg about its x axis, shifted 0 mm")
    assert "the nearest view proposed is" in found.line
    assert found.truth is not None
    assert found.answer is not None
    assert found.truth.total > found.answer.total + 0.3
    assert found.mask_iou == 1.0


def test_a_right_pose_that_was_lost_on_the_way(look: Look, standing: np.ndarray) -> None:
    wrong = turned(standing, 180.0, 0)
    near = turned(standing, 4.0, 2)
    found = look(wrong[None], retrieved=near[None], searched=wrong[None])
    assert found.cause == "lost"
    assert "registration had the right pose, the search did not keep it" in found.line
    assert found.nearest["views"] < 0.05 < 0.3 < found.nearest["answers"]


def test_a_label_that_the_picture_contradicts_loses_in_verification(look: Look, standing: np.ndarray) -> None:
    label = turned(standing, 180.0, 0)
    found = look(np.stack([standing, label]), searched=label[None], truth=label)
    assert found.cause == "verification"
    assert "the right pose was among the answers" in found.line
    assert "texture +" in found.line


def test_a_wrong_mask_is_said_to_be_one(look: Look, standing: np.ndarray) -> None:
    beside = moved(standing, 0.3)
    other = np.zeros((480, 640), bool)
    other[:40, :40] = True
    found = look(standing[None], searched=beside[None], truth=beside, mask=other)
    assert found.mask_iou == 0.0
    assert "the best mask covers 0 % of the object, which is 0 % of the mask" in found.line


def test_a_pose_that_the_last_fit_spoilt(look: Look, standing: np.ndarray) -> None:
    found = look(standing[None], searched=standing[None], answer=moved(standing, 0.03))
    assert found.cause == "settled away"
    assert "shifted 30 mm" in found.line


def test_a_tie_is_called_one(look: Look, standing: np.ndarray) -> None:
    alike = look(standing[None], searched=standing[None], truth=moved(standing, 0.02))
    assert alike.cause == "tie"


def test_without_depth_there_is_nothing_to_look_at(tea_box: ReferenceModel, standing: np.ndarray) -> None:
    explanation = Explanation(Box(0, 0, 9, 9), (), None)
    found = diagnose(tea_box, answer_of(None), explanation, [standing], None)
    assert (found.cause, found.nearest) == ("no depth", {})
