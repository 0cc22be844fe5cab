"""How well a classified scene lies on a model's classified cloud at a pose: what semantic ICP makes better.

The paper names the two kinds of correspondences (III-D), of one class and of all together, and a robust
kernel for each pair of points. At a pose, the weight that they have is between 0, where no point has a
partner, and 1, where every point lies on one of its own class.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from huepose.geometry.arrays import Float64
from huepose.model.types import PaperTables
from huepose.paper.semantic_icp import ClassifiedScene, SemanticIcpConfig

GATE = 0.06
"""Distance from which two points are no correspondence, in diameters of the model's cloud: the third of the
ICP's four gates, which bears the noise of depth. Not fitted."""


def fitness_of(
    tables: PaperTables, scene: ClassifiedScene, poses: Float64, config: SemanticIcpConfig | None = None
) -> Float64:
    """Share (M,) of the scene's weight that has a partner at poses T_cam_obj (M, 4, 4), each point by Tukey's
    biweight of its distance: to the nearest model point of its class and to the nearest of any, weighed as in
    the ICP. 0 without points."""
    config = config or SemanticIcpConfig()
    model = np.asarray(tables.cloud_points, np.float64)
    weights = np.asarray(scene.weights, np.float64)
    if not len(model) or weights.sum() <= 0.0:
        return np.zeros(len(poses))
    centre = 0.5 * (model.min(0) + model.max(0))
    gate_m = GATE * 2.0 * float(np.linalg.norm(model - centre, axis=1).max())
    R, t = poses[:, :3, :3], poses[:, :3, 3]
    points = (np.asarray(scene.points_cam, np.float64)[None] - t[:, None]) @ R  # object axes (M, N, 3)
    total = config.aggregate * _kernel(cKDTree(model), points, gate_m)
    for kind in np.unique(scene.classes):
        same, of_kind = tables.cloud_classes == kind, scene.classes == kind
        if same.any():
            total[:, of_kind] += config.semantic * _kernel(cKDTree(model[same]), points[:, of_kind], gate_m)
    return np.asarray(total @ weights / (weights.sum() * (config.semantic + config.aggregate)))


def _kernel(tree: cKDTree, points: Float64, gate_m: float) -> Float64:
    """Tukey's biweight (M, N) of the distances of points (M, N, 3) to their nearest ones."""
    distance, _ = tree.query(points.reshape(-1, 3), distance_upper_bound=gate_m)
    weight = np.maximum(1.0 - (np.minimum(distance, gate_m) / gate_m) ** 2, 0.0) ** 2
    return np.asarray(weight.reshape(points.shape[:2]))
