"""Random household objects: of the requested size, with many shapes, some of them grey."""

import numpy as np
import pytest

from huepose.training.household import household_object, random_palette


@pytest.fixture(scope="module")
def objects():
    rng = np.random.default_rng(3)
    return [household_object(rng, 0.2) for _ in range(24)]


def test_objects_have_the_requested_size_and_are_centred(objects):
    for mesh in objects:
        low, high = mesh.vertices.min(0), mesh.vertices.max(0)
        assert np.linalg.norm(high - low) == pytest.approx(0.2, abs=1e-5)
        assert np.allclose(low + high, 0.0, atol=1e-5)
        assert mesh.faces.max() < len(mesh.vertices)
        assert ((mesh.uv >= 0.0) & (mesh.uv <= 1.0)).all()


def test_objects_have_many_shapes(objects):
    thin = [np.sort(np.ptp(mesh.vertices, axis=0))[0] / 0.2 for mesh in objects]
    assert min(thin) < 0.1
    assert max(thin) > 0.4
    assert len({len(mesh.faces) for mesh in objects}) > 8


def test_some_palettes_are_grey():
    rng = np.random.default_rng(4)
    grey = [len(set(random_palette(rng).base)) == 1 for _ in range(200)]
    assert 0.2 < np.mean(grey) < 0.5
