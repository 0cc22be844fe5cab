"""From how far off does registration find home? Semantic ICP beside ICP on depth and Open3D's ICP.

Rendered scenes with disturbed colours and noisy depth are aligned from starts that are turned or shifted by a
known amount in random directions. A start is won when the mean distance of the surface's points from their
true place (ADD) ends under three hundredths of the diameter: tighter than a right pose needs to be, so that a
small disturbance does not count as won before the start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from huepose.evaluation.metrics import add
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.paper.semantic_icp import ClassifiedScene, SemanticIcpConfig, semantic_icp_many
from huepose.paper.tables import tables_of
from huepose.refine.point_to_plane import align_many
from huepose.support.progress import progress
from studies.color_pairs.triangle_fit import TriangleScene

WON = 0.03
"""Diameters."""

TURNS_DEG = (10.0, 20.0, 30.0, 45.0, 60.0, 80.0)
SHIFTS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
"""Diameters."""

POINTS = 500

Registration = Callable[[TriangleScene, Float64], Float64]
"""Poses (M, 4, 4) from starts (M, 4, 4) on a scene."""


@dataclass(frozen=True)
class Basin:
    """won: share of the starts (0..1) disturbed by `amount` (degrees of `turn`, diameters of `shift`)."""

    method: str
    kind: str
    amount: float
    won: float


def basins(
    scenes: Sequence[TriangleScene], methods: Mapping[str, Registration], starts: int = 4, seed: int = 0
) -> list[Basin]:
    """Share of won starts by method, kind and amount of the disturbance."""
    rows = []
    kinds = [("turn", a) for a in TURNS_DEG] + [("shift", a) for a in SHIFTS]
    for kind, amount in progress(kinds, "disturbances"):
        won: dict[str, list[bool]] = {name: [] for name in methods}
        for index, scene in enumerate(scenes):
            rng = np.random.default_rng([seed, index])
            begun = disturbed_poses(scene, kind, amount, starts, rng)
            for name, method in methods.items():
                won[name] += [_home(scene, T) for T in method(scene, begun)]
        rows += [Basin(name, kind, amount, float(np.mean(w))) for name, w in won.items()]
    return rows


def disturbed_poses(
    scene: TriangleScene, kind: str, amount: float, count: int, rng: np.random.Generator
) -> Float64:
    """Poses (M, 4, 4) turned about the object's centre (degrees) or shifted (diameters) from the true one."""
    out = []
    centre = scene.model.mesh.centre
    for _ in range(count):
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        if kind == "turn":
            R = se3.rotation_exp(np.radians(amount) * way)
            change = se3.make(R, centre - R @ centre)
        else:
            change = se3.make(np.eye(3), amount * scene.model.diameter_m * way)
        out.append(scene.view.T_cam_obj @ change)
    return np.stack(out)


def by_semantics(scene: TriangleScene, starts: Float64) -> Float64:
    """Semantic ICP on the classified cloud."""
    return _semantic(scene, starts, SemanticIcpConfig())


def by_all_classes_as_one(scene: TriangleScene, starts: Float64) -> Float64:
    """The same without classes: what they add."""
    return _semantic(scene, starts, SemanticIcpConfig(semantic=0.0, aggregate=1.0))


def by_depth(scene: TriangleScene, starts: Float64) -> Float64:
    """Robust point-to-plane ICP of depth on the distance grid, as the full method starts with."""
    model = scene.model
    points = depth_points(scene)
    return align_many(model.surface, model.grid, points, starts, 0.2 * model.diameter_m, 0.004, 40)


def by_semantics_then_depth(scene: TriangleScene, starts: Float64) -> Float64:
    """The paper's path: semantic ICP, then ICP on depth."""
    return by_depth(scene, by_semantics(scene, starts))


def by_open3d(scene: TriangleScene, starts: Float64) -> Float64:
    """Open3D's point-to-plane ICP in three steps of ever smaller reach."""
    import open3d as o3d

    model = scene.model
    scene_cloud, model_cloud = o3d.geometry.PointCloud(), o3d.geometry.PointCloud()
    scene_cloud.points = o3d.utility.Vector3dVector(depth_points(scene))
    model_cloud.points = o3d.utility.Vector3dVector(model.surface.points.astype(np.float64)[:4000])
    model_cloud.normals = o3d.utility.Vector3dVector(model.surface.normals.astype(np.float64)[:4000])
    to_plane = o3d.pipelines.registration.TransformationEstimationPointToPlane()
    rounds = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=30)
    out = []
    for start in starts:
        T_obj_cam = se3.inverse(start)
        for reach in (0.2, 0.08, 0.03):
            T_obj_cam = o3d.pipelines.registration.registration_icp(
                scene_cloud, model_cloud, reach * model.diameter_m, T_obj_cam, to_plane, rounds
            ).transformation
        out.append(se3.inverse(np.asarray(T_obj_cam)))
    return np.stack(out)


METHODS: Mapping[str, Registration] = {
    "semantic": by_semantics,
    "semantic, then depth": by_semantics_then_depth,
    "depth": by_depth,
    "Open3D": by_open3d,
    "without classes": by_all_classes_as_one,
}


def depth_points(scene: TriangleScene) -> Float64:
    """About POINTS points (N, 3) of the scene's depth, camera axes."""
    frame = scene.frame
    v, u = np.nonzero(scene.view.mask & (frame.depth > 0))
    step = max(1, len(v) // POINTS)
    pixels = np.stack([u[::step], v[::step]], 1).astype(np.float64)
    return np.asarray(frame.camera.backproject(pixels, frame.depth[v[::step], u[::step]]), np.float64)


def _semantic(scene: TriangleScene, starts: Float64, config: SemanticIcpConfig) -> Float64:
    seen = ClassifiedScene(scene.cloud.points, scene.cloud.classes, scene.cloud.weights)
    return np.stack([a.T_cam_obj for a in semantic_icp_many(tables_of(scene.model), seen, starts, config)])


def _home(scene: TriangleScene, T: Float64) -> bool:
    points = scene.model.eval_points[::20]
    truth = scene.view.T_cam_obj
    errors = [add(points, T, truth @ turn) for turn in scene.model.equivalents]
    return min(errors) < WON * scene.model.diameter_m
