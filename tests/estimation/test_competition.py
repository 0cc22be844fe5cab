"""Poses compete for depth: the surer keeps its pixels, the other is estimated again without them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation import Estimator, ObjectQuery, PoseEstimate
from huepose.estimation.estimator import Answered, compete
from huepose.estimation.explanation import Explanation
from huepose.geometry import Box, Camera, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from tests.boxes import box_of
from tests.conftest import TakePicture

FRAME = RgbdFrame(
    np.zeros((40, 60, 3), np.uint8), np.ones((40, 60), np.float32), Camera(60, 60, 30, 20, 60, 40)
)

SEEN_FIRST, SEEN_NOW = Explanation(Box(0, 0, 1, 1), (), None), Explanation(Box(0, 0, 1, 1), (), None)


def answer(name: str, quality: float, columns: slice) -> PoseEstimate:
    mask = np.zeros((40, 60), bool)
    mask[10:30, columns] = True
    T, box = np.eye(4), Box(0, 10, 10, 10)
    return PoseEstimate(name, 0, True, T, quality, "SUSPECT", 2.0, 0.1, np.eye(6), mask, box, seconds=0.1)


def query(name: str, x: float) -> ObjectQuery:
    return ObjectQuery(name, Box(x, 10, 20, 20))


class Looks:
    """Answers a second look with a given quality, and keeps the frames that it gets."""

    def __init__(self, quality: float) -> None:
        self.quality = quality
        self.seen: dict[str, RgbdFrame] = {}

    def __call__(self, frame: RgbdFrame, query: ObjectQuery) -> Answered:
        self.seen[query.object] = frame
        return answer(query.object, self.quality, slice(40, 60)), SEEN_NOW


def competed(
    queries: Sequence[ObjectQuery], answers: Sequence[PoseEstimate], looks: Looks
) -> list[PoseEstimate]:
    """The answers that are left; each comes with the explanation of its own look."""
    out = compete(FRAME, queries, [(a, SEEN_FIRST) for a in answers], looks)
    for found, seen in out:
        assert seen is (SEEN_FIRST if any(found is a for a in answers) else SEEN_NOW)
    return [found for found, _ in out]


def test_a_pose_on_taken_pixels_gives_way_to_one_that_is_found_without_them() -> None:
    looks = Looks(0.3)
    answers = [answer("weak", 0.7, slice(10, 30)), answer("strong", 0.9, slice(10, 30))]
    weak, strong = competed([query("weak", 10), query("strong", 10)], answers, looks)
    assert strong is answers[1]
    assert weak.quality == 0.3
    assert weak.seconds == pytest.approx(0.2)
    (seen,) = looks.seen.values()
    assert not seen.depth[10:30, 10:30].any()
    assert seen.depth.sum() == 40 * 60 - 20 * 20
    assert FRAME.depth.all()


@pytest.mark.parametrize(("found", "kept"), [(0.3, True), (0.75, False)])
def test_a_doubtful_pose_beside_taken_pixels_changes_only_for_a_surer_one(found: float, kept: bool) -> None:
    answers = [answer("strong", 0.9, slice(10, 20)), answer("weak", 0.5, slice(20, 30))]
    _, weak = competed([query("strong", 0), query("weak", 15)], answers, Looks(found))
    assert (weak is answers[1]) == kept


def test_sure_poses_beside_each_other_and_unsure_claims_change_nothing() -> None:
    looks = Looks(0.9)
    sure = [answer("a", 0.9, slice(10, 20)), answer("b", 0.85, slice(20, 30))]
    unsure = [answer("a", 0.4, slice(10, 30)), answer("b", 0.3, slice(10, 30))]
    for answers in (sure, unsure):
        out = competed([query("a", 5), query("b", 15)], answers, looks)
        assert all(x is y for x, y in zip(out, answers, strict=True))
    assert not looks.seen


def test_two_instances_in_one_box_are_both_found(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    beside = se3.compose(se3.make(np.eye(3), np.array([0.15, 0.0, 0.0])), standing)
    frame = take_picture([(tea_box.mesh, standing), (tea_box.mesh, beside)])
    both = np.zeros(frame.depth.shape, bool)
    for T in (standing, beside):
        both |= render_depth(tea_box.mesh, T, frame.camera) > 0
    box = Box.of_mask(both)
    queries = [ObjectQuery("tea_box", box, instance=k) for k in range(2)]
    estimator = Estimator({"tea_box": tea_box})
    found = estimator.estimate(frame, queries)
    alone = [estimator.estimate(frame, [query])[0] for query in queries]
    assert np.array_equal(alone[0].T_cam_obj, alone[1].T_cam_obj)
    for T in (standing, beside):
        assert (
            min(np.linalg.norm(a.T_cam_obj[:3, 3] - T[:3, 3]) for a in found if a.T_cam_obj is not None)
            < 0.003
        )


def test_one_surface_is_not_given_to_two_objects(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    box = box_of(box_frame, tea_box, standing)
    models = {"tea_box": tea_box, "twin": replace(tea_box, name="twin")}
    first, second = Estimator(models).estimate(box_frame, [ObjectQuery(name, box) for name in models])
    assert first.quality > 0.9
    assert second.quality < 0.5
