"""The dense score is highest at the truth and independent of light; each term measures what it should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.geometry.camera import depth_noise_m
from huepose.judge.kernel import IMPLAUSIBLE, MARGIN
from huepose.judge.region import Region
from huepose.judge.silhouette import visible_mask
from huepose.judge.terms import CLOSE_SAMPLES, Terms, score, score_many
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from tests.conftest import TakePicture
from tests.judge.regions import region_in, region_of
from tests.meshes import demo_objects


@pytest.fixture(scope="module")
def region(tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray) -> Region:
    return region_of(box_frame, tea_box, standing)


@pytest.fixture(scope="module")
def seen(tea_box: ReferenceModel, region: Region, standing: np.ndarray) -> Terms:
    return score(tea_box, region, standing)


def test_the_truth_scores_high_in_every_term(seen: Terms) -> None:
    assert seen.depth_fit > 0.8
    assert seen.coverage > 0.9
    assert seen.violation < 0.03
    assert seen.color > 0.7
    assert seen.occluded == 0.0
    assert seen.seen > 0.9
    assert seen.box_iou > 0.9


def test_the_truth_beats_every_other_pose(
    tea_box: ReferenceModel, standing: np.ndarray, region: Region
) -> None:
    steps = [np.eye(6)[k] * s for k in range(3) for s in (-0.02, -0.006, 0.006, 0.02)]
    steps += [np.eye(6)[3 + k] * np.radians(s) for k in range(3) for s in (-90, -20, -5, 5, 20, 90, 180)]
    poses = np.array([standing] + [se3.perturb(standing, s) for s in steps])
    totals = score_many(tea_box, region, poses, CLOSE_SAMPLES)[:, 0]
    assert (totals[1:] < totals[0] - 0.02).all()


def test_light_changes_nothing(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, seen: Terms
) -> None:
    """A gain on each channel leaves the colour term almost as it was."""
    for light in ((0.4, 0.4, 0.4), (0.9, 0.7, 0.45), (0.5, 0.6, 0.9)):
        frame = take_picture([(tea_box.mesh, standing)], light)
        lit = score(tea_box, region_of(frame, tea_box, standing), standing)
        assert lit.color == pytest.approx(seen.color, abs=0.06)
        assert lit.depth_fit == seen.depth_fit


def test_another_texture_on_the_same_shape_scores_lower(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, seen: Terms
) -> None:
    other = take_picture([(demo_objects(1)["tea_box"], standing)])
    wrong = score(tea_box, region_of(other, tea_box, standing), standing)
    assert wrong.color < seen.color - 0.4
    assert wrong.total < seen.total - 0.4


def test_nearer_depth_is_occlusion_and_farther_depth_is_violation(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    silhouette = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    middle = int(np.nonzero(silhouette)[1].mean())
    right = silhouette & (np.arange(640) > middle)[None, :]
    left = silhouette & ~right
    nearer = replace(box_frame, depth=np.where(right, box_frame.depth - np.float32(0.1), box_frame.depth))
    farther = replace(box_frame, depth=np.where(right, box_frame.depth + np.float32(0.1), box_frame.depth))
    occluded, violated = (
        score(tea_box, region_in(changed, left, tea_box.diameter_m), standing)
        for changed in (nearer, farther)
    )
    assert 0.3 < occluded.occluded < 0.7
    assert occluded.violation < 0.03
    assert 0.3 < occluded.seen < 0.7
    assert violated.violation > 0.3
    assert violated.occluded < 0.03
    assert occluded.total > violated.total + 0.3


def test_a_pose_may_be_behind_something_but_not_inside_it(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    """Two thirds of an object are occluded: by something 10 cm in front of them, or, as if it sank into its
    support, by depth 15 mm in front of them."""
    silhouette = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    shown = silhouette & (np.arange(640) < np.quantile(np.nonzero(silhouette)[1], 0.33))[None, :]
    scores = []
    for nearer_m in (0.1, 0.015):
        near = np.where(silhouette & ~shown, box_frame.depth - np.float32(nearer_m), box_frame.depth)
        region = region_in(replace(box_frame, depth=near), shown, tea_box.diameter_m)
        scores.append(score(tea_box, region, standing))
    behind, sunk = scores
    assert behind.violation < 0.03
    assert sunk.violation > 0.25
    assert behind.occluded > sunk.occluded > 0.4
    assert sunk.total < behind.total - 0.25


def test_a_surface_behind_the_mask_counts_half_as_much_as_a_free_space_violation(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    """The mask is on something 10 cm in front of the whole object: all of the surface lies behind it."""
    silhouette = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    near = replace(box_frame, depth=np.where(silhouette, box_frame.depth - np.float32(0.1), box_frame.depth))
    seen = score(tea_box, region_in(near, silhouette, tea_box.diameter_m), standing)
    assert seen.violation == pytest.approx(IMPLAUSIBLE / (IMPLAUSIBLE + MARGIN), abs=0.03)
    assert seen.coverage < 1e-6


@pytest.mark.parametrize("distance_m", [0.8, 1.6, 2.4])
def test_depth_noise_is_no_free_space_violation(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, distance_m: float
) -> None:
    T = standing.copy()
    T[:3, 3] *= distance_m / T[2, 3]
    frame = take_picture([(tea_box.mesh, T)], with_table=False)
    rng = np.random.default_rng(7)
    noise = depth_noise_m(distance_m) * rng.normal(size=frame.depth.shape)
    frame = replace(frame, depth=np.where(frame.depth > 0, frame.depth + noise, 0.0).astype(np.float32))
    region = region_of(frame, tea_box, T)
    anywhere = Region.whole(region.crop, region.mask, region.colors, tea_box.diameter_m, 1.0)
    terms = score(tea_box, anywhere, T)
    assert terms.through < 0.1
    assert terms.depth_fit > 0.4
    shown = visible_mask(tea_box, frame, T, region.tolerance_m)
    assert shown.sum() > 0.8 * region.mask.sum()


def test_the_origin_of_a_mesh_changes_no_tolerance(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray, region: Region
) -> None:
    """The measured surface is a little behind the pose, and the origin is four metres behind it."""
    by = standing[:3, :3].T @ [0.0, 0.0, 4.0]
    mesh = replace(tea_box.mesh, vertices=(tea_box.mesh.vertices - by).astype(np.float32))
    surface = replace(tea_box.surface, points=(tea_box.surface.points - by).astype(np.float32))
    grid = replace(tea_box.grid, origin=tea_box.grid.origin - by)
    moved = replace(tea_box, mesh=mesh, surface=surface, grid=grid)
    nearer = se3.make(np.eye(3), np.array([0.0, 0.0, -0.015])) @ standing
    anywhere = Region.whole(region.crop, region.mask, region.colors, tea_box.diameter_m, 1.0)
    T = nearer @ se3.make(np.eye(3), by)
    assert score(moved, anywhere, T).through == pytest.approx(
        score(tea_box, anywhere, nearer).through, abs=0.02
    )
    assert visible_mask(moved, box_frame, T, 0.009).sum() < 0.3 * region.mask.sum()


def test_saturated_pixels_do_not_count(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray, seen: Terms
) -> None:
    """A glare of pure white over a third of the object leaves the colour of the rest."""
    silhouette = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    top = int(np.nonzero(silhouette)[0].mean())
    glare = box_frame.color.copy()
    glare[top : top + 40] = 255
    lit = score(tea_box, region_of(replace(box_frame, color=glare), tea_box, standing), standing)
    assert lit.color > seen.color - 0.15


def test_many_equal_one_by_one_and_repeat(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray, region: Region
) -> None:
    rng = np.random.default_rng(0)
    poses = np.array([se3.perturb(standing, rng.normal(0, 0.02, 6)) for _ in range(6)])
    many = score_many(tea_box, region, poses, CLOSE_SAMPLES)
    assert np.array_equal(
        many, score_many(tea_box, region_of(box_frame, tea_box, standing), poses, CLOSE_SAMPLES)
    )
    for row, T in zip(many, poses, strict=True):
        one = score(tea_box, region, T)
        assert (one.total, one.color, one.box_iou) == (row[0], row[4], row[7])


def test_poses_behind_the_camera_or_far_outside_are_scored_not_crashed(
    tea_box: ReferenceModel, region: Region
) -> None:
    away = [
        se3.make(np.eye(3), np.array(t)) for t in ([0, 0, -1.0], [0, 0, 0.0], [9.0, 0, 0.1], [0, 0, 50.0])
    ]
    scores = score_many(tea_box, region, np.array(away), CLOSE_SAMPLES)
    assert np.isfinite(scores).all()
    assert (scores[:, 0] < 0.2).all()
