"""The scene for measurements of growth, and the exponents that are fitted."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.growth import copies, exponent, halved, picture, truth
from huepose.geometry import se3
from huepose.model.types import ReferenceModel


@pytest.mark.parametrize("slope", [0.0, 1.0, 1.5])
def test_the_exponent_of_a_power_law_is_found(slope: float) -> None:
    assert exponent([(n, 3.0 * n**slope) for n in (1, 2, 5, 10, 20)]) == pytest.approx(slope)


def test_a_constant_cost_does_not_hide_growth() -> None:
    assert exponent([(n, 100.0 + n**2) for n in (1, 10, 100, 1000, 10000)]) > 1.8


def test_objects_are_in_the_image_at_their_true_poses(tea_box: ReferenceModel) -> None:
    models = copies(12, {"tea_box": tea_box})
    frame = picture(models, 12, 3)
    for k, model in enumerate(models.values()):
        T = truth(model, k, 3, 12)
        middle = se3.apply(T, tea_box.mesh.centre[None])
        u, v = np.rint(frame.camera.project(middle)[0]).astype(int)
        assert 0 < u < frame.camera.width
        assert 0 < v < frame.camera.height
        assert abs(frame.depth[v, u] - middle[0, 2]) < tea_box.diameter_m, "the object, not the wall"


def test_halved_edges_split_a_triangle_into_four_on_the_same_surface(tea_box: ReferenceModel) -> None:
    mesh, fine = tea_box.mesh, halved(tea_box.mesh, 2)
    assert len(fine.faces) == 16 * len(mesh.faces)
    (normals, areas), (fine_normals, fine_areas) = mesh.face_normals(), fine.face_normals()
    assert fine_areas.sum() == pytest.approx(areas.sum(), rel=1e-5)
    np.testing.assert_allclose(fine_areas @ fine_normals, areas @ normals, atol=1e-6)
    np.testing.assert_array_equal(fine.bounds, mesh.bounds)
