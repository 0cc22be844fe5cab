"""From a mesh to a reference model: everything that estimation and tracking need, computed once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.mesh import Mesh
from huepose.geometry.symmetry import sampled
from huepose.model.io import check_name
from huepose.model.types import PairReference, ReferenceModel
from huepose.onboarding.cloud import visible_cloud
from huepose.onboarding.grid import build_grid
from huepose.onboarding.meshes import Unit, read_mesh
from huepose.onboarding.simplify import simplified
from huepose.onboarding.surface import build_surface
from huepose.onboarding.symmetries import equivalent_turns
from huepose.onboarding.turns import near_symmetries
from huepose.onboarding.visibility import depth_views
from huepose.paper.pair_reference import PairView, build_pair_reference, reference_cameras
from huepose.propose.templates import build_templates
from huepose.rendering.render import render
from huepose.support.errors import InputError

STAGES = ("mesh", "visibility", "surface", "symmetries", "templates", "colour pairs")
EVAL_POINTS = 20_000
_STEP_RAD = np.pi / 36  # of declared continuous symmetries

Report = Callable[[str], None]


def _silent(stage: str) -> None:
    pass


def onboard(
    mesh_path: Path | str,
    name: str,
    *,
    object_id: int | None = None,
    unit: Unit | None = None,
    info: Mapping[str, Any] | None = None,
    symmetric: Mapping[str, Any] | None = None,
    frame_offset_m: Float64 | None = None,
    report: Report = _silent,
) -> ReferenceModel:
    """Reference model of a mesh file; see `read_mesh` for files and units, `onboard_mesh` for the rest."""
    check_name(name)
    report("mesh")
    return onboard_mesh(
        read_mesh(mesh_path, unit),
        name,
        object_id=object_id,
        info=info,
        symmetric=symmetric,
        frame_offset_m=frame_offset_m,
        report=report,
    )


def onboard_mesh(
    mesh: Mesh,
    name: str,
    *,
    object_id: int | None = None,
    info: Mapping[str, Any] | None = None,
    symmetric: Mapping[str, Any] | None = None,
    frame_offset_m: Float64 | None = None,
    report: Report = _silent,
) -> ReferenceModel:
    """Reference model of a mesh.

    info: the object's entry of `models_info.json` (millimetres), for its diameter and the symmetries of its
    shape; symmetric: an entry of the same form whose symmetries hold for shape and print; frame_offset_m
    (3,): takes points of the PoseCNN/YCB-Video frame to the mesh's frame; report: called with each stage's
    name as it begins. Deterministic: the same mesh gives the same model, bit for bit. Meshes of more than
    60,000 triangles are simplified for the model and its pictures; surfels are taken from the full mesh.
    """
    check_name(name)
    diameter = _diameter(mesh, info or {}, name)
    report("visibility")
    lean = simplified(mesh)
    views = depth_views(lean, diameter)
    cloud = visible_cloud(mesh, views)
    report("surface")
    surface = build_surface(cloud, views)
    grid = build_grid(surface.points, diameter)
    report("symmetries")
    near = near_symmetries(surface, grid, diameter)
    if symmetric is None:
        equivalents = equivalent_turns(surface, cloud, near, diameter)
    else:
        equivalents = sampled(symmetric, _STEP_RAD)
    report("templates")
    templates = build_templates(lean, diameter)
    report("colour pairs")
    pairs = _pair_reference(lean, diameter)
    return ReferenceModel(
        name=name,
        object_id=object_id,
        mesh=lean,
        eval_points=np.ascontiguousarray(mesh.vertices[:: -(-len(mesh.vertices) // EVAL_POINTS)]),
        diameter_m=diameter,
        symmetries=sampled(info or symmetric or {}, _STEP_RAD),
        turns=near.turns,
        equivalents=equivalents,
        frame_offset_m=None if frame_offset_m is None else np.asarray(frame_offset_m, np.float64),
        surface=surface,
        grid=grid,
        templates=templates,
        pairs=pairs,
    )


def _diameter(mesh: Mesh, info: Mapping[str, Any], name: str) -> float:
    """The diameter as the data set states it, if that fits the mesh at all, else the mesh's own."""
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
    """The largest distance of two vertices, metres."""
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import pdist

    points = mesh.vertices.astype(np.float64)
    try:
        points = points[ConvexHull(points).vertices]
    except QhullError:
        raise InputError(
            "the mesh", found="all vertices in one plane", expected="a solid object", fix="Give it thickness."
        ) from None
    return float(pdist(points).max())


def _pair_reference(mesh: Mesh, diameter_m: float) -> PairReference:
    centring = se3.make(np.eye(3), -mesh.centre)
    views = []
    for camera, T_cam_centred in reference_cameras(diameter_m):
        T_cam_obj = T_cam_centred @ centring
        r = render([(mesh, T_cam_obj)], camera)
        views.append(PairView(r.color, r.depth, camera, T_cam_obj))
    return build_pair_reference(views, diameter_m)
