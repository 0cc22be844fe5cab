"""Checks that the arrays of a reference model fit together, because kernels trust their indices."""

from __future__ import annotations

import numpy as np

from huepose.model.types import PaperTables, ReferenceModel

Shaped = tuple[str, np.ndarray, tuple[int | None, ...]]
Indices = tuple[str, np.ndarray, int]


def check_model(model: ReferenceModel) -> None:
    """Raises ValueError with the name of what does not fit: a shape, a number that is not finite, an
    index."""
    mesh, surface, pairs, templates = model.mesh, model.surface, model.pairs, model.templates
    keypoints = model.keypoints
    samples, views = len(surface.points), len(surface.directions)
    shapes: list[Shaped] = [
        ("mesh.vertices", mesh.vertices, (None, 3)),
        ("mesh.faces", mesh.faces, (None, 3)),
        ("mesh.uv", mesh.uv, (len(mesh.faces), 3, 2)),
        ("eval_points", model.eval_points, (None, 3)),
        ("symmetries", model.symmetries, (None, 4, 4)),
        ("turns", model.near_symmetries, (None, 4, 4)),
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
        ("keypoints.points", keypoints.points, (None, 3)),
        ("keypoints.normals", keypoints.normals, keypoints.points.shape),
        ("keypoints.descriptors", keypoints.descriptors, (len(keypoints.points), None)),
    ]
    indices: list[Indices] = [
        ("mesh.faces", mesh.faces, len(mesh.vertices)),
        ("surface.visible", surface.visible, samples),
        ("surface.offsets", surface.offsets, len(surface.visible) + 1),
        ("grid.nearest", model.grid.nearest, samples),
    ]
    if model.tables is not None:
        _add_tables(model.tables, shapes, indices)
    for name, array, shape in shapes:
        if array.ndim != len(shape) or any(
            b not in (None, a) for a, b in zip(array.shape, shape, strict=True)
        ):
            raise ValueError(f"{name} has the shape {array.shape}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{name} is not finite")
    for name, array, end in indices:
        if array.size and not (array.min() >= 0 and array.max() < end):
            raise ValueError(f"{name} has an index out of range")
    if (np.diff(surface.offsets) < 0).any():
        raise ValueError("surface.offsets decrease")
    for name, value in (("diameter_m", model.diameter_m), ("grid_step", model.grid.step)):
        if not (isinstance(value, float | int) and 0.0 < value < float("inf")):
            raise ValueError(f"{name} is {value!r}")


def _add_tables(tables: PaperTables, shapes: list[Shaped], indices: list[Indices]) -> None:
    cloud, classes = len(tables.cloud_points), max(len(tables.centers), 1)
    shapes += [
        ("tables.centers", tables.centers, (None, 3)),
        ("tables.side_classes", tables.side_classes, (None, 2)),
        ("tables.cloud_points", tables.cloud_points, (cloud, 3)),
        ("tables.cloud_normals", tables.cloud_normals, (cloud, 3)),
        ("tables.cloud_classes", tables.cloud_classes, (cloud,)),
        ("tables.cloud_weights", tables.cloud_weights, (cloud,)),
        ("tables.triangle_keys", tables.triangle_keys, (len(tables.triangles),)),
        ("tables.triangles", tables.triangles, (None, 3)),
        ("tables.ppf_keys", tables.ppf_keys, (len(tables.ppf),)),
        ("tables.ppf", tables.ppf, (None, 2)),
        ("tables.ppf_alpha", tables.ppf_alpha, (len(tables.ppf),)),
    ]
    indices += [
        ("tables.triangles", tables.triangles, cloud),
        ("tables.ppf", tables.ppf, cloud),
        ("tables.cloud_classes", tables.cloud_classes, classes),
        ("tables.side_classes", tables.side_classes, classes),
    ]
