"""Makes the reference model of a mesh: all data that estimation and tracking need, computed once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.diameter import largest_distance
from huepose.geometry.mesh import Mesh
from huepose.geometry.symmetry import sampled
from huepose.model.io import check_name
from huepose.model.types import PaperTables, ReferenceModel
from huepose.onboarding.cloud import visible_cloud
from huepose.onboarding.near_symmetries import near_symmetries
from huepose.onboarding.pairs import MergedPairs, coarse_and_fine, pair_reference
from huepose.onboarding.surface import build_grid, build_surface
from huepose.onboarding.symmetries import equivalent_rotations, rotations_about_own
from huepose.onboarding.visibility import depth_views
from huepose.propose.keypoint_reference import build_keypoints
from huepose.propose.templates import build_templates
from huepose.support.errors import InputError

STAGES = ("mesh", "visibility", "surface", "symmetries", "templates", "keypoints", "colour pairs")
EVAL_POINTS = 20_000
"""Most vertices over which pose errors are measured."""

_STEP_RAD = np.pi / 36  # between samples of a declared continuous symmetry

Report = Callable[[str], None]


def silent(stage: str) -> None:
    """A report that does nothing."""


def reference_model(
    mesh: Mesh,
    name: str,
    *,
    lean: Mesh | None = None,
    object_id: int | None = None,
    info: Mapping[str, Any] | None = None,
    symmetric: Mapping[str, Any] | str | None = None,
    frame_offset_m: Float64 | None = None,
    paper: bool = False,
    report: Report = silent,
) -> ReferenceModel:
    """Reference model of a mesh.

    lean: the simplified mesh, for the model and its rendered views (surfels are taken from the full mesh);
    by default the mesh itself. info: the object's entry of `models_info.json` (millimetres), for its
    diameter and the symmetries of its shape; symmetric: an entry of the same form whose symmetries hold for
    shape and texture, or "x", "y" or "z": all rotations about that axis that the shape allows count as the
    same; frame_offset_m (3,): transforms points of the PoseCNN/YCB-Video frame to the mesh's frame; paper:
    whether the model also gets the tables of the paper's method; report: called with each stage's name when
    it begins. Deterministic: one mesh gives one model, bit for bit.
    """
    check_name(name)
    diameter = _diameter(mesh, info or {}, name)
    report("visibility")
    lean = mesh if lean is None else lean
    views = depth_views(lean, diameter)
    cloud = visible_cloud(mesh, views)
    report("surface")
    surface = build_surface(cloud, views)
    grid = build_grid(surface.points, diameter)
    report("symmetries")
    near = near_symmetries(surface, grid, diameter)
    if symmetric is None:
        equivalents = equivalent_rotations(surface, cloud, near, diameter)
    elif isinstance(symmetric, str):
        equivalents = rotations_about_own(surface, near, diameter, symmetric)
    else:
        equivalents = sampled(symmetric, _STEP_RAD)
    declared = info or symmetric or {}
    report("templates")
    templates = build_templates(lean, diameter)
    report("keypoints")
    keypoints = build_keypoints(lean, diameter)
    report("colour pairs")
    coarse, fine = coarse_and_fine(lean, diameter)
    return ReferenceModel(
        name=name,
        object_id=object_id,
        mesh=lean,
        eval_points=np.ascontiguousarray(mesh.vertices[:: -(-len(mesh.vertices) // EVAL_POINTS)]),
        diameter_m=diameter,
        symmetries=equivalents if isinstance(declared, str) else sampled(declared, _STEP_RAD),
        near_symmetries=near.transforms,
        equivalents=equivalents,
        frame_offset_m=None if frame_offset_m is None else np.asarray(frame_offset_m, np.float64),
        surface=surface,
        grid=grid,
        templates=templates,
        pairs=pair_reference(coarse, fine, diameter),
        keypoints=keypoints,
        tables=_tables(coarse, diameter) if paper else None,
    )


def _diameter(mesh: Mesh, info: Mapping[str, Any], name: str) -> float:
    """The diameter that the data set states, or that of the mesh if it states none. Raises InputError if
    the two differ by more than 10 %."""
    own = diameter_of(mesh)
    if "diameter" not in info:
        return own
    stated = float(info["diameter"]) / 1000.0
    if not 0.9 < stated / own < 1.1:
        raise InputError(
            name,
            found=f"diameters of {stated * 100:.4g} cm (models_info.json) and {own * 100:.4g} cm (mesh)",
            expected="the same",
            fix="Are both in millimetres, and of the same object?",
        )
    return stated


def diameter_of(mesh: Mesh) -> float:
    """The largest distance between two vertices, metres."""
    from scipy.spatial import ConvexHull, QhullError

    points = mesh.vertices.astype(np.float64)
    try:
        return largest_distance(points[ConvexHull(points).vertices])
    except QhullError:
        raise InputError(
            "the mesh", found="all vertices in one plane", expected="a solid object", fix="Give it thickness."
        ) from None


def _tables(coarse: MergedPairs, diameter_m: float) -> PaperTables:
    from huepose.paper.tables import build_tables  # imported here because only this function needs `paper`

    return build_tables(coarse.pairs, coarse.seen, diameter_m)
