"""The perception protocol, with a detector, a segmenter and an estimator that return given results."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from huepose.datasets.types import Sample
from huepose.estimation.accepted import accepted_answers, why_none_accepted
from huepose.estimation.types import PoseEstimate
from huepose.evaluation import pictures
from huepose.evaluation.perception_protocol import PerceptionOptions, evaluate_perception
from huepose.evaluation.pictures import draw_perception
from huepose.evaluation.result_files import plain
from huepose.evaluation.targets import Targets
from huepose.geometry import Box
from huepose.geometry.image_faults import IF_IN_PLAIN_VIEW
from huepose.perception.types import Detection
from huepose.support.errors import InputError

from .conftest import MemoryScene, PartlyLabelled, ScriptedEstimator, estimate_of, pose_at, truth

LEFT, RIGHT, NOWHERE = Box(10, 20, 40, 50), Box(100, 30, 40, 60), Box(60, 80, 20, 20)


def mask_of(box: Box) -> np.ndarray:
    mask = np.zeros((120, 160), bool)
    mask[box.slices(160, 120)] = True
    return mask


@pytest.fixture
def scene() -> MemoryScene:
    """The box on the left, the brick on the right, and a second brick that is hardly visible."""
    labels = (
        truth(0, 5, pose_at(-0.1), 0.9, LEFT, mask_loader=lambda: mask_of(LEFT)),
        truth(1, 7, pose_at(0.1), 0.8, RIGHT, mask_loader=lambda: mask_of(RIGHT)),
        truth(2, 7, pose_at(0.0), 0.1, NOWHERE, mask_loader=lambda: mask_of(NOWHERE)),
    )
    return MemoryScene("000001", {3: labels})


class Boxes:
    def __init__(self, *detections: Detection) -> None:
        self.detections = list(detections)

    def detect(self, frame, names):
        return [d for d in self.detections if d.object in names]


class UpperHalf:
    """Outlines the upper half of every box."""

    def segment(self, frame, box, diameter_m):
        return [mask_of(Box(box.x, box.y, box.w, box.h / 2))]


def estimator_with(qualities: dict[tuple[str, Box], float], present: bool = False) -> ScriptedEstimator:
    """Finds every requested object in its box, with the listed quality (0.9 for a box that is not listed).
    present: it also returns a presence of one minus the quality."""

    def answer(frame, query) -> PoseEstimate:
        quality = qualities.get((query.object, query.box), 0.9)
        found = replace(estimate_of(query, pose_at(0.0), quality), mask=mask_of(query.box))
        return replace(found, present=1.0 - quality) if present else found

    return ScriptedEstimator(answer)


def run(scene, models, detections, qualities, **options):
    return evaluate_perception(
        [scene],
        Targets(models),
        Boxes(*detections),
        UpperHalf(),
        estimator_with(qualities),
        PerceptionOptions(**options),
    )


def test_recall_counts_the_first_proposals_and_the_accepted_answers(models, scene) -> None:
    detections = [Detection("box", LEFT, 0.9), Detection("brick", LEFT, 0.8), Detection("brick", RIGHT, 0.7)]
    result = run(scene, models, detections, {("box", LEFT): 0.99, ("brick", LEFT): 0.95})
    record = json.loads(json.dumps(plain(result.as_json())))
    summary = record["summary"]
    assert summary["instances"] == 2
    assert summary["recall_at"] == {"1": 50.0, "5": 100.0, "20": 100.0}
    # The brick's first proposal is on the box, which explains the surface better. The second one is accepted.
    assert summary["recall_iou50"] == 100.0
    assert summary["false_boxes_per_frame"] == 0.0
    assert [(r["name"], r["rank"], r["found"]) for r in record["rows"]] == [
        ("box", 1, True),
        ("brick", 2, True),
    ]
    assert summary["confusion"] == {"box": {"box": 1}, "brick": {"brick": 1}}


def test_the_number_of_judged_proposals_is_limited(models, scene) -> None:
    detections = [Detection("brick", LEFT, 0.8), Detection("brick", RIGHT, 0.7)]
    result = run(scene, models, detections, {("brick", LEFT): 0.2}, judged=1)
    assert result.as_json()["summary"]["recall_iou50"] == 0.0


def test_false_boxes_name_the_object_that_is_there(models, scene) -> None:
    detections = [Detection("brick", LEFT, 0.9), Detection("box", Box(60, 5, 20, 20), 0.9)]
    record = run(scene, models, detections, {}).as_json()
    assert record["summary"]["false_boxes_per_frame"] == 2.0
    assert {(f["name"], f["shown"]) for f in record["false"]} == {("brick", "box"), ("box", None)}
    assert record["summary"]["confusion"]["box"] == {"nothing labelled": 1}
    assert record["summary"]["per_object"]["brick"]["false_boxes"] == 1


def test_a_hardly_visible_instance_is_neither_missed_nor_false(models, scene) -> None:
    record = run(scene, models, [Detection("brick", NOWHERE, 0.9)], {}).as_json()
    assert record["false"] == []
    assert record["summary"]["instances"] == 2


def test_masks_are_measured_in_perturbed_boxes(models, scene) -> None:
    summary = run(scene, models, [], {}).as_json()["summary"]
    assert 0.35 < summary["mask_iou"] < 0.6
    assert 0.6 < summary["final_mask_iou"] < 1.0


def test_the_picture_shows_found_missed_and_false(models, scene) -> None:
    result = run(
        scene, models, [Detection("box", LEFT, 0.9), Detection("brick", Box(60, 5, 20, 20), 0.9)], {}
    )
    picture = draw_perception(Sample.of(scene, 3), result.frames[0])
    assert tuple(picture[69, 30]) == pictures.RIGHT
    assert tuple(picture[89, 120]) == pictures.MISSED
    assert tuple(picture[24, 70]) == pictures.WRONG


def test_false_boxes_count_in_all_labelled_frames(models, scene) -> None:
    """Frame 4 shows another object; frame 5 is unlabelled."""
    other = truth(0, 7, pose_at(0.1), 0.8, RIGHT, mask_loader=lambda: mask_of(RIGHT))
    three = PartlyLabelled("s", {3: scene.labels[3], 4: (other,), 5: ()})
    found = Detection("box", NOWHERE, 0.9)
    options = PerceptionOptions()
    result = evaluate_perception(
        [three], Targets(models, [5]), Boxes(found), UpperHalf(), estimator_with({}), options
    )
    record = result.as_json()
    assert [(f["image"], f["shown"]) for f in record["false"]] == [(3, None), (4, None)]
    assert (record["summary"]["frames"], record["summary"]["instances"]) == (2, 1)


def test_two_scenes_with_the_same_name_are_refused(models, scene) -> None:
    with pytest.raises(InputError, match="scene '000001': found two folders"):
        evaluate_perception(
            [scene, scene], Targets(models), Boxes(), UpperHalf(), estimator_with({}), PerceptionOptions()
        )


def test_nothing_labelled_is_an_error(models) -> None:
    with pytest.raises(InputError, match="no label"):
        run(MemoryScene("000001", {0: ()}), models, [], {})


def test_one_surface_is_accepted_for_one_pose_only() -> None:
    def answer(name: str, box: Box, present: float) -> PoseEstimate:
        return replace(PoseEstimate(name), found=True, mask=mask_of(box), present=present)

    better, worse = answer("box", LEFT, 0.95), answer("brick", LEFT, 0.9)
    beside, doubtful = answer("brick", RIGHT, 0.7), answer("can", NOWHERE, 0.3)
    assert accepted_answers([worse, doubtful, beside, better]) == [better, beside]
    assert accepted_answers([worse, PoseEstimate("box", present=1.0)]) == [worse]


def test_the_reason_why_no_answer_of_an_object_is_accepted() -> None:
    def found(present: float) -> PoseEstimate:
        return replace(PoseEstimate("brick"), found=True, mask=mask_of(LEFT), present=present)

    nowhere = "The detector found no place in the frame that looks like the object."
    assert why_none_accepted("box", [found(0.9)]) == f"{nowhere} {IF_IN_PLAIN_VIEW}"
    assert why_none_accepted("box", [found(0.9)], advise=False) == nowhere
    assert why_none_accepted("brick", [found(0.2), found(0.31)]) == (
        "At the best of 2 places the object is there with a probability of 0.31, which is under 0.60."
    )
    assert "of 0.59, which is under 0.60" in why_none_accepted("brick", [found(0.598)])
    assert why_none_accepted("brick", [found(0.2)], ["its texture is not seen there"]).endswith(
        "under 0.60: its texture is not seen there."
    )
    assert why_none_accepted("brick", [found(0.9)]) == (
        "Another object explains the surface at the only place better."
    )
    assert why_none_accepted("brick", [PoseEstimate("brick", reason="Nothing.")]) == "Nothing."


def test_presence_decides_acceptance_whatever_the_quality_is(models, scene) -> None:
    """The brick with the lower quality is accepted, because its presence is higher. A proposal below
    `least` is not estimated."""
    detections = [Detection("brick", LEFT, 0.8), Detection("brick", RIGHT, 0.7), Detection("box", LEFT, 0.1)]
    result = evaluate_perception(
        [scene],
        Targets(models),
        Boxes(*detections),
        UpperHalf(),
        estimator_with({("brick", LEFT): 0.9, ("brick", RIGHT): 0.1}, present=True),
        PerceptionOptions(least=0.2),
    )
    record = result.as_json()
    assert [(r["name"], r["found"]) for r in record["rows"]] == [("box", False), ("brick", True)]
    assert record["false"] == []
