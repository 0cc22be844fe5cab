"""The single-frame protocol, with an estimator that returns given poses."""

from __future__ import annotations

import json

import numpy as np
import pytest

from huepose.datasets.bop_detections import BopDetection, BopDetections
from huepose.datasets.boxes import disturbed, truth_box
from huepose.evaluation.estimate_protocol import EstimateOptions, evaluate_estimates
from huepose.evaluation.estimate_rows import summary_of
from huepose.evaluation.instances import assigned
from huepose.evaluation.result_files import plain
from huepose.evaluation.targets import Targets
from huepose.geometry import Box, se3
from huepose.perception.types import Detection
from huepose.support.errors import InputError

from .conftest import CAMERA, HALF_TURN, MemoryScene, ScriptedEstimator, estimate_of, pose_at, truth

MASK = np.zeros((120, 160), bool)
MASK[40:80, 60:100] = True


@pytest.fixture
def scene() -> MemoryScene:
    """Two images: ids 5, 7, 16 (no model); then 5 twice, one of them hardly visible."""
    return MemoryScene(
        "000001",
        {
            3: (
                truth(0, 5, pose_at(-0.1), 0.9),
                truth(1, 16, pose_at(0.0), 1.0),
                truth(2, 7, pose_at(0.1), None),
            ),
            8: (truth(0, 5, pose_at(-0.1), 0.2), truth(1, 5, pose_at(0.1), 0.8, mask_loader=lambda: MASK)),
        },
    )


def answering(scene: MemoryScene, shift_m: float = 0.0, quality: float = 0.9) -> ScriptedEstimator:
    """Returns the labelled pose of the requested instance, shifted by `shift_m`."""

    def answer(frame, query):
        T = scene.truths(frame.frame_id)[query.instance].T_cam_obj
        return estimate_of(query, se3.make(T[:3, :3], T[:3, 3] + [shift_m, 0, 0]), quality)

    return ScriptedEstimator(answer)


def test_rows_are_the_labels_of_onboarded_objects(models, scene) -> None:
    result = evaluate_estimates([scene], Targets(models), answering(scene, 0.01), EstimateOptions())
    assert [(r.image, r.instance, r.object) for r in result.rows] == [
        (3, 0, 5),
        (3, 2, 7),
        (8, 0, 5),
        (8, 1, 5),
    ]
    assert [r.error.add_m for r in result.rows] == pytest.approx([0.01] * 4)
    summary = result.summary()
    assert (summary["instances"], summary["objects"], summary["skipped_no_bundle"]) == (4, 2, 1)
    assert summary["recall_add"] == 100.0
    assert summary["auc_add"] == pytest.approx(90.0)
    assert summary["per_object"][5]["instances"] == 3


def test_the_estimator_gets_the_documented_boxes(models, scene) -> None:
    estimator = answering(scene)
    evaluate_estimates([scene], Targets(models), estimator, EstimateOptions(seeds=(4,)))
    label = scene.truths(8)[1]
    expected = disturbed(truth_box(label, models["box"].mesh, CAMERA), "perturbed", 4, "000001", 8, 1, CAMERA)
    asked = {(image, query.instance): query for image, query in estimator.asked}
    assert asked[8, 1].box == expected
    assert asked[8, 1].object == "box"
    assert asked[8, 1].masks == ()


def test_a_subset_of_objects_gets_the_same_boxes(models, scene) -> None:
    everything, some = answering(scene), answering(scene)
    evaluate_estimates([scene], Targets(models), everything, EstimateOptions())
    evaluate_estimates([scene], Targets(models, [7]), some, EstimateOptions())
    (only,) = some.asked
    assert only[1].box in [query.box for image, query in everything.asked if image == only[0]]


def test_hardly_visible_labels_can_be_left_out(models, scene) -> None:
    result = evaluate_estimates([scene], Targets(models), answering(scene), EstimateOptions(min_visib=0.3))
    assert [(r.image, r.instance) for r in result.rows] == [
        (3, 0),
        (3, 2),
        (8, 1),
    ]  # unknown counts as visible


def test_a_pose_that_was_not_found_is_null_and_wrong_and_scores_zero(models, scene) -> None:
    def answer(frame, query):
        return estimate_of(
            query, None if query.object == "brick" else scene.truths(frame.frame_id)[0].T_cam_obj
        )

    options = EstimateOptions(min_visib=0.3)
    result = evaluate_estimates([scene], Targets(models, [7]), ScriptedEstimator(answer), options)
    row = json.loads(json.dumps(plain(result.as_json()), allow_nan=False))["rows"][0]
    assert (row["found"], row["T_cam_obj"], row["add_m"], row["state"]) == (False, None, None, "LOST")
    assert result.summary()["recall_add"] == 0.0
    assert result.summary()["auc_adds"] == 0.0
    assert result.summary()["ece"] is None


def test_a_pose_that_is_not_finite_counts_as_not_found(models, scene) -> None:
    def answer(frame, query):
        return estimate_of(query, np.full((4, 4), np.nan) if query.object == "brick" else pose_at(0.1))

    result = evaluate_estimates([scene], Targets(models), ScriptedEstimator(answer), EstimateOptions())
    rows = [row for row in result.rows if row.object == 7]
    assert [(row.T_cam_obj, row.state.value) for row in rows] == [(None, "LOST")]
    assert rows[0].reason == "The estimator gave a pose that is not finite."


def test_as_many_boxes_of_a_file_are_used_as_the_object_has_labels(models, scene) -> None:
    """Image 3 has a box of object 5 at its label, a less confident one, one of an object without a model, and
    none of object 7. Image 8 has no box."""
    right = truth_box(scene.truths(3)[0], models["box"].mesh, CAMERA)
    found = [BopDetection(5, right, 0.9), BopDetection(16, right, 0.8), BopDetection(5, Box(0, 0, 5, 5), 0.7)]
    estimator = ScriptedEstimator(lambda frame, query: estimate_of(query, scene.truths(3)[0].T_cam_obj))
    result = evaluate_estimates(
        [scene],
        Targets(models),
        estimator,
        EstimateOptions("file", min_visib=0.1),
        given=BopDetections({(1, 3): found}),
    )
    assert [(image, query.object, query.box) for image, query in estimator.asked] == [(3, "box", right)]
    assert [r.error.right for r in result.rows] == [True, False, False, False]
    assert {r.reason for r in result.rows} == {"", "The file has no box of the object in this image."}
    assert result.summary()["recall_add"] == 25.0


def test_true_masks_are_passed_on_and_the_error_names_missing_ones(models, scene) -> None:
    estimator = answering(scene)
    options = EstimateOptions(masks="gt", min_visib=0.5)
    only_masked = MemoryScene("000001", {8: scene.labels[8]})
    evaluate_estimates([only_masked], Targets(models), estimator, options)
    np.testing.assert_array_equal(estimator.asked[0][1].masks[0], MASK)
    with pytest.raises(InputError, match=r"image 3, instance 0.*mask"):
        evaluate_estimates([scene], Targets(models), estimator, options)


def test_an_empty_mask_is_not_estimated_and_counts_as_not_found(models) -> None:
    empty = MemoryScene("s", {0: (truth(0, 5, pose_at(0.0), mask_loader=lambda: MASK & False),)})
    estimator = answering(empty)
    result = evaluate_estimates([empty], Targets(models), estimator, EstimateOptions(masks="gt"))
    assert estimator.asked == []
    assert result.rows[0].T_cam_obj is None


def test_results_of_several_seeds_are_averaged_and_listed(models, scene) -> None:
    estimator = answering(scene)

    def answer(frame, query):  # right in the boxes of the first seed, missing in those of the second
        first = len(estimator.asked) <= 2
        return estimate_of(query, scene.truths(frame.frame_id)[query.instance].T_cam_obj if first else None)

    estimator.answer = answer
    one_image = MemoryScene("000001", {3: scene.labels[3]})
    result = evaluate_estimates([one_image], Targets(models), estimator, EstimateOptions(seeds=(1, 2)))
    summary = result.summary()
    assert summary["instances"] == 2
    assert summary["seed"] == [1, 2]
    assert summary["by_seed"][1]["recall_add"] == 100.0
    assert summary["by_seed"][2]["recall_add"] == 0.0
    assert summary["recall_add"] == 50.0
    assert len({q.box for _, q in estimator.asked}) == 4


def test_equivalent_poses_are_right_but_not_in_the_official_score(models, scene) -> None:
    def answer(frame, query):
        return estimate_of(query, scene.truths(frame.frame_id)[query.instance].T_cam_obj @ HALF_TURN)

    options = EstimateOptions(min_visib=0.3)
    equivalents = {("000001", 8, 1): [HALF_TURN]}
    result = evaluate_estimates(
        [scene], Targets(models, [5]), ScriptedEstimator(answer), options, equivalents=equivalents
    )
    summary = result.summary()
    assert (summary["recall_add"], summary["recall_add_official"]) == (50.0, 0.0)
    assert summary["auc_add"] > summary["auc_add_official"]


class Boxes:
    """A detector that reports given detections."""

    def __init__(self, *detections: Detection) -> None:
        self.detections = list(detections)

    def detect(self, frame, names):
        assert list(names) == ["box", "brick"]
        return self.detections


def test_detected_poses_are_assigned_one_to_one_by_quality(models) -> None:
    left, right, far = pose_at(-0.1), pose_at(0.1), pose_at(0.0, -0.3, 1.5)
    scene = MemoryScene("s", {0: (truth(0, 5, left, 0.9), truth(1, 5, right, 0.9), truth(2, 7, far, 0.9))})
    box = Box(10, 10, 20, 20)
    detector = Boxes(*(Detection("box", box, 0.5) for _ in range(5)))
    near_left = se3.perturb(left, np.array([0.01, 0, 0, 0, 0, 0]))
    # The fourth is at another object's position. The last has a quality too low to be kept without a label.
    poses = [(near_left, 0.95), (left, 0.86), (right, 0.88), (far, 0.9), (far, 0.4)]
    estimator = ScriptedEstimator(lambda frame, query: estimate_of(query, *poses[query.instance]))
    options = EstimateOptions(boxes="detect")
    result = evaluate_estimates([scene], Targets(models), estimator, options, detector=detector)
    assert [r.quality for r in result.rows] == [0.95, 0.88, 0.0]
    assert result.rows[0].error.add_m == pytest.approx(0.01)
    assert result.rows[2].T_cam_obj is None
    assert [(f.object, f.quality) for f in result.false] == [(5, 0.9), (5, 0.86)]
    assert [r.reason for r in result.rows[:2]] == ["", ""]
    assert result.rows[2].reason.startswith("The detector found no place")
    assert result.summary()["false_poses"] == 2
    # Two of four poses are right: false ones are part of the calibration.
    assert result.summary()["ece"] == pytest.approx((0.05 + 0.12 + 0.9 + 0.86) / 4)


def test_a_pose_of_a_label_that_is_left_out_is_not_false(models) -> None:
    hidden = MemoryScene("s", {0: (truth(0, 5, pose_at(-0.1), 0.05), truth(1, 7, pose_at(0.2), 1.0))})
    detector = Boxes(Detection("box", Box(10, 10, 20, 20), 0.5))
    options = EstimateOptions(boxes="detect", min_visib=0.3)
    result = evaluate_estimates([hidden], Targets(models), answering(hidden), options, detector=detector)
    assert (len(result.rows), len(result.false)) == (1, 0)


def test_a_pose_that_hardly_overlaps_the_label_is_not_assigned(models) -> None:
    scene = MemoryScene("s", {0: (truth(0, 5, pose_at(0.0)),)})
    moved = se3.perturb(pose_at(0.0), np.array([0.2, 0, 0, 0, 0, 0]))
    detector = Boxes(Detection("box", Box(10, 10, 20, 20), 0.5))
    estimator = ScriptedEstimator(lambda frame, query: estimate_of(query, moved))
    options = EstimateOptions(boxes="detect")
    result = evaluate_estimates([scene], Targets(models), estimator, options, detector=detector)
    assert (result.rows[0].T_cam_obj, len(result.false)) == (None, 1)
    assert result.rows[0].reason == "The poses of the object that are kept are at other positions."


def test_the_summary_counts_images_without_objects(models) -> None:
    labels = {0: (truth(0, 5, pose_at(0.0)),), 1: (), 2: ()}
    scene = MemoryScene("s", labels)
    detector = Boxes(Detection("box", Box(10, 10, 20, 20), 0.5))
    estimator = ScriptedEstimator(lambda frame, query: estimate_of(query, pose_at(0.0)))
    options = EstimateOptions(boxes="detect")
    summary = evaluate_estimates([scene], Targets(models), estimator, options, detector=detector).summary()
    assert (summary["frames"], summary["instances"], summary["false_poses"]) == (3, 1, 2)


def test_no_poses_and_no_labels_give_no_assignment() -> None:
    assert assigned([], [], lambda name, T: None) == ({}, [])


@pytest.mark.parametrize("objects", [[16], [3]])
def test_without_labels_of_onboarded_objects_there_is_an_error(models, scene, objects) -> None:
    with pytest.raises(InputError, match="Onboard"):
        evaluate_estimates([scene], Targets(models, objects), answering(scene), EstimateOptions())


def test_two_scenes_with_the_same_name_are_refused(models, scene) -> None:
    with pytest.raises(InputError, match="scene '000001': found two folders"):
        evaluate_estimates([scene, scene], Targets(models), answering(scene), EstimateOptions())


def test_ar_is_given_only_if_all_rows_have_scores(models, scene) -> None:
    rows = evaluate_estimates([scene], Targets(models), answering(scene), EstimateOptions()).as_json()["rows"]
    score = {"bop": {"recalls": [1.0, 1.0, 0.4]}}
    whole = summary_of([row | score for row in rows])
    assert whole["ar"] == pytest.approx(80.0)
    part = summary_of([row | score if row["object"] == 5 else row for row in rows])
    assert part["per_object"][5]["ar"] == pytest.approx(80.0)
    assert part.get("ar") is part["per_object"][7].get("ar") is None


def test_contradicting_options_are_refused() -> None:
    with pytest.raises(InputError, match="--masks"):
        EstimateOptions(boxes="detect", masks="gt")


def test_a_label_outside_the_image_is_not_found(models) -> None:
    scene = MemoryScene("s", {0: (truth(0, 5, pose_at(5.0)),)})
    result = evaluate_estimates([scene], Targets(models), answering(scene), EstimateOptions())
    assert result.rows[0].T_cam_obj is None
    assert result.rows[0].as_json()["reason"].startswith("The box is empty")
