from __future__ import annotations

import cv2
import numpy as np
import pytest

from huepose.geometry import Camera, icosphere, se3
from huepose.model.types import ReferenceModel, ViewTemplates
from huepose.propose.templates import build_templates
from huepose.propose.view_images import upright_views
from huepose.rendering.render import render
from tests.onboarding import solids


@pytest.fixture(scope="module")
def shifted(tea_box: ReferenceModel) -> ViewTemplates:
    """A few templates of the box, with an origin far from its middle."""
    return build_templates(off_centre(tea_box), tea_box.diameter_m, level=1, rolls=8)


def off_centre(model: ReferenceModel):
    from huepose.geometry import Mesh

    m = model.mesh
    return Mesh(m.vertices + np.array([0.03, -0.02, 0.05], np.float32), m.faces, m.uv, m.texture)


@pytest.mark.parametrize(("view", "roll"), [(0, 0), (5, 1), (17, 3), (29, 6), (41, 7)])
def test_a_template_is_the_image_at_its_pose(
    tea_box: ReferenceModel, shifted: ViewTemplates, view: int, roll: int
) -> None:
    """Rendered again at the documented pose, from another distance, with another camera."""
    angle = 2 * np.pi * roll / 8
    Rz = se3.rotation_exp(np.array([0.0, 0.0, angle]))
    distance = 0.85
    R = Rz @ icosphere.look_at(shifted.directions[view])
    middle = np.array([0.0, 0.0, distance])
    T_cam_obj = se3.make(R, middle + Rz @ shifted.origins[view].astype(np.float64))
    window_m = shifted.span * tea_box.diameter_m
    pixels = 256
    focal = pixels * distance / window_m
    camera = Camera(focal, focal, (pixels - 1) / 2, (pixels - 1) / 2, pixels, pixels)
    rendered = render([(off_centre(tea_box), T_cam_obj)], camera)
    covered = (rendered.depth > 0).astype(np.float32)
    coverage = cv2.resize(covered, (16, 16), interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(rendered.color.astype(np.float32) / 255, cv2.COLOR_RGB2Lab) * covered[..., None]
    lab = cv2.resize(lab, (16, 16), interpolation=cv2.INTER_AREA) / np.maximum(coverage, 1e-3)[..., None]
    depth = cv2.resize((rendered.depth - distance) * covered, (16, 16), interpolation=cv2.INTER_AREA)
    depth /= np.maximum(coverage, 1e-3)
    L, a, b, relative, known = shifted.planes[view, roll].astype(np.float32)
    assert np.abs(known - coverage).max() < 0.12
    assert np.abs(known - coverage).mean() < 0.01
    sure = (known > 0.9) & (coverage > 0.9)
    assert sure.sum() > 20
    assert np.median(np.abs(np.stack([L, a, b], -1) - lab)[sure]) < 1.5
    assert np.abs(relative - depth)[sure].max() < 0.03 * tea_box.diameter_m


def test_templates_are_normalised(shifted: ViewTemplates) -> None:
    L, a, b, depth, coverage = np.moveaxis(shifted.planes.astype(np.float32), 2, 0)
    assert coverage.min() >= 0
    assert coverage.max() <= 1
    assert (np.stack([L, a, b, depth])[:, coverage == 0] == 0).all()
    weights = coverage / coverage.sum((2, 3), keepdims=True)
    y, x = np.mgrid[:16, :16] - 7.5
    for axis in (x, y):  # the silhouette's centroid is the middle of the window
        assert np.abs((weights * axis).sum((2, 3))).max() < 0.15
    full = shifted.planes[:, :, 4].astype(np.float32).sum((2, 3))
    assert (np.ptp(full, axis=1) / full.mean(1)).max() < 0.05  # rolls show the same area


def test_a_sheet_that_is_seen_from_its_edge_has_an_empty_template() -> None:
    """Thinner than a pixel: no ray meets it."""
    sheet = solids.box((0.21, 0.297, 0.0001))
    made = build_templates(sheet, 0.36, level=1, rolls=2)
    covered = made.planes[:, :, 4].astype(np.float32).sum((1, 2, 3))
    assert covered.min() == 0.0
    assert covered.max() > 100.0
    assert np.isfinite(made.origins).all()
    assert np.isfinite(made.planes).all()
    colors, reliefs = upright_views(sheet, 0.36)
    assert np.isnan(reliefs).all((1, 2)).any()
    assert (colors[np.isnan(reliefs).all((1, 2))] == 0).all()


def test_quarter_rolls_are_rotated_templates(shifted: ViewTemplates) -> None:
    """A rotation by 90 degrees from x to y takes right to below: clockwise in the image."""
    for view in (0, 7, 23):
        for roll in range(6):
            now, later = (shifted.planes[view, r].astype(np.float32) for r in (roll, roll + 2))
            rotated = np.rot90(now, k=-1, axes=(1, 2))
            assert np.abs(rotated[4] - later[4]).max() < 0.02
