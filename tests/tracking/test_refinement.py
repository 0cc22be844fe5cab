"""Refinement, score and search against rendered truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Box, Camera, RgbdFrame, se3
from huepose.geometry.camera import NEAREST_M
from huepose.judge.open_region import OpenRegion, PreparedSurface, open_region, steepest, totals, window
from huepose.judge.terms import NOTHING, Terms, score_arrays
from huepose.model.types import ReferenceModel
from huepose.refine.photometric import FULL, NEAR, QUICK, refine, refine_all
from huepose.rendering import render
from huepose.tracking.config import TrackerConfig
from huepose.tracking.hypothesis import Anchor, Hypothesis
from huepose.tracking.motion import Reach
from huepose.tracking.refined import about_its_axis, best_of, unmoved
from huepose.tracking.search import search
from huepose.tracking.step import advance
from huepose.tracking.subject import Subject
from tests.onboarded import onboarded, times_as_large

SMALL = np.array([0.004, -0.005, 0.004, 0.04, -0.05, 0.05])


def region_of(surface: PreparedSurface, frame: RgbdFrame, T: np.ndarray) -> OpenRegion:
    box = surface.box(T, frame.camera)
    assert box is not None
    z = float(surface.centre_cam(T)[2])
    region = open_region(frame, box.grown(0.15, 10), z, surface.diameter_m)
    assert region is not None
    return region


def score(surface: PreparedSurface, region: OpenRegion, T: np.ndarray) -> Terms:
    return Terms(*score_arrays(surface.arrays, region.arrays, T[None], 400)[0])


def guess(T: np.ndarray, velocity: np.ndarray | None = None) -> Hypothesis:
    return Hypothesis(T, NOTHING, np.zeros((6, 6)), "still", velocity)


def errors(T: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Millimetres and degrees."""
    mm = 1e3 * float(np.linalg.norm(T[:3, 3] - truth[:3, 3]))
    return mm, float(np.degrees(se3.rotation_angle(T, truth)))


@pytest.mark.parametrize("start", [SMALL, -SMALL, np.array([0, 0, 0.008, 0, 0, 0.1])])
def test_a_box_is_refined_to_the_truth(tea_box, shoot, path, start) -> None:
    surface, truth = PreparedSurface.of(tea_box), path(0)
    frame = shoot([(tea_box.mesh, truth)])
    refined = refine(surface, region_of(surface, frame, truth), se3.perturb(truth, start))
    mm, degrees = errors(refined.T_cam_obj, truth)
    assert mm < 0.5
    assert degrees < 0.3
    assert np.linalg.eigvalsh(refined.information).min() > 0


def test_texture_settles_the_rotation_about_an_axis_of_symmetry(soup_can, shoot, path) -> None:
    """Eight degrees about the can's axis, which depth does not show."""
    surface, truth = PreparedSurface.of(soup_can), path(0)
    frame = shoot([(soup_can.mesh, truth)])
    yaw = se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.radians(8.0)])), np.zeros(3))
    region = region_of(surface, frame, truth)
    mm, degrees = errors(refine(surface, region, truth @ yaw).T_cam_obj, truth)
    assert mm < 0.7
    assert degrees < 0.6
    blind = replace(region, arrays=region.arrays._replace(saturated=np.ones_like(region.arrays.saturated)))
    _, degrees = errors(refine(surface, blind, truth @ yaw).T_cam_obj, truth)
    assert degrees > 6.0, "without colours nothing shows the rotation"


@pytest.mark.parametrize("light", [(0.5, 0.5, 0.5), (1.2, 0.8, 0.7), (0.6, 0.9, 1.2)])
def test_light_does_not_move_a_pose(tea_box, shoot, path, light) -> None:
    surface, truth = PreparedSurface.of(tea_box), path(0)
    frame = shoot([(tea_box.mesh, truth)], light=light)
    refined = refine(surface, region_of(surface, frame, truth), se3.perturb(truth, SMALL))
    mm, degrees = errors(refined.T_cam_obj, truth)
    assert mm < 0.6
    assert degrees < 0.4


def test_shading_on_a_plain_side_does_not_roll_a_can(half_plain_can, shoot) -> None:
    """A lamp beside the can makes its plain half lighter on one side, as no texture does."""
    surface = PreparedSurface.of(half_plain_can)
    lying = se3.rotation_exp(np.array([-1.1, 0.0, 0.0])) @ se3.rotation_exp(np.array([0.0, 0.0, 3.5]))
    truth = se3.make(lying, np.array([0.0, 0.0, 0.6]))
    frame = shoot([(half_plain_can.mesh, truth)])
    camera, on = frame.camera, frame.depth < 0.9
    v, u = np.nonzero(on)
    points = se3.apply(se3.inverse(truth), camera.backproject(np.stack([u, v], -1), frame.depth[on]))
    across = points[:, :2] / np.linalg.norm(points[:, :2], axis=1, keepdims=True)
    lamp = lying.T @ np.array([1.0, 0.0, 0.2])
    lit = 0.15 + 0.85 * np.maximum(across @ lamp[:2], 0.0)
    lit[np.abs(points[:, 2]) > 0.0485] = 0.15  # the lids
    color = frame.color.copy()
    color[on] = np.round(color[on] * lit[:, None] ** (1.0 / 2.2))
    frame = replace(frame, color=color)
    T, region = truth, region_of(surface, frame, truth)
    for _ in range(8):
        T = refine(surface, region, T, NEAR).T_cam_obj
    mm, degrees = errors(T, truth)
    assert mm < 3.0
    assert degrees < 8.0, "without a bound on the image's gradients it rolls by a quarter turn and more"


def test_no_texture_is_steeper_than_the_label_and_none_is_on_the_plain_side(half_plain_can) -> None:
    surface = PreparedSurface.of(half_plain_can)
    points = surface.arrays.points
    side = np.abs(points[:, 2]) < 0.03
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    plain, label = side & (azimuth > -170.0) & (azimuth < -70.0), side & (azimuth > 0.0) & (azimuth < 110.0)
    steep = surface.steepest.max(axis=-1)
    fine, middle, coarse = np.median(steep[:, label], axis=1)
    assert fine > 2.0 * middle > 4.0 * coarse > 1000.0, "one opponent colour unit or more per millimetre"
    assert steep[:2, plain].max() < 1.0
    assert steep[2, plain].max() < 0.05 * coarse


def test_the_texture_of_a_large_object_varies_as_well(tea_box) -> None:
    """Its samples lie farther apart, and so do the neighbours from which the variation of its texture is
    computed. An enlarged texture varies more slowly in proportion."""
    surface = PreparedSurface.of(tea_box)
    points, normals, colors = surface.arrays.points, surface.arrays.normals, surface.arrays.colors
    own = np.median(surface.steepest, axis=1)
    for size_m in (0.5, 1.0, 2.0):
        scale = size_m / tea_box.diameter_m
        assert (np.median(steepest(points * np.float32(scale), normals, colors), axis=1) > own / scale).all()


def test_an_occluder_does_not_shift_the_pose(tea_box, soup_can, shoot, path) -> None:
    surface, truth = PreparedSurface.of(tea_box), path(0)
    in_front = se3.make(np.eye(3), truth[:3, 3] * 0.75 + [0.02, 0.0, 0.0])
    frame = shoot([(tea_box.mesh, truth), (soup_can.mesh, in_front)])
    region = region_of(surface, frame, truth)
    assert 0.2 < score(surface, region, truth).hidden < 0.8
    mm, degrees = errors(refine(surface, region, se3.perturb(truth, 0.5 * SMALL)).T_cam_obj, truth)
    assert mm < 1.5
    assert degrees < 1.0


def test_poses_refined_together_are_those_refined_one_by_one(tea_box, shoot, path) -> None:
    surface, truth = PreparedSurface.of(tea_box), path(0)
    region = region_of(surface, shoot([(tea_box.mesh, truth)]), truth)
    z = float(surface.centre_cam(truth)[2])
    starts = np.array(
        [truth @ se3.make(se3.rotation_exp(np.array([0, 0, a])), np.zeros(3)) for a in (0.05, -0.1)]
    )
    together = refine_all(surface, region, starts, QUICK, z)
    for start, T in zip(starts, together, strict=True):
        np.testing.assert_allclose(refine(surface, region, start, QUICK).T_cam_obj, T, atol=1e-4)
    rated = totals(surface, region, starts, 400)
    np.testing.assert_allclose(rated, [totals(surface, region, T[None], 400)[0] for T in starts], atol=1e-9)


def test_the_terms_distinguish_right_wrong_absent_and_occluded(tea_box, soup_can, shoot, path) -> None:
    surface, truth = PreparedSurface.of(tea_box), path(0)
    frame = shoot([(tea_box.mesh, truth)])
    right = score(surface, region_of(surface, frame, truth), truth)
    assert right.total > 1.3
    assert right.seen > 0.85
    assert right.through < 0.05
    assert right.color > 0.6
    turned = truth @ se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    wrong = score(surface, region_of(surface, frame, truth), turned)
    assert wrong.total < right.total - 0.5, "the same shape with another texture"
    gone = shoot([])
    nothing = score(surface, region_of(surface, gone, truth), truth)
    assert nothing.through > 0.5
    assert nothing.seen < 0.05
    in_front = shoot([(tea_box.mesh, truth), (soup_can.mesh, se3.make(np.eye(3), truth[:3, 3] * 0.4))])
    hidden = score(surface, region_of(surface, in_front, truth), truth)
    assert hidden.hidden > 0.5
    blind = RgbdFrame(frame.color, np.zeros_like(frame.depth), frame.camera)
    assert score(surface, region_of(surface, blind, truth), truth).blind == pytest.approx(1.0)


def test_the_mean_colour_counts_if_the_light_is_known(tea_box, shoot, path) -> None:
    surface, truth = PreparedSurface.of(tea_box), path(0)
    light = (0.7, 0.9, 1.0)
    region = region_of(surface, shoot([(tea_box.mesh, truth)], light=light), truth)
    plain = score(surface, region, truth)
    known = score(surface, region.lit(np.array(plain.light)), truth)
    other = score(surface, region.lit(np.array(plain.light) + np.array([40.0, 30.0, 0.0])), truth)
    assert known.color > plain.color
    assert other.color == pytest.approx(plain.color, abs=0.005)


def test_windows_are_clipped_and_never_too_small() -> None:
    assert window(Box(-20, 10, 60, 47), 100, 100) == (0, 10, 40, 44)
    assert window(Box(90, 10, 60, 40), 100, 100) is None


def test_nan_and_infinite_depth_count_as_missing(tea_box: ReferenceModel, shoot, path) -> None:
    frame = shoot([(tea_box.mesh, path(0))])
    depth = frame.depth.copy()
    depth[::7, ::5], depth[::11, ::3] = np.nan, np.inf
    surface = PreparedSurface.of(tea_box)
    broken = RgbdFrame(frame.color, depth, frame.camera)
    refined = refine(surface, region_of(surface, broken, path(0)), se3.perturb(path(0), SMALL), FULL)
    mm, degrees = errors(refined.T_cam_obj, path(0))
    assert mm < 0.7
    assert degrees < 0.4


@pytest.mark.parametrize("axis", [[1.0, 0.2, 0.0], [0.1, -0.3, 1.0], [-0.5, 0.8, 0.3]])
def test_search_bridges_a_step_of_50_degrees_and_7_cm(tea_box, shoot, path, axis) -> None:
    surface, truth = PreparedSurface.of(tea_box), path(0)
    frame = shoot([(tea_box.mesh, truth)])
    turn = np.radians(50.0) * np.array(axis) / np.linalg.norm(axis)
    last = se3.perturb(truth, np.concatenate([[0.05, -0.03, 0.04], turn]))
    reach = Reach(surface.centre_cam(last), (last[:3, :3],), 0.12, np.radians(60.0))
    found = search(surface, frame, reach)
    mm, degrees = errors(found[0], truth)
    assert mm < 2.0
    assert degrees < 2.0


def test_search_finds_nothing_where_there_is_no_depth(tea_box, shoot, path) -> None:
    frame = shoot([(tea_box.mesh, path(0))])
    blind = RgbdFrame(frame.color, np.zeros_like(frame.depth), frame.camera)
    surface = PreparedSurface.of(tea_box)
    reach = Reach(surface.centre_cam(path(0)), (path(0)[:3, :3],), 0.1, 0.5)
    assert search(surface, blind, reach) == []
    behind = Reach(np.array([0.0, 0.0, -0.3]), (np.eye(3),), 0.1, 0.5)
    assert search(surface, frame, behind) == []


def test_a_velocity_is_used_only_if_the_image_agrees(tea_box, shoot, path) -> None:
    """The object stopped; the velocity says it went on by 8 cm."""
    subject, truth = Subject.of(tea_box), path(0)
    frames = [shoot([(tea_box.mesh, truth)], k) for k in (0, 1)]
    wrong = np.array([2.4, 0, 0, 0, 0, 3.0])
    found = advance(subject, Anchor((guess(truth, wrong),), frames[0]), frames[1], TrackerConfig())
    (step,) = found.followed
    assert step.source == "still"
    assert errors(step.T_cam_obj, truth)[0] < 0.5


def test_a_pose_outside_of_the_image_explains_nothing(tea_box, shoot) -> None:
    surface = PreparedSurface.of(tea_box)
    away = se3.make(np.eye(3), np.array([3.0, 0.0, 0.6]))
    step = best_of(surface, shoot([]), [(away, "still")])
    assert step.terms.outside == 1.0
    np.testing.assert_array_equal(step.T_cam_obj, away)
    assert surface.box(se3.make(np.eye(3), np.array([0.0, 0.0, -1.0])), shoot([]).camera) is None


def test_a_pose_that_slid_about_its_axis_of_revolution_is_rolled_back(soup_can, tea_box, shoot, path) -> None:
    subject, T = Subject.of(soup_can), path(0)
    frame = shoot([(soup_can.mesh, T)])
    slid = unmoved(subject.surface, frame, T @ subject.slides[1], None)
    found, margin, proposed = about_its_axis(subject, frame, slid, None, known=True)
    assert se3.rotation_angle(slid.T_cam_obj, T) > np.radians(10.0)
    assert se3.rotation_angle(found.T_cam_obj, T) < np.radians(2.0)
    right = unmoved(subject.surface, frame, T, None)
    assert about_its_axis(subject, frame, right, None, known=True)[0] is right
    assert about_its_axis(subject, frame, slid, None, known=False)[0] is slid, "it may be another object"
    assert len(Subject.of(tea_box).slides) == 0, "it has no such axis"


def test_a_slender_object_is_rolled_by_any_angle_if_all_of_it_is_visible(soup_can, shoot, path) -> None:
    vertices = soup_can.mesh.vertices * np.float32([0.25, 0.25, 1.6])
    stick = onboarded(replace(soup_can.mesh, vertices=vertices), "stick", searched=False)
    subject, T = Subject.of(stick), path(0)
    assert len(Subject.of(soup_can).rolls) < len(subject.rolls)
    far = max(subject.rolls, key=lambda turn: se3.rotation_angle(turn, np.eye(4)))
    rolled = unmoved(subject.surface, shoot([(stick.mesh, T)]), T @ far, None)
    assert se3.rotation_angle(rolled.T_cam_obj, T) > np.radians(100.0)
    found, _, _ = about_its_axis(subject, shoot([(stick.mesh, T)]), rolled, None, known=True)
    assert se3.rotation_angle(found.T_cam_obj, T) < np.radians(5.0)
    hidden = replace(rolled, terms=replace(rolled.terms, hidden=0.3))
    kept, _, _ = about_its_axis(subject, shoot([(stick.mesh, T)]), hidden, None, known=True)
    assert se3.rotation_angle(kept.T_cam_obj, T) > np.radians(60.0), (
        "the occluded part may be the one that shows the rotation"
    )


@pytest.mark.parametrize(
    ("ahead_m", "behind", "seen"), [(0.7, 0.0, 0.5), (0.3, 0.1, 0.35), (-0.3, 0.5, None)]
)
def test_an_object_that_reaches_past_the_camera_is_judged_by_the_part_ahead(
    tea_box: ReferenceModel, ahead_m: float, behind: float, seen: float | None
) -> None:
    """The camera looks ahead and down over a box of 1.2 m. behind: least share of its samples that are beside
    or behind the camera; seen: least value of the term `seen`, None if the pose explains nothing."""
    model, camera = times_as_large(tea_box, 8.0), Camera(600.0, 600.0, 319.5, 239.5, 640, 480)
    surface = PreparedSurface.of(model)
    T_cam_room = se3.make(se3.rotation_exp(np.array([np.radians(115.0), 0.0, 0.0])), np.zeros(3))
    lying = se3.make(se3.rotation_exp(np.array([np.pi / 2, 0.0, 0.0])), np.array([0.0, ahead_m, -0.55]))
    T = T_cam_room @ lying
    assert (se3.apply(T, surface.arrays.points)[:, 2] < NEAREST_M).mean() >= behind
    shown = render([(model.mesh, T)], camera)
    depth = np.where(shown.depth > 0, shown.depth, 3.0).astype(np.float32)
    terms = unmoved(surface, RgbdFrame(shown.color, depth, camera), T, None).terms
    if seen is None:
        assert terms is NOTHING
    else:
        assert terms.seen > seen
