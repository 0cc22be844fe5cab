"""Whether the arrays of a reference model fit together: kernels trust their indices."""

from __future__ import annotations

import numpy as np

from huepose.model.types import ReferenceModel


def check_model(model: ReferenceModel) -> None:
    """Raises ValueError that names what does not fit: a shape, a number that is not finite, an index."""
    mesh, surface, pairs, templates = model.mesh, model.surface, model.pairs, model.templates
    samples, views, cloud = len(surface.points), len(surface.directions), len(pairs.cloud_points)
    shapes: list[tuple[str, np.ndarray, tuple[int | None, ...]]] = [
        ("mesh.vertices", mesh.vertices, (None, 3)),
        ("mesh.faces", mesh.faces, (None, 3)),
        ("mesh.uv", mesh.uv, (len(mesh.faces), 3, 2)),
        ("eval_points", model.eval_points, (None, 3)),
        ("symmetries", model.symmetries, (None, 4, 4)),
        ("turns", model.turns, (None, 4, 4)),
        ("equivalents", model.equivalents, (None, 4, 4)),
        ("surface.points", surface.points, (samples, 3)),
        ("surface.normals", surface.normals, (samples, 3)),
        ("surface.lab", surface.lab, (2, samples, 3)),
        ("surface.directions", surface.directions, (views, 3)),
        ("surface.visible", surface.visible, (None,)),
        ("surface.offsets", surface.offsets, (views + 1,)),
        ("grid.origin", model.grid.origin, (3,)),
        ("grid.nearest", model.grid.nearest, (None, None, None)),
        ("templates.directions", templates.directions, (None, 3)),
        ("templates.planes", templates.planes, (len(templates.directions), None, 5, None, None)),
        ("templates.origins", templates.origins, (len(templates.directions), 3)),
        ("pairs.points", pairs.points, (None, 3)),
        ("pairs.normals", pairs.normals, pairs.points.shape),
        ("pairs.tangents", pairs.tangents, pairs.points.shape),
        ("pairs.colors", pairs.colors, (len(pairs.points), 2, 3)),
        ("pairs.views", pairs.views, (len(pairs.points),)),
        ("pairs.centers", pairs.centers, (None, 3)),
        ("pairs.side_classes", pairs.side_classes, (len(pairs.points), 2)),
        ("pairs.cloud_points", pairs.cloud_points, (cloud, 3)),
        ("pairs.cloud_normals", pairs.cloud_normals, (cloud, 3)),
        ("pairs.cloud_classes", pairs.cloud_classes, (cloud,)),
        ("pairs.cloud_weights", pairs.cloud_weights, (cloud,)),
        ("pairs.triangle_keys", pairs.triangle_keys, (len(pairs.triangles),)),
        ("pairs.triangles", pairs.triangles, (None, 3)),
        ("pairs.ppf_keys", pairs.ppf_keys, (len(pairs.ppf),)),
        ("pairs.ppf", pairs.ppf, (None, 2)),
        ("pairs.ppf_alpha", pairs.ppf_alpha, (len(pairs.ppf),)),
    ]
    for name, array, shape in shapes:
        if array.ndim != len(shape) or any(
            b not in (None, a) for a, b in zip(array.shape, shape, strict=True)
        ):
            raise ValueError(f"{name} has the shape {array.shape}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{name} is not finite")
    indices = [
        ("mesh.faces", mesh.faces, len(mesh.vertices)),
        ("surface.visible", surface.visible, samples),
        ("surface.offsets", surface.offsets, len(surface.visible) + 1),
        ("grid.nearest", model.grid.nearest, samples),
        ("pairs.triangles", pairs.triangles, cloud),
        ("pairs.ppf", pairs.ppf, cloud),
        ("pairs.cloud_classes", pairs.cloud_classes, max(len(pairs.centers), 1)),
        ("pairs.side_classes", pairs.side_classes, max(len(pairs.centers), 1)),
    ]
    for name, array, end in indices:
        if array.size and not (array.min() >= 0 and array.max() < end):
            raise ValueError(f"{name} points at what is not there")
    if (np.diff(surface.offsets) < 0).any():
        raise ValueError("surface.offsets do not grow")
    for name, value in (("diameter_m", model.diameter_m), ("grid_step", model.grid.step)):
        if not (isinstance(value, float | int) and 0.0 < value < float("inf")):
            raise ValueError(f"{name} is {value!r}")
