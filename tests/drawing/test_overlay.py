"""Overlays: the right pixels change, and only those."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.drawing import overlay
from huepose.geometry import Camera, se3
from huepose.rendering import render_depth
from tests.meshes import demo_objects

CAMERA = Camera(600.0, 600.0, 159.5, 119.5, 320, 240)
IMAGE = np.full((240, 320, 3), 100, np.uint8)
MESHES = demo_objects(0)
GREEN = (0, 200, 0)


def changed(picture: np.ndarray) -> np.ndarray:
    return np.asarray((picture != IMAGE).any(-1))


@pytest.mark.parametrize("name", MESHES)
def test_silhouette_is_that_of_the_renderer_but_for_its_border(name: str) -> None:
    T = se3.make(se3.rotation_exp(np.array([1.0, 0.5, -0.3])), np.array([0.03, -0.02, 0.6]))
    mask = overlay.silhouette(MESHES[name], T, CAMERA)
    drawn = render_depth(MESHES[name], T, CAMERA) > 0
    assert not (drawn & ~mask).any()
    assert (mask & ~drawn).sum() < 0.7 * 2 * np.sqrt(np.pi * drawn.sum()) * 1.6  # under a pixel around it


def test_silhouette_survives_poses_behind_and_across_the_camera() -> None:
    mesh = MESHES["soup_can"]
    assert not overlay.silhouette(mesh, se3.make(np.eye(3), np.array([0, 0, -0.5])), CAMERA).any()
    overlay.silhouette(mesh, se3.make(np.eye(3), np.array([0, 0, 0.02])), CAMERA)


def test_draw_pose_marks_outline_axes_and_label_and_leaves_the_image_alone() -> None:
    T = se3.make(se3.rotation_exp(np.array([1.0, 0.5, -0.3])), np.array([0.0, 0.0, 0.6]))
    before = IMAGE.copy()
    picture = overlay.draw_poses(IMAGE, CAMERA, [overlay.Body(MESHES["tea_box"], T, GREEN, "tea_box")])
    assert np.array_equal(IMAGE, before)
    border = overlay.draw_mask_outline(IMAGE, overlay.silhouette(MESHES["tea_box"], T, CAMERA), GREEN)
    pure = (picture == GREEN).all(-1) & (border == GREEN).all(-1)
    assert pure.sum() > 0.8 * (border == GREEN).all(-1).sum()
    origin = np.rint(CAMERA.project(T[:3, 3])).astype(int)
    assert changed(picture)[origin[1], origin[0]]


def test_labels_lie_over_all_else_and_beside_each_other() -> None:
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.9]))
    colors = [(0, 200, 0), (200, 0, 0), (0, 0, 200)]
    bodies = [overlay.Body(MESHES["tea_box"], T, color, "the same place") for color in colors]
    picture = overlay.draw_poses(IMAGE, CAMERA, bodies)
    one = [(overlay.draw_poses(IMAGE, CAMERA, [body]) == body.color).all(-1) for body in bodies]
    # Each has its whole plate; the outlines of the first two lie under that of the last.
    outline = overlay.draw_poses(IMAGE, CAMERA, [bodies[2]._replace(label="")])
    plate = int(one[2].sum() - (outline == colors[2]).all(-1).sum())
    assert plate > 500
    for color in colors:
        assert (picture == color).all(-1).sum() >= plate


def test_mask_outline_follows_border_and_hole() -> None:
    mask = np.zeros((240, 320), bool)
    mask[50:150, 60:200] = True
    mask[80:120, 100:160] = False
    touched = changed(overlay.draw_mask_outline(IMAGE, mask, GREEN, 1))
    assert touched[50, 60:200].all()
    assert touched[50:150, 199].all()
    assert touched[79, 100:160].all()
    assert not touched[60:70, 70:90].any()
    assert not touched[90:110, 110:150].any()
    assert not touched[:45].any()


def test_axes_end_where_the_unit_points_project() -> None:
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.5]))
    picture = overlay.draw_axes(IMAGE, CAMERA, T, 0.05)
    # x: 0.05 / 0.5 * 600 = 60 px to the right of the principal point; y the same downwards; z foreshortened.
    assert tuple(picture[120, 190]) == overlay.AXES[0]
    assert tuple(picture[150, 160]) == overlay.AXES[1]
    assert not changed(picture)[:, 225:].any()
    assert not changed(picture)[185:].any()


@pytest.mark.parametrize(
    ("x_px", "y_px"),
    [(95.0, 0.0), (100.0, 0.0), (130.0, 0.0), (0.0, 55.0), (0.0, 90.0), (-150.0, 0.0), (400.0, 0.0)],
)
def test_letters_of_axes_stay_inside_where_an_axis_ends_at_the_border_or_beyond(
    x_px: float, y_px: float
) -> None:
    """x_px, y_px: of the origin from the middle; the last one is out of the picture with all its axes."""
    T = se3.make(np.eye(3), np.array([x_px, y_px, 600.0]) / 1200.0)
    wide = replace(CAMERA, cx=CAMERA.cx + 500, cy=CAMERA.cy + 500, width=1320, height=1240)

    def letters(camera: Camera) -> int:
        """How many pixels they have."""
        paper = np.full((camera.height, camera.width, 3), 100, np.uint8)
        bare, named = (overlay.draw_axes(paper, camera, T, 0.05, letters=way) for way in (False, True))
        return int((bare != named).any(-1).sum())

    assert letters(CAMERA) == pytest.approx(letters(wide) if x_px < 400.0 else 0, rel=0.1)


def test_tint_mixes_inside_the_mask_only() -> None:
    mask = np.zeros((240, 320), bool)
    mask[10:20, 10:20] = True
    tinted = overlay.tint(IMAGE, mask, (200, 0, 100), 0.5)
    assert tinted[15, 15].tolist() == [150, 50, 100]
    assert np.array_equal(changed(tinted), mask)


def test_label_stays_inside() -> None:
    for at in ((-50, -50), (500, 500), (300, 5)):
        labelled = changed(overlay.draw_label(IMAGE, "name 0.98", at, GREEN))
        assert labelled.sum() == changed(overlay.draw_label(IMAGE, "name 0.98", (50, 100), GREEN)).sum()
