"""A pose that slid along the object's faces, where depth has no say, is put back by the texture's edges."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from huepose.geometry import RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.refine.edge_refinement import refine_on_edges
from huepose.rendering.render import render_depth


def test_a_slide_is_undone_and_without_texture_or_mask_nothing_is(
    tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], light=(0.8, 0.7, 0.75))
    mask = render_depth(tea_box.mesh, standing, frame.camera) > 0
    up = standing[:3, :3] @ np.array([0.0, 0.0, 0.002])
    slid = standing.copy()
    slid[:3, 3] += up
    found = refine_on_edges(tea_box, frame, mask, slid)
    assert np.linalg.norm(found[:3, 3] - standing[:3, 3]) < 0.0004
    assert se3.rotation_angle(found, standing) < np.radians(0.3)
    plain = RgbdFrame(np.full_like(frame.color, 120), frame.depth, frame.camera)
    np.testing.assert_array_equal(refine_on_edges(tea_box, plain, mask, slid), slid)
    np.testing.assert_array_equal(refine_on_edges(tea_box, frame, np.zeros_like(mask), slid), slid)
