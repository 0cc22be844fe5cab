"""Tracking baselines: each starts from a given pose and uses only its last one or two poses.

Careful ICP: projective point-to-plane on the visible model surface, which is found again in every iteration,
Tukey weights, a gate on distance and normals, damping; with or without constant velocity. Colour ICP:
Open3D's (Park et al. 2017). Flow: DIS flow filtered by colour pairs, Kabsch, no refinement.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import open3d as o3d

from huepose.believe.state import State
from huepose.geometry import Box, RgbdFrame, se3
from huepose.geometry.arrays import Float64, Int32
from huepose.model import ReferenceModel
from huepose.model.types import Surface
from huepose.paper.correspondences import match
from huepose.paper.relative_pose import lift_matches, robust_kabsch
from huepose.propose import flow as optical_flow
from huepose.rendering import render_depth
from huepose.tracking.types import Applied, Correction, TrackedPose

Step = Callable[[ReferenceModel, Float64, RgbdFrame | None, RgbdFrame], Float64]


@dataclass(eq=False)
class LastPoseTracker:
    """A tracker made of one step function: (model, start pose, frame before, frame) to a pose. It never
    reports that it is lost. constant_velocity: the start is the last pose, moved by the last motion."""

    models: Mapping[str, ReferenceModel]
    advance: Step
    constant_velocity: bool = False
    _poses: dict[tuple[str, int], list[Float64]] = field(default_factory=dict)
    _fresh: set[tuple[str, int]] = field(default_factory=set)
    _before: RgbdFrame | None = None

    def correct(self, correction: Correction) -> Applied:
        """Use this pose for the next frame."""
        key = (correction.object, correction.instance)
        self._poses[key] = [correction.T_cam_obj]
        self._fresh.add(key)
        return Applied.APPLIED

    def step(self, frame: RgbdFrame) -> Sequence[TrackedPose]:
        """The poses of all objects in one frame."""
        for key, poses in self._poses.items():
            if key in self._fresh:
                continue
            start = poses[-1]
            if self.constant_velocity and len(poses) > 1:
                start = poses[-1] @ se3.inverse(poses[-2]) @ poses[-1]
            T = self.advance(self.models[key[0]], start, self._before, frame)
            self._poses[key] = [poses[-1], T if np.isfinite(T).all() else poses[-1]]
        self._fresh.clear()
        self._before = frame
        return [
            TrackedPose(
                name, instance, frame.epoch, frame.frame_id, frame.stamp_ns, State.TRACKING,
                se3.orthonormalised(poses[-1]), None, 1.0, None, 0,
            )
            for (name, instance), poses in self._poses.items()
        ]  # fmt: skip


def shown(surface: Surface, T: Float64) -> Int32:
    """The samples that are visible in the model's view nearest to a pose."""
    towards = -(T[:3, :3].T @ T[:3, 3])
    view = int(np.argmax(surface.directions @ (towards / np.linalg.norm(towards))))
    return surface.visible[surface.offsets[view] : surface.offsets[view + 1]]


def careful_icp(model: ReferenceModel, T: Float64, before: RgbdFrame | None, frame: RgbdFrame) -> Float64:
    """15 damped Gauss-Newton steps with a gate from 3 cm down to 6 mm."""
    camera, surface = frame.camera, model.surface
    for gate in np.geomspace(0.03, 0.006, 15):
        seen = shown(surface, T)[:800]
        points = se3.apply(T, surface.points[seen].astype(np.float64))
        normals = surface.normals[seen].astype(np.float64) @ T[:3, :3].T
        pixels = camera.project(points)
        inside = np.isfinite(pixels).all(1)
        columns, rows = np.rint(np.where(inside[:, None], pixels, 0)).astype(int).T
        inside &= (columns >= 1) & (rows >= 1) & (columns < camera.width - 1) & (rows < camera.height - 1)
        columns, rows = columns[inside], rows[inside]
        points, normals = points[inside], normals[inside]
        depth = frame.depth[rows, columns].astype(np.float64)
        found = camera.backproject(np.stack([columns, rows], -1).astype(np.float64), depth)
        residual = ((found - points) * normals).sum(1)
        good = (depth > 0) & (np.abs(residual) < gate) & (np.linalg.norm(found - points, axis=1) < 3 * gate)
        good &= _normals(frame, rows, columns, normals) > 0.7
        if good.sum() < 20:
            continue
        r, n, p = residual[good], normals[good], points[good]
        weight = (1.0 - (r / gate) ** 2) ** 2
        jacobian = np.concatenate([n, np.cross(p - T[:3, 3], n)], axis=1)
        information = (jacobian * weight[:, None]).T @ jacobian
        damping = 1e-3 * np.trace(information[:3, :3]) * np.diag([1, 1, 1, *[model.diameter_m**2 / 8] * 3])
        x = np.linalg.solve(information + damping, (jacobian * weight[:, None]).T @ r)
        T = se3.make(se3.rotation_exp(x[3:]) @ T[:3, :3], T[:3, 3] + x[:3])
    return T


def _normals(frame: RgbdFrame, rows: Any, columns: Any, expected: Float64) -> Float64:
    """Cosine (N,) between expected normals and those of the depth image; 1 without a normal from depth."""

    def point(dr: int, dc: int) -> tuple[Float64, Any]:
        z = frame.depth[rows + dr, columns + dc].astype(np.float64)
        return frame.camera.backproject(np.stack([columns + dc, rows + dr], -1).astype(np.float64), z), z > 0

    (right, a), (left, b), (down, c), (up, d) = point(0, 1), point(0, -1), point(1, 0), point(-1, 0)
    normal = np.cross(down - up, right - left)
    length = np.linalg.norm(normal, axis=1)
    cos = np.abs((normal * expected).sum(1)) / np.maximum(length, 1e-12)
    return np.where(a & b & c & d & (length > 0), cos, 1.0)


def color_icp(model: ReferenceModel, T: Float64, before: RgbdFrame | None, frame: RgbdFrame) -> Float64:
    """Open3D's coloured ICP from the visible surface of the model to the points near it."""
    surface = model.surface
    seen = shown(surface, T)
    rgb = cv2.cvtColor(surface.lab[0, seen][None].astype(np.float32), cv2.COLOR_Lab2RGB)[0]
    pixels = frame.camera.project(se3.apply(T, surface.points[seen].astype(np.float64)))
    # Light: scale the texture's colours to the brightness and tint of the pixels at the pose.
    inside = np.isfinite(pixels).all(1)
    if not inside.any():
        return T
    size = [frame.camera.width - 1, frame.camera.height - 1]
    columns, rows = np.clip(np.rint(pixels[inside]), 0, size).astype(int).T
    light = np.median(frame.color[rows, columns] / 255.0, 0) / np.maximum(np.median(rgb[inside], 0), 0.02)
    source = _cloud(surface.points[seen], np.clip(rgb * light, 0, 1))
    source.normals = o3d.utility.Vector3dVector(surface.normals[seen].astype(np.float64))
    box = Box.of_pixels(pixels[inside]).grown(0.25, 5.0)
    rows, columns = box.slices(frame.camera.width, frame.camera.height)
    depth = frame.depth[rows, columns]
    v, u = np.nonzero((depth > 0) & (np.abs(depth - T[2, 3]) < 0.7 * model.diameter_m))
    if len(v) < 50:
        return T
    at = np.stack([u + columns.start, v + rows.start], -1).astype(np.float64)
    points = frame.camera.backproject(at, depth[v, u].astype(np.float64))
    target = _cloud(points, frame.color[rows, columns][v, u] / 255.0).voxel_down_sample(0.002)
    target.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=0.008, max_nn=30))
    target.orient_normals_towards_camera_location(np.zeros(3))
    registration = o3d.pipelines.registration
    by_color = registration.TransformationEstimationForColoredICP(lambda_geometric=0.968)
    limits = registration.ICPConvergenceCriteria(max_iteration=20)
    for gate_m in (0.04, 0.02, 0.008):
        with suppress(RuntimeError):  # no correspondence within the gate
            found = registration.registration_colored_icp(source, target, gate_m, T, by_color, limits)
            T = np.asarray(found.transformation)
    return T


def _cloud(points: Any, colors: Any) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.asarray(points, np.float64)))
    cloud.colors = o3d.utility.Vector3dVector(np.asarray(colors, np.float64))
    return cloud


def flow_pairs(model: ReferenceModel, T: Float64, before: RgbdFrame | None, frame: RgbdFrame) -> Float64:
    """The last pose moved by the motion of colour pairs, from flow."""
    if before is None:
        return T
    mask = render_depth(model.mesh, T, before.camera) > 0
    box = Box.of_mask(mask)
    if box is None:
        return T
    flow = optical_flow.compute(before.color, frame.color, box.grown(0.35, 8.0))
    if flow is None:
        return T
    matches = match(before.color, frame.color, mask, flow)
    motion = robust_kabsch(lift_matches(before, frame, matches))
    return T if motion is None else motion @ T
