"""Simple solids with known surfaces, for tests."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Mesh

SIDES = {  # outward axis, and the two axes that span the side so that their cross product points outwards
    "+x": (0, 1.0, 1, 2),
    "-x": (0, -1.0, 2, 1),
    "+y": (1, 1.0, 2, 0),
    "-y": (1, -1.0, 0, 2),
    "+z": (2, 1.0, 0, 1),
    "-z": (2, -1.0, 1, 0),
}


def box(extents: tuple[float, float, float], pictures: dict[str, np.ndarray] | None = None) -> Mesh:
    """A box about its centre; each side shows its image (64, 64, 3), columns along the first spanning axis
    and rows along the second. A side without an image is grey."""
    half = np.array(extents) / 2.0
    size = 64
    vertices, faces, uv = [], [], []
    texture = np.full((size, 6 * size, 3), 128, np.uint8)
    for k, (side, (axis, sign, a, b)) in enumerate(SIDES.items()):
        if pictures and side in pictures:
            texture[:, k * size : (k + 1) * size] = pictures[side]
        for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            corner = np.zeros(3)
            corner[axis], corner[a], corner[b] = sign * half[axis], s * half[a], t * half[b]
            vertices.append(corner)
        for triangle in ((0, 1, 2), (0, 2, 3)):
            faces.append([4 * k + i for i in triangle])
            place = {0: (0, 0), 1: (1, 0), 2: (1, 1), 3: (0, 1)}
            inset = 0.5 / size
            uv.append([((k + np.clip(place[i][0], inset, 1 - inset)) / 6, place[i][1]) for i in triangle])
    return Mesh(np.array(vertices, np.float32), np.array(faces, np.int32), np.array(uv, np.float32), texture)


def printed_box(extents: tuple[float, float, float], seed: int = 0) -> Mesh:
    """A box with random texture on all sides: every texel is used."""
    rng = np.random.default_rng(seed)
    return box(extents, {side: rng.integers(0, 256, (64, 64, 3)).astype(np.uint8) for side in SIDES})


def lathe(profile: list[tuple[float, float]], texture: np.ndarray, segments: int = 64) -> Mesh:
    """The surface of revolution of a profile of (radius, z) from bottom to top, with the texture wrapped
    round it: columns are angles, rows go along the profile. Ends of zero radius close it."""
    angles = 2 * np.pi * np.arange(segments + 1) / segments
    p = np.array(profile)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    along /= along[-1]
    ring = np.stack([np.cos(angles), np.sin(angles)], -1)
    vertices = np.stack(
        [np.concatenate([r * ring, np.full((segments + 1, 1), z)], 1) for r, z in p]
    )  # (P, segments + 1, 3)
    faces, uv = [], []
    for i in range(len(p) - 1):
        for j in range(segments):
            a, b, c, d = (i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)
            for triangle in ((a, b, c), (a, c, d)):
                if len({tuple(np.round(vertices[x], 9)) for x in triangle}) == 3:
                    faces.append([x[0] * (segments + 1) + x[1] for x in triangle])
                    uv.append([(x[1] / segments, along[x[0]]) for x in triangle])
    return Mesh(
        vertices.reshape(-1, 3).astype(np.float32),
        np.array(faces, np.int32),
        np.array(uv, np.float32),
        np.ascontiguousarray(texture, np.uint8),
    )


def sphere(radius: float, texture: np.ndarray | None = None) -> Mesh:
    """A ball about the origin."""
    latitudes = np.linspace(-np.pi / 2, np.pi / 2, 33)
    profile = [(radius * max(np.cos(a), 0.0), radius * np.sin(a)) for a in latitudes]
    profile[0], profile[-1] = (0.0, -radius), (0.0, radius)
    return lathe(profile, plain() if texture is None else texture)


def cylinder(radius: float, height: float, texture: np.ndarray | None = None) -> Mesh:
    """A closed cylinder about z."""
    h = height / 2
    profile = [(0.0, -h), (radius, -h), (radius, -h / 3), (radius, h / 3), (radius, h), (0.0, h)]
    return lathe(profile, plain() if texture is None else texture)


def plain(color: tuple[int, int, int] = (180, 60, 50), size: int = 64) -> np.ndarray:
    """An image of one colour."""
    return np.full((size, size, 3), color, np.uint8)


def joined(*meshes: Mesh) -> Mesh:
    """One mesh of several; all use the texture of the first."""
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + o for m, o in zip(meshes, offsets, strict=False)]).astype(np.int32),
        np.concatenate([m.uv for m in meshes]),
        meshes[0].texture,
    )


def moved(mesh: Mesh, offset: tuple[float, float, float]) -> Mesh:
    """The mesh, translated."""
    return Mesh(mesh.vertices + np.array(offset, np.float32), mesh.faces, mesh.uv, mesh.texture)
