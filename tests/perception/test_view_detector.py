"""The detector without weights: objects are found in whole frames, also several instances, and nothing
else."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.judge.borders import continuation_many
from huepose.judge.kernel_arrays import model_arrays
from huepose.model.types import ReferenceModel
from huepose.perception import scouting
from huepose.perception.clear_view import clear_view
from huepose.perception.config import DetectorConfig, Source
from huepose.perception.nearby import align_in_view
from huepose.perception.planes import large_planes, standing_clear
from huepose.perception.scouting import EFFORTS, Effort, likeliest_near_symmetries, propose
from huepose.perception.view_detector import ViewDetector
from huepose.perception.window_table import narrowed, promising, window_table
from huepose.perception.windows import WindowsBySize
from huepose.rendering.render import render_depth
from huepose.support.errors import InputError
from tests.boxes import box_of
from tests.conftest import TakePicture, standing_pose


@pytest.fixture(scope="module")
def frame(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, beside: np.ndarray
) -> RgbdFrame:
    return take_picture([(tea_box.mesh, standing), (tea_box.mesh, beside)])


def test_the_table_is_removed_and_the_objects_stay(
    frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray, beside: np.ndarray
) -> None:
    planes = large_planes(frame.depth, frame.camera, 0.09)
    tilt = np.radians(35.0)
    assert planes[0].normal @ np.array([0, -np.cos(tilt), -np.sin(tilt)]) > np.cos(np.radians(0.5))
    clear = standing_clear(frame.depth, frame.camera, planes, 0.3)
    objects = np.zeros_like(clear)
    for T in (standing, beside):
        objects |= render_depth(tea_box.mesh, T, frame.camera) > 0
    assert (clear & objects).sum() > 0.9 * (clear | objects).sum()


def test_of_the_near_symmetric_rotations_of_a_pose_the_right_one_is_the_likeliest(
    frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    view = clear_view(frame, tea_box.diameter_m)
    assert view is not None
    region = view.region(tea_box.diameter_m)
    for turn in tea_box.near_symmetries[1:]:
        found = likeliest_near_symmetries(tea_box, region, (standing @ np.linalg.inv(turn))[None])
        assert len(found) == 1
        np.testing.assert_allclose(found[0], standing, atol=1e-6)
    assert len(likeliest_near_symmetries(tea_box, region, np.zeros((0, 4, 4)))) == 0


@pytest.mark.parametrize("holes", [np.s_[::2], np.s_[1::2], np.s_[:, 1::2]])
def test_an_object_is_found_in_depth_with_a_grid_of_holes(
    frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray, holes: slice
) -> None:
    depth = frame.depth.copy()
    depth[holes] = 0.0
    found = ViewDetector({"tea_box": tea_box}).detect(replace(frame, depth=depth), ["tea_box"])
    assert max(d.box.iou(box_of(frame, tea_box, standing)) for d in found) > 0.7


def test_both_instances_are_found_where_they_are(
    frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray, beside: np.ndarray
) -> None:
    found = ViewDetector({"tea_box": tea_box}).detect(frame, ["tea_box"])
    assert [d.object for d in found] == ["tea_box", "tea_box"]
    for T in (standing, beside):
        best = max(found, key=lambda d: d.box.iou(box_of(frame, tea_box, T)))
        assert best.box.iou(box_of(frame, tea_box, T)) > 0.75
        assert best.T_cam_obj is not None
        difference = se3.difference(T, best.T_cam_obj)
        assert np.linalg.norm(difference[:3]) < 0.02


@pytest.mark.parametrize("sources", [("views",), ("keypoints", "views")])
def test_another_instance_is_found_beside_those_that_are_tracked(
    frame: RgbdFrame,
    tea_box: ReferenceModel,
    standing: np.ndarray,
    beside: np.ndarray,
    sources: tuple[Source, ...],
) -> None:
    config = DetectorConfig(sources=sources, proposals=1, remembering=True)
    detector = ViewDetector({"tea_box": tea_box}, config)
    for known, other in ((standing, beside), (beside, standing)):
        (found,) = detector.detect(frame, ["tea_box"], followed={"tea_box": [known]})
        assert found.T_cam_obj is not None
        assert np.linalg.norm(found.T_cam_obj[:3, 3] - other[:3, 3]) < 0.02
        assert found.score > 0.9
    assert detector.detect(frame, ["tea_box"], followed={"tea_box": [standing, beside]}) == []


def test_a_place_without_the_object_scores_less(
    frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray, take_picture: TakePicture
) -> None:
    detector = ViewDetector({"tea_box": tea_box}, DetectorConfig(proposals=1, min_score=0.0))
    (there,) = detector.detect(frame, ["tea_box"])
    grey = replace(tea_box.mesh, texture=np.full_like(tea_box.mesh.texture, 90))
    (other,) = detector.detect(take_picture([(grey, standing)]), ["tea_box"])
    assert there.score > 0.9 > other.score + 0.3


@pytest.mark.parametrize("source", ["keypoints", "views"])
def test_each_source_alone_finds_the_object(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, source: Source
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], light=(0.7, 0.8, 0.9))
    detector = ViewDetector({"tea_box": tea_box}, DetectorConfig(sources=(source,)))
    best = detector.detect(frame, ["tea_box"])[0]
    assert best.box.iou(box_of(frame, tea_box, standing)) > 0.75
    assert best.score > 0.9


def test_keypoints_alone_propose_nothing_where_there_is_no_print(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    grey = replace(tea_box.mesh, texture=np.full_like(tea_box.mesh.texture, 90))
    detector = ViewDetector({"tea_box": tea_box}, DetectorConfig(sources=("keypoints",), min_score=0.0))
    assert detector.detect(take_picture([(grey, standing)]), ["tea_box"]) == []


def test_an_empty_list_of_sources_is_refused() -> None:
    with pytest.raises(InputError, match="keypoints, views"):
        DetectorConfig(sources=())


def test_keypoints_are_used_only_if_views_are_not_sure(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scouting, "UNLIKE", 0.0)
    guessed = Mock(return_value=np.zeros((0, 4, 4)))
    grey = replace(tea_box.mesh, texture=np.full_like(tea_box.mesh.texture, 90))
    for mesh, times in ((tea_box.mesh, 0), (grey, 1)):
        view = clear_view(take_picture([(mesh, standing)]), 0.3)
        assert view is not None
        windows = WindowsBySize(view).of(tea_box.diameter_m)
        propose(tea_box, window_table(tea_box), view, windows, 1, guessed=guessed)
        assert guessed.call_count == times


@pytest.mark.parametrize(
    ("efforts", "likeness", "times"),
    [(EFFORTS, 0.0, 1), (EFFORTS, 1.0, 0), (EFFORTS[:1], 1.0, 1), ((), 1.0, 1)],
)
def test_keypoints_are_not_used_if_no_window_looks_like_the_object(
    tea_box: ReferenceModel,
    take_picture: TakePicture,
    standing: np.ndarray,
    monkeypatch: pytest.MonkeyPatch,
    efforts: tuple[Effort, ...],
    likeness: float,
    times: int,
) -> None:
    guessed = Mock(return_value=np.zeros((0, 4, 4)))
    monkeypatch.setattr(scouting, "UNLIKE", likeness)
    grey = replace(tea_box.mesh, texture=np.full_like(tea_box.mesh.texture, 90))
    view = clear_view(take_picture([(grey, standing)]), 0.3)
    assert view is not None
    windows = WindowsBySize(view).of(tea_box.diameter_m)
    propose(tea_box, window_table(tea_box), view, windows, 1, efforts, guessed)
    assert guessed.call_count == times
    # Without a window nothing was compared.
    monkeypatch.setattr(scouting, "promising", lambda *_: np.zeros(0, np.int64))
    propose(tea_box, window_table(tea_box), view, windows, 1, efforts, guessed)
    assert guessed.call_count == times + 1


def test_an_object_that_is_there_looks_like_one_of_its_views(
    frame: RgbdFrame, tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    grey = replace(tea_box.mesh, texture=np.full_like(tea_box.mesh.texture, 90))
    most = []
    for shown in (frame, take_picture([(grey, standing)])):
        view = clear_view(shown, 0.3)
        assert view is not None
        windows, table = WindowsBySize(view).of(tea_box.diameter_m), window_table(tea_box)
        most.append(narrowed(table, windows, promising(table, windows), 20)[1].max())
    assert most[0] > scouting.UNLIKE > most[1]


def test_an_empty_table_gives_nothing(tea_box: ReferenceModel, take_picture: TakePicture) -> None:
    assert ViewDetector({"tea_box": tea_box}).detect(take_picture([]), ["tea_box"]) == []


def test_an_unknown_object_is_an_error(frame: RgbdFrame, tea_box: ReferenceModel) -> None:
    with pytest.raises(InputError, match="coffee"):
        ViewDetector({"tea_box": tea_box}).detect(frame, ["coffee"])


def test_the_same_frame_gives_the_same_boxes(frame: RgbdFrame, tea_box: ReferenceModel) -> None:
    first, again = (ViewDetector({"tea_box": tea_box}).detect(frame, ["tea_box"]) for _ in range(2))
    assert [(d.box, d.score) for d in first] == [(d.box, d.score) for d in again]


def test_on_several_threads_the_boxes_are_the_same(frame: RgbdFrame, tea_box: ReferenceModel) -> None:
    models = {name: replace(tea_box, name=name) for name in ("tea_box", "twin", "third")}
    found = [ViewDetector(models, DetectorConfig(threads=n)).detect(frame, list(models)) for n in (1, 3)]
    assert [(d.object, d.box, d.score) for d in found[0]] == [(d.object, d.box, d.score) for d in found[1]]
    assert {d.object for d in found[0]} == set(models)


def test_objects_may_be_replaced_during_a_search(
    frame: RgbdFrame, tea_box: ReferenceModel, soup_can: ReferenceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search uses the model that it began with, the next one the model that replaced it."""
    detector = ViewDetector({"tea_box": tea_box})
    expected = detector.detect(frame, ["tea_box"])
    at_work = detector._pool.map

    def meanwhile(work, parts):
        detector.remove("tea_box")
        detector.add(replace(soup_can, name="tea_box"))
        return at_work(work, parts)

    with monkeypatch.context() as patch:
        patch.setattr(detector._pool, "map", meanwhile)
        found = detector.detect(frame, ["tea_box"])
    assert [(d.box, d.score) for d in found] == [(d.box, d.score) for d in expected]
    other = ViewDetector({"tea_box": replace(soup_can, name="tea_box")}).detect(frame, ["tea_box"])
    assert [d.score for d in detector.detect(frame, ["tea_box"])] == [d.score for d in other]


def test_one_call_finds_as_many_instances_as_are_wanted(
    tea_box: ReferenceModel, take_picture: TakePicture
) -> None:
    boxes = [standing_pose(0.4 * k, x, 0.0) for k, x in enumerate((-0.25, -0.08, 0.09, 0.26))]
    frame = take_picture([(tea_box.mesh, T) for T in boxes])
    detector = ViewDetector({"tea_box": tea_box}, DetectorConfig(proposals=2))

    def found(wanted: int) -> set[int]:
        seen = detector.detect(frame, ["tea_box"], wanted={"tea_box": wanted})
        poses = [d.T_cam_obj for d in seen if d.score > 0.5]
        return {int(np.argmin([np.linalg.norm((T - box)[:3, 3]) for box in boxes])) for T in poses}

    assert len(found(1)) <= 2
    assert found(4) == {0, 1, 2, 3}


def test_a_nearby_pose_is_aligned_with_the_depth(
    frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    view = clear_view(frame, 0.3)
    assert view is not None
    near = se3.perturb(standing, np.array([0.008, -0.006, 0.01, 0.1, -0.08, 0.06]))
    (aligned,) = align_in_view(tea_box, view, near[None])
    left = se3.difference(standing, aligned)
    assert np.linalg.norm(left[:3]) < 0.003
    assert np.linalg.norm(left[3:]) < np.radians(2.0)


def test_depth_continues_beyond_a_rim_inside_a_face_and_not_around_the_object(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    view = clear_view(box_frame, 0.3)
    assert view is not None
    eye = -standing[:3, :3].T @ standing[:3, 3]
    points, normals = tea_box.surface.points, tea_box.surface.normals
    middle = points[np.argmax(normals @ (eye / np.linalg.norm(eye)) - 5.0 * np.abs(points[:, 2]))]
    shrunk = middle + np.float32(0.4) * (points - middle)
    small = replace(tea_box, surface=replace(tea_box.surface, points=shrunk))
    crop, clear = view.crop, view.clear
    alone, inside = (
        continuation_many(model_arrays(m), crop.depth, clear, crop.camera, standing[None], 250)[0]
        for m in (tea_box, small)
    )
    assert alone < 0.1
    assert inside > 0.5
