"""Keypoints of a model lie on it and are found again; matches that agree give the pose, others none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame, se3
from huepose.model.types import Keypoints, ReferenceModel
from huepose.propose import keypoint_reference
from huepose.propose.features import Features, Sift
from huepose.propose.keypoint_reference import PICTURE_PX, build_keypoints
from huepose.propose.keypoints import ImageFeatures, Matches, ModelKeypoints, consensus_poses, match
from tests.conftest import TakePicture

CAMERA = Camera(600.0, 600.0, 319.5, 239.5, 640, 480)


@pytest.fixture(scope="module")
def keypoints(tea_box: ReferenceModel) -> Keypoints:
    return tea_box.keypoints


@pytest.fixture(scope="module")
def frame(tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray) -> RgbdFrame:
    return take_picture([(tea_box.mesh, standing)], light=(0.6, 0.7, 0.8))


def matches_in(frame: RgbdFrame, keypoints: Keypoints) -> Matches:
    return match(ModelKeypoints.of(keypoints), ImageFeatures.of(Sift().extract(frame.color)))


def test_keypoints_lie_on_the_surface_and_look_outwards(
    keypoints: Keypoints, tea_box: ReferenceModel
) -> None:
    assert len(keypoints.points) > 100
    half = np.abs(tea_box.mesh.vertices).max(0)
    off_sides = np.abs(np.abs(keypoints.points) - half)
    assert off_sides.min(1).max() < 1e-4
    side = off_sides.argmin(1)
    outwards = np.sign(keypoints.points) * np.eye(3)[side]
    assert ((keypoints.normals * outwards).sum(1) > 0.99).mean() > 0.98


def test_a_mesh_gives_the_same_keypoints_again_and_never_more_than_asked_for(
    keypoints: Keypoints, tea_box: ReferenceModel
) -> None:
    again = build_keypoints(tea_box.mesh, tea_box.diameter_m, count=50)
    assert again.source == keypoints.source == "sift"
    np.testing.assert_array_equal(again.points, keypoints.points[:50])
    np.testing.assert_array_equal(again.descriptors, keypoints.descriptors[:50])


def test_features_are_sought_on_the_mask_only(frame: RgbdFrame) -> None:
    mask = np.zeros(frame.depth.shape, bool)
    mask[:, :320] = True
    found = Sift().extract(frame.color, mask)
    assert len(found) > 10
    assert found.pixels[:, 0].max() < 320.5
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1.0, atol=1e-5)


def test_the_pose_of_an_object_in_other_light_is_found(
    frame: RgbdFrame, keypoints: Keypoints, standing: np.ndarray
) -> None:
    found = consensus_poses(matches_in(frame, keypoints), frame.depth, frame.camera)
    assert found.inliers[0] >= 10
    off = se3.difference(standing, found.poses[0])
    assert np.linalg.norm(off[:3]) < 0.003
    assert np.linalg.norm(off[3:]) < np.radians(3.0)


def test_without_depth_the_image_alone_gives_the_pose(
    frame: RgbdFrame, keypoints: Keypoints, standing: np.ndarray
) -> None:
    found = consensus_poses(matches_in(frame, keypoints), np.zeros_like(frame.depth), frame.camera)
    assert len(found.poses) == 1
    off = se3.difference(standing, found.poses[0])
    assert np.linalg.norm(off[:3]) < 0.01
    assert np.linalg.norm(off[3:]) < np.radians(3.0)


def test_no_pose_is_found_without_the_object(take_picture: TakePicture, keypoints: Keypoints) -> None:
    table = take_picture([])
    assert len(consensus_poses(matches_in(table, keypoints), table.depth, table.camera).poses) == 0
    grey = np.full((480, 640, 3), 90, np.uint8)
    assert len(match(ModelKeypoints.of(keypoints), ImageFeatures.of(Sift().extract(grey)))) == 0


def test_a_similar_spot_nearby_does_not_make_a_match_doubtful_and_one_far_away_does() -> None:
    look = np.array([[1.0, 0.0]], np.float32)
    near, other = np.array([[0.999, 0.04]], np.float32), np.array([[0.9, 0.43]], np.float32)
    model = ModelKeypoints(np.zeros((1, 3)), np.zeros((1, 3)), look)

    def matched(*pixels: tuple[float, float]) -> int:
        features = Features(np.array(pixels, np.float32), np.concatenate([look, near, other])[: len(pixels)])
        return len(match(model, ImageFeatures.of(features)))

    assert matched((10.0, 10.0), (11.0, 10.0)) == 1
    assert matched((10.0, 10.0), (60.0, 10.0)) == 1  # exactly alike: nothing is nearer
    features = Features(np.array([[10.0, 10.0], [60.0, 10.0]], np.float32), np.concatenate([near, near]))
    assert len(match(model, ImageFeatures.of(features))) == 0


def planted(right: int, wrong: int, seed: int = 0) -> tuple[Matches, np.ndarray, np.ndarray]:
    """Matches of a plate of 20 cm at a known pose, its depth and pose; the wrong ones point anywhere."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.1, 0.1, (right + wrong, 2)), np.zeros(right + wrong)])
    T = se3.make(se3.rotation_exp(np.array([np.pi + 0.3, 0.2, 0.1])), np.array([0.02, -0.03, 0.8]))
    pixels = CAMERA.project(se3.apply(T, points))
    pixels[right:] = rng.uniform([0, 0], [639, 479], (wrong, 2))
    pixels = np.rint(pixels)
    normal, at = T[:3, 2], T[:3, 3]
    v, u = np.mgrid[0:480, 0:640]
    rays = CAMERA.rays(np.stack([u, v], -1))
    depth = (normal @ at / (rays @ normal)).astype(np.float32)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return Matches(points, normals, pixels), depth, T


def test_a_fifth_of_right_matches_is_enough() -> None:
    matches, depth, T = planted(right=12, wrong=48)
    found = consensus_poses(matches, depth, CAMERA)
    assert 11 <= found.inliers[0] <= 14
    off = se3.difference(T, found.poses[0])
    assert np.linalg.norm(off[:3]) < 0.002
    assert np.linalg.norm(off[3:]) < np.radians(1.0)


def test_wrong_matches_agree_on_hardly_anything() -> None:
    counts = []
    for seed in range(20):
        matches, depth, _ = planted(right=0, wrong=60, seed=seed)
        counts.append(consensus_poses(matches, depth, CAMERA).inliers.max(initial=0))
    assert np.median(counts) <= 4
    assert max(counts) <= 6


def test_one_piece_of_surface_counts_once_however_many_matches_it_has() -> None:
    matches, depth, _ = planted(right=5, wrong=0)
    many = matches[np.repeat(np.arange(5), 10)]
    assert consensus_poses(many, depth, CAMERA).inliers.tolist() == [5]


def test_a_surface_that_faces_away_gives_no_pose() -> None:
    matches, depth, _ = planted(right=12, wrong=0)
    away = Matches(matches.points, -matches.normals, matches.pixels)
    assert len(consensus_poses(away, depth, CAMERA).poses) == 0


def test_two_objects_are_two_poses(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, keypoints: Keypoints
) -> None:
    """Different sides of them are visible: the same side twice would make the matches ambiguous."""
    turned = standing @ se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.pi])), np.zeros(3))
    turned[0, 3] += 0.2
    both = take_picture([(tea_box.mesh, standing), (tea_box.mesh, turned)])
    found = consensus_poses(matches_in(both, keypoints), both.depth, both.camera)
    for T in (standing, turned):
        assert min(np.linalg.norm(pose[:3, 3] - T[:3, 3]) for pose in found.poses) < 0.005


def test_views_of_a_large_object_are_no_larger_than_an_image(
    tea_box: ReferenceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    # From twelve sides, which are as large as all others, each compared with one test view.
    monkeypatch.setattr(keypoint_reference, "LEVEL", 0)
    monkeypatch.setattr(keypoint_reference, "TEST_VIEWS", 1)
    widths = []

    class Watched(Sift):
        def extract(self, color: np.ndarray, mask: np.ndarray | None = None) -> Features:
            widths.append(color.shape[1])
            return super().extract(color, mask)

    large = replace(tea_box.mesh, vertices=tea_box.mesh.vertices * np.float32(10.0))
    assert len(build_keypoints(large, 10.0 * tea_box.diameter_m, Watched()).points) > 100
    assert max(widths) == 1.25 * PICTURE_PX + 24
