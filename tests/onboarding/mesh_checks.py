"""Compare meshes and look up their colours."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Mesh


def colors_at(mesh: Mesh, weights: tuple[float, float, float] = (0.5, 0.3, 0.2)) -> np.ndarray:
    """Colours (F, 3) at a point of each face, bilinear, by the convention of Mesh."""
    uv = np.einsum("k,fkd->fd", np.array(weights), mesh.uv.astype(np.float64))
    height, width = mesh.texture.shape[:2]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]

    def texel(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return mesh.texture[np.clip(j, 0, height - 1), np.clip(i, 0, width - 1)].astype(np.float64)

    top = texel(x0, y0) * (1 - fx) + texel(x0 + 1, y0) * fx
    bottom = texel(x0, y0 + 1) * (1 - fx) + texel(x0 + 1, y0 + 1) * fx
    return top * (1 - fy) + bottom * fy


def assert_same(a: Mesh, b: Mesh) -> None:
    np.testing.assert_allclose(a.vertices[a.faces], b.vertices[b.faces], atol=1e-7)
    np.testing.assert_allclose(a.uv, b.uv, atol=1e-6)
    np.testing.assert_array_equal(a.texture, b.texture)


def assert_well_formed(mesh: Mesh) -> None:
    kinds = [a.dtype.name for a in (mesh.vertices, mesh.faces, mesh.uv, mesh.texture)]
    assert kinds == ["float32", "int32", "float32", "uint8"]
    assert mesh.uv.shape == (len(mesh.faces), 3, 2)
    assert mesh.uv.min() >= 0
    assert mesh.uv.max() <= 1
