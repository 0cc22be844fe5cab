"""The keypoints of a model: features of its rendered views, those that are found again in other views, light
and blur (built once, offline)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Float, Float32, Float64, Int64, UInt8
from huepose.geometry.camera import Camera
from huepose.geometry.mesh import Mesh
from huepose.model.types import Keypoints
from huepose.propose.features import Features, FeatureSource, Sift
from huepose.rendering.render import Rendering, render

LEVEL = 1
"""Of the icosphere: 42 directions, 32 degrees apart. SIFT stands half of that well."""

PIXELS_PER_M = 1100.0
"""Of the views: as 0.55 m before a camera of 600 px focal length, nearer than most frames show an object."""

PICTURE_PX = 640.0
"""An object has to fit into a picture: the diameter of a larger one than 0.58 m is this in its views."""

FARTHEST = 0.5
"""Other pictures have as few as this of the views' pixels a metre."""

OTHERS, OFF_DEG = 3, 15.0
"""Other pictures of each view in which its features are sought, and how far off their directions are."""

FOUND_PX, ALIKE = 2.0, 0.75
"""A feature is found again where one this near looks this much like it, and none elsewhere more."""

SAME_M, SAME_LOOK = 0.003, 0.9
"""Features this near on the object that look this much alike are one."""

MOST = 1500
"""Of an object: 230 kB. With 800 the frames looked at gave a fifth fewer agreeing points."""

LOOKS = 255.0
"""Values of unit descriptors are kept as bytes of this many steps."""

EDGE_PX = 5
"""Features nearer to the outline are of object and background."""


@dataclass(frozen=True, eq=False)
class _View:
    """Features of a picture, with their points (N, 3) and normals (N, 3) in the object's frame."""

    features: Features
    points: Float64
    normals: Float64


def build_keypoints(
    mesh: Mesh, diameter_m: float, source: FeatureSource | None = None, most: int = MOST
) -> Keypoints:
    """The `most` keypoints of a mesh that are found again most often; deterministic."""
    source = source or Sift()
    rng = np.random.default_rng(0)
    nearest = min(PIXELS_PER_M, PICTURE_PX / diameter_m)
    views, found = [], []
    for direction in icosphere.directions(LEVEL):
        view = _view(mesh, *_stand(mesh, diameter_m, direction, nearest), source)
        others = [
            _found_again(mesh, diameter_m, direction, nearest, view, source, rng) for _ in range(OTHERS)
        ]
        views.append(view)
        found.append(np.sum(others, axis=0))
    points = np.concatenate([v.points for v in views])
    normals = np.concatenate([v.normals for v in views])
    looks = np.concatenate([v.features.descriptors for v in views])
    chosen = _chosen(points, looks, np.concatenate(found), most)
    return Keypoints(
        points[chosen].astype(np.float32),
        normals[chosen].astype(np.float32),
        np.rint(looks[chosen] * LOOKS).astype(np.uint8),
        source.name,
    )


def _stand(mesh: Mesh, diameter_m: float, direction: Float, pixels_per_m: float) -> tuple[Float64, Camera]:
    """Pose and camera of a view from a direction, so large where the object is."""
    distance = max(0.6, 2.5 * diameter_m)
    focal = pixels_per_m * distance
    side = int(np.ceil(1.25 * diameter_m * pixels_per_m)) + 24
    R = icosphere.look_at(direction)
    camera = Camera(focal, focal, (side - 1) / 2.0, (side - 1) / 2.0, side, side)
    return se3.make(R, np.array([0.0, 0.0, distance]) - R @ mesh.centre), camera


def _view(mesh: Mesh, T_cam_obj: Float64, camera: Camera, source: FeatureSource) -> _View:
    seen = render([(mesh, T_cam_obj)], camera, points=True, normals=True)
    inner = cv2.erode((seen.depth > 0).astype(np.uint8), np.ones((EDGE_PX, EDGE_PX), np.uint8)) > 0
    features = source.extract(_before(seen, 128), inner)
    u, v = np.clip(np.rint(features.pixels), 0, camera.width - 1).astype(int).T
    normals = seen.normals_cam[v, u].astype(np.float64) @ T_cam_obj[:3, :3]
    return _View(features, seen.points_obj[v, u].astype(np.float64), normals)


def _before(seen: Rendering, background: int) -> UInt8:
    """The picture before a background of this grey."""
    return np.where((seen.depth > 0)[..., None], seen.color, np.uint8(background))


def _found_again(
    mesh: Mesh,
    diameter_m: float,
    direction: Float,
    nearest: float,
    view: _View,
    source: FeatureSource,
    rng: np.random.Generator,
) -> Float64:
    """Which features (N,) of a view are found, 1, or not, 0, in another picture.

    nearest: the most pixels a metre."""
    across = np.cross(direction, rng.normal(size=3))
    turn = se3.rotation_exp(np.radians(OFF_DEG) * across / np.linalg.norm(across))
    pixels_per_m = nearest * rng.uniform(FARTHEST, 1.0)
    T_cam_obj, camera = _stand(mesh, diameter_m, turn @ direction, pixels_per_m)
    roll = se3.rotation_exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
    T_cam_obj = se3.make(roll, np.zeros(3)) @ T_cam_obj
    seen = render([(mesh, T_cam_obj)], camera)
    other = source.extract(_as_taken(_before(seen, int(rng.integers(0, 256))), rng))
    if not len(other):
        return np.zeros(len(view.points))
    at = camera.project(se3.apply(T_cam_obj, view.points))
    near = np.linalg.norm(other.pixels[None] - at[:, None], axis=2) < FOUND_PX
    alike = view.features.descriptors @ other.descriptors.T
    best, elsewhere = np.where(near, alike, 0.0).max(1), np.where(near, 0.0, alike).max(1)
    return np.asarray((best > ALIKE) & (best > elsewhere), np.float64)


def _as_taken(color: UInt8, rng: np.random.Generator) -> UInt8:
    """The picture as some camera might take it: light and its colour, tone curve, blur, noise."""
    light = rng.uniform(0.4, 1.2) * rng.uniform(0.8, 1.2, 3)
    taken = 255.0 * np.clip((color / 255.0) ** rng.uniform(0.7, 1.4) * light, 0.0, 1.0)
    taken = cv2.GaussianBlur(taken, (0, 0), rng.uniform(0.4, 0.9)) + rng.normal(0.0, 4.0, taken.shape)
    return np.clip(np.rint(taken), 0, 255).astype(np.uint8)


def _chosen(points: Float64, looks: Float32, found: Float64, most: int) -> Int64:
    """Features that were found again, most often first, each of them once."""
    chosen: list[int] = []
    for k in np.argsort(-found, kind="stable"):
        if not found[k] or len(chosen) == most:
            break
        near = np.array(chosen, np.int64)[np.linalg.norm(points[chosen] - points[k], axis=1) < SAME_M]
        if not (looks[near] @ looks[k] > SAME_LOOK).any():
            chosen.append(int(k))
    return np.array(chosen, np.int64)
