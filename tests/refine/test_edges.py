"""Edges in the image bring a pose home along the faces, where depth has no say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.colorpair.extract import extract
from huepose.colorpair.types import ColorPairs, SurfacePairs
from huepose.geometry import RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.refine.edge_refinement import align_edges
from huepose.refine.edges import ImageEdges, image_edges, model_edges
from huepose.rendering.render import render_depth

TakePicture = Callable[..., RgbdFrame]


def fine_pairs(model: ReferenceModel) -> SurfacePairs:
    p, first = model.pairs, int(model.pairs.parameters["coarse_pairs"])
    return SurfacePairs(p.points[first:], p.normals[first:], p.tangents[first:], p.colors[first:])


@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), (0.9, 0.65, 0.5)])
def test_a_shift_along_the_faces_is_undone_in_any_light(
    light: tuple[float, float, float],
    tea_box: ReferenceModel,
    take_picture: TakePicture,
    standing: np.ndarray,
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], light=light)
    mask = render_depth(tea_box.mesh, standing, frame.camera) > 0
    edges = image_edges(extract(frame.color, mask))
    rng = np.random.default_rng(0)
    for _ in range(4):
        offset = rng.normal(size=6)
        offset[:3] *= 0.003 / np.linalg.norm(offset[:3])
        offset[3:] *= np.radians(2.0) / np.linalg.norm(offset[3:])
        start = se3.perturb(standing, offset)
        found = align_edges(
            model_edges(fine_pairs(tea_box)), tea_box.surface, edges, frame.depth, frame.camera, start
        )
        assert found.matched > 50
        assert found.rms_px < 0.8
        assert np.linalg.norm((found.T_cam_obj - standing)[:3, 3]) < 0.0006
        assert se3.rotation_angle(found.T_cam_obj, standing) < np.radians(0.4)


def test_edges_of_the_other_contrast_hardly_match_and_none_leave_the_pose_alone(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)])
    mask = render_depth(tea_box.mesh, standing, frame.camera) > 0
    edges = image_edges(extract(frame.color, mask))
    inverted = ImageEdges(edges.pixels, edges.directions, -edges.contrasts)
    right, wrong, none = (
        align_edges(
            model_edges(fine_pairs(tea_box)), tea_box.surface, seen, frame.depth, frame.camera, standing
        )
        for seen in (edges, inverted, image_edges(ColorPairs.empty()))
    )
    assert wrong.matched < 0.3 * right.matched  # what does match is the other side of thin lines
    assert none.matched == 0
    np.testing.assert_array_equal(none.T_cam_obj, standing)
