"""How far a label got, and what its true box would have changed."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.estimation import PoseEstimate
from huepose.geometry.box import Box
from huepose.perception.types import Detection
from studies.lost import InItsBox, Lost, Stage, report, stage_of

LABEL = Box(10.0, 10.0, 20.0, 20.0)
SURE, DOUBTFUL = 0.9, 0.3


def answer(name: str, x: int, present: float, width: int = 20) -> PoseEstimate:
    """A pose that explains the pixels from x on in the rows of the label."""
    mask = np.zeros((64, 64), bool)
    mask[10:30, x : x + width] = True
    return PoseEstimate(name, found=True, T_cam_obj=np.eye(4), mask=mask, present=present)


@pytest.mark.parametrize(
    ("answers", "expected"),
    [
        ([answer("mug", 10, SURE)], Stage.FOUND),
        ([answer("mug", 10, DOUBTFUL)], Stage.DOUBTED),
        ([answer("mug", 10, SURE), answer("can", 10, 0.95)], Stage.COVERED),
        ([answer("mug", 10, DOUBTFUL), answer("can", 10, 0.95)], Stage.DOUBTED),
        ([answer("mug", 24, SURE)], Stage.ASTRAY),
        ([answer("can", 10, SURE)], Stage.ASTRAY),
    ],
)
def test_a_label_gets_as_far_as_the_pose_at_its_place(answers, expected) -> None:
    proposed = [Detection("mug", LABEL, 0.5, np.eye(4))]
    assert stage_of("mug", LABEL, proposed, answers) is expected


def test_a_proposal_of_another_object_or_elsewhere_is_none() -> None:
    others = [Detection("can", LABEL, 0.9, np.eye(4)), Detection("mug", Box(40, 40, 10, 10), 0.9, np.eye(4))]
    assert stage_of("mug", LABEL, others, []) is Stage.UNSEEN


def test_the_report_says_what_true_boxes_would_add() -> None:
    labels = [
        Lost(Stage.FOUND, None),
        Lost(Stage.FOUND, None),
        Lost(Stage.UNSEEN, InItsBox(True, True)),
        Lost(Stage.UNSEEN, InItsBox(True, False)),
        Lost(Stage.DOUBTED, InItsBox(False, False)),
    ]
    text = report(labels)
    assert text.splitlines()[-1] == "found 40.0 % of 5; with the true boxes of the others 60.0 %"
    row = next(line for line in text.splitlines() if line.startswith(Stage.UNSEEN.value))
    assert row.split()[-3:] == ["2", "2", "1"]
