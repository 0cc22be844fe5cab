"""Baselines from Open3D: features with RANSAC, features with Fast Global Registration, ICP from many starts,
and the same with a choice by colour.

Scene points are registered to the model (a part to the whole), then the transform is inverted. Each method
ends with point-to-plane ICP on the model's surface samples.
"""

from __future__ import annotations

import time
from typing import Any

import cv2
import numpy as np
import open3d as o3d
from rival import Seen
from scipy.spatial import cKDTree

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.icosphere import directions, look_at
from huepose.geometry.suppression import first_different
from huepose.model import ReferenceModel

registration = o3d.pipelines.registration
o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)


def voxel_m(model: ReferenceModel) -> float:
    """Side of the cells in which points are averaged."""
    return float(np.clip(0.035 * model.diameter_m, 0.003, 0.01))


def model_cloud(model: ReferenceModel) -> Any:
    """Surface samples with normals."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(model.surface.points.astype(np.float64)))
    cloud.normals = o3d.utility.Vector3dVector(model.surface.normals.astype(np.float64))
    return cloud


def scene_cloud(seen: Seen, voxel: float) -> Any:
    """Averaged points with normals towards the camera."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(seen.points_cam))
    cloud.colors = o3d.utility.Vector3dVector(seen.colors)
    cloud = cloud.voxel_down_sample(voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2.5 * voxel, max_nn=30))
    cloud.orient_normals_towards_camera_location(np.zeros(3))
    return cloud


def settle(scene: Any, model: Any, T_obj_cam: Float64, gates_m: tuple[float, ...]) -> Any:
    """Point-to-plane ICP with decreasing gates; returns Open3D's last result."""
    result = None
    for gate in gates_m:
        result = registration.registration_icp(
            scene,
            model,
            gate,
            T_obj_cam,
            registration.TransformationEstimationPointToPlane(),
            registration.ICPConvergenceCriteria(max_iteration=30),
        )
        T_obj_cam = result.transformation
    return result


class Features:
    """FPFH features (Rusu et al. 2009) with RANSAC or with Fast Global Registration (Zhou et al. 2016)."""

    def __init__(self, fast: bool) -> None:
        self._fast = fast
        self._models: dict[str, tuple[Any, Any, Any]] = {}

    def prepare(self, model: ReferenceModel) -> None:
        """Features of the model."""
        voxel = voxel_m(model)
        whole = model_cloud(model)
        sparse = whole.voxel_down_sample(voxel)
        self._models[model.name] = whole, sparse, _features(sparse, voxel)

    def pose(self, model: ReferenceModel, seen: Seen) -> tuple[Float64, float, float] | None:
        """Match, register, refine."""
        o3d.utility.random.seed(0)
        start = time.process_time()
        whole, sparse, model_features = self._models[model.name]
        voxel = voxel_m(model)
        scene = scene_cloud(seen, voxel)
        if len(scene.points) < 10:
            return None
        scene_features = _features(scene, voxel)
        if self._fast:
            found = registration.registration_fgr_based_on_feature_matching(
                scene,
                sparse,
                scene_features,
                model_features,
                registration.FastGlobalRegistrationOption(maximum_correspondence_distance=1.5 * voxel),
            )
        else:
            found = registration.registration_ransac_based_on_feature_matching(
                scene,
                sparse,
                scene_features,
                model_features,
                False,
                1.5 * voxel,
                registration.TransformationEstimationPointToPoint(False),
                3,
                [
                    registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                    registration.CorrespondenceCheckerBasedOnDistance(1.5 * voxel),
                ],
                registration.RANSACConvergenceCriteria(100000, 0.999),
            )
        result = settle(scene, whole, found.transformation, (0.02, 0.01))
        T = se3.orthonormalised(np.linalg.inv(result.transformation))
        return T, float(result.fitness), time.process_time() - start


def _features(cloud: Any, voxel: float) -> Any:
    near = o3d.geometry.KDTreeSearchParamHybrid(radius=5.0 * voxel, max_nn=100)
    return registration.compute_fpfh_feature(cloud, near)


FINISHED, FINISHED_BY_COLOR, APART_RAD = 5, 20, 0.35
"""Number of starts that are refined further, the best by fit; by colour: number of the best starts that
differ by this angle."""

NEAR_M, FEWEST = 0.008, 30
"""Scene points up to this distance from the model are compared in colour; fewest points for a correlation."""


class ManyStarts:
    """ICP from 60 rotations, centred on the points; the best five are refined further, the best fit wins.

    by_color: twenty with different rotations are refined further, and the largest sum of fit and colour
    correlation wins. (Coloured ICP after that, Park et al. 2017, made four in a hundred worse.)"""

    def __init__(self, by_color: bool = False) -> None:
        self._by_color = by_color
        self._models: dict[str, Any] = {}
        self._colors: dict[str, tuple[cKDTree, Float64]] = {}
        self._starts = [
            se3.rotation_exp(np.array([0.0, 0.0, 2 * np.pi * k / 5])) @ look_at(d)
            for d in directions(0)
            for k in range(5)
        ]

    def prepare(self, model: ReferenceModel) -> None:
        """The cloud, and its colours averaged over 3.5 mm."""
        self._models[model.name] = model_cloud(model)
        rgb = cv2.cvtColor(model.surface.lab[1][None].astype(np.float32), cv2.COLOR_Lab2RGB)[0]
        self._colors[model.name] = cKDTree(model.surface.points), rgb.astype(np.float64)

    def pose(self, model: ReferenceModel, seen: Seen) -> tuple[Float64, float, float] | None:
        """All starts, then the best of them."""
        begin = time.process_time()
        whole = self._models[model.name]
        scene = scene_cloud(seen, voxel_m(model))
        if len(scene.points) < 10:
            return None
        middle = np.asarray(scene.points).mean(0)
        middle = middle * (1.0 + 0.25 * model.diameter_m / np.linalg.norm(middle))
        tried = []
        for R in self._starts:
            T_cam_obj = se3.make(R, middle - R @ model.mesh.centre)
            result = registration.registration_icp(
                scene,
                whole,
                0.15 * model.diameter_m,
                se3.inverse(T_cam_obj),
                registration.TransformationEstimationPointToPlane(),
                registration.ICPConvergenceCriteria(max_iteration=15),
            )
            tried.append((-result.fitness, result.inlier_rmse, result.transformation))
        tried.sort(key=lambda t: t[:2])
        starts = [T for _, _, T in tried]
        if self._by_color:
            starts = [starts[k] for k in first_different(np.array(starts), APART_RAD, FINISHED_BY_COLOR)]
        else:
            starts = starts[:FINISHED]
        finished = [settle(scene, whole, T, (0.02, 0.008)) for T in starts]
        if self._by_color:
            best = max(finished, key=lambda r: r.fitness + self._correlation(model, scene, r.transformation))
        else:
            best = min(finished, key=lambda r: (-round(r.fitness, 2), r.inlier_rmse))
        T = se3.orthonormalised(np.linalg.inv(best.transformation))
        return T, float(best.fitness), time.process_time() - begin

    def _correlation(self, model: ReferenceModel, scene: Any, T_obj_cam: Float64) -> float:
        """Correlation, -1..1, of the scene's colours and those of the nearest samples."""
        tree, colors = self._colors[model.name]
        points = se3.apply(T_obj_cam, np.asarray(scene.points))
        distance, nearest = tree.query(points, distance_upper_bound=NEAR_M)
        on = np.isfinite(distance)
        if on.sum() < FEWEST:
            return -1.0
        a, b = np.asarray(scene.colors)[on], colors[nearest[on]]
        a, b = a - a.mean(0), b - b.mean(0)
        return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum() + 1e-12))
