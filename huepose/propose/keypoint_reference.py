"""Select a model's keypoints: the features of its rendered views that are detected again most often in other
views, with other light, scale and blur. Built once, offline."""

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
"""Subdivision level of the icosphere of view directions: 42, 32 degrees apart. SIFT tolerates half of
that."""

PIXELS_PER_M = 1100.0
"""Resolution of the views, pixels per metre at the object: that of 0.55 m distance and a focal length of
600 px, which is nearer than in most frames."""

PICTURE_PX = 640.0
"""Largest diameter in a view, pixels: the resolution is lower for objects of more than 0.58 m."""

MIN_SCALE = 0.5
"""Test views have a resolution of this to 1 times that of the view."""

TEST_VIEWS, TEST_OFF_DEG = 3, 15.0
"""Test views rendered for each view, and the angle between their directions and the view's, degrees."""

REFOUND_PX, MIN_SIMILARITY = 2.0, 0.75
"""A feature is detected again if another one within this many pixels has at least this descriptor product
with it, and none elsewhere has more."""

DUPLICATE_M, DUPLICATE_SIMILARITY = 0.003, 0.9
"""Features this near on the object (metres) with at least this descriptor product are duplicates."""

MAX_KEYPOINTS = 1500
"""Most keypoints kept for an object: 230 kB. With 800, the frames tried gave a fifth fewer inliers."""

DESCRIPTOR_STEPS = 255.0
"""Descriptor values 0..1 are stored as bytes in this many steps."""

EDGE_PX = 5
"""Width of the kernel that erodes the mask: features at the outline would describe the background, too."""


@dataclass(frozen=True, eq=False)
class _View:
    """Features of a rendered view, with their points (N, 3, metres) and normals (N, 3) in the object's
    frame."""

    features: Features
    points: Float64
    normals: Float64


def build_keypoints(
    mesh: Mesh, diameter_m: float, source: FeatureSource | None = None, count: int = MAX_KEYPOINTS
) -> Keypoints:
    """The `count` keypoints of a mesh that are detected again most often, or fewer if there are not as
    many; deterministic. source: feature detector, default SIFT."""
    source = source or Sift()
    rng = np.random.default_rng(0)
    max_pixels_per_m = min(PIXELS_PER_M, PICTURE_PX / diameter_m)
    views, refound = [], []
    for direction in icosphere.directions(LEVEL):
        view = _view(mesh, *_view_camera(mesh, diameter_m, direction, max_pixels_per_m), source)
        others = [
            _refound(mesh, diameter_m, direction, max_pixels_per_m, view, source, rng)
            for _ in range(TEST_VIEWS)
        ]
        views.append(view)
        refound.append(np.sum(others, axis=0))
    points = np.concatenate([v.points for v in views])
    normals = np.concatenate([v.normals for v in views])
    descriptors = np.concatenate([v.features.descriptors for v in views])
    chosen = _selected(points, descriptors, np.concatenate(refound), count)
    return Keypoints(
        points[chosen].astype(np.float32),
        normals[chosen].astype(np.float32),
        np.rint(descriptors[chosen] * DESCRIPTOR_STEPS).astype(np.uint8),
        source.name,
    )


def _view_camera(
    mesh: Mesh, diameter_m: float, direction: Float, pixels_per_m: float
) -> tuple[Float64, Camera]:
    """T_cam_obj (4, 4) and camera of a view from a direction (3,), at this resolution at the object."""
    distance = max(0.6, 2.5 * diameter_m)
    focal = pixels_per_m * distance
    side = int(np.ceil(1.25 * diameter_m * pixels_per_m)) + 24
    R = icosphere.look_at(direction)
    camera = Camera(focal, focal, (side - 1) / 2.0, (side - 1) / 2.0, side, side)
    return se3.make(R, np.array([0.0, 0.0, distance]) - R @ mesh.centre), camera


def _view(mesh: Mesh, T_cam_obj: Float64, camera: Camera, source: FeatureSource) -> _View:
    rendering = render([(mesh, T_cam_obj)], camera)
    inner = cv2.erode((rendering.depth > 0).astype(np.uint8), np.ones((EDGE_PX, EDGE_PX), np.uint8)) > 0
    features = source.extract(_on_background(rendering, 128), inner)
    u, v = np.clip(np.rint(features.pixels), 0, camera.width - 1).astype(int).T
    normals = rendering.normals_at(v, u).astype(np.float64) @ T_cam_obj[:3, :3]
    return _View(features, rendering.points_at(v, u).astype(np.float64), normals)


def _on_background(rendering: Rendering, background: int) -> UInt8:
    """The rendered colours (H, W, 3) on a uniform background of this grey level."""
    return np.where((rendering.depth > 0)[..., None], rendering.color, np.uint8(background))


def _refound(
    mesh: Mesh,
    diameter_m: float,
    direction: Float,
    max_pixels_per_m: float,
    view: _View,
    source: FeatureSource,
    rng: np.random.Generator,
) -> Float64:
    """Which features (N,) of a view are detected again (1) or not (0) in one random test view.

    max_pixels_per_m: the resolution of the view itself."""
    across = np.cross(direction, rng.normal(size=3))
    rotation = se3.rotation_exp(np.radians(TEST_OFF_DEG) * across / np.linalg.norm(across))
    pixels_per_m = max_pixels_per_m * rng.uniform(MIN_SCALE, 1.0)
    T_cam_obj, camera = _view_camera(mesh, diameter_m, rotation @ direction, pixels_per_m)
    roll = se3.rotation_exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
    T_cam_obj = se3.make(roll, np.zeros(3)) @ T_cam_obj
    rendering = render([(mesh, T_cam_obj)], camera)
    other = source.extract(_augmented(_on_background(rendering, int(rng.integers(0, 256))), rng))
    if not len(other):
        return np.zeros(len(view.points))
    at = camera.project(se3.apply(T_cam_obj, view.points))
    near = np.linalg.norm(other.pixels[None] - at[:, None], axis=2) < REFOUND_PX
    similarity = view.features.descriptors @ other.descriptors.T
    best, elsewhere = np.where(near, similarity, 0.0).max(1), np.where(near, 0.0, similarity).max(1)
    return np.asarray((best > MIN_SIMILARITY) & (best > elsewhere), np.float64)


def _augmented(color: UInt8, rng: np.random.Generator) -> UInt8:
    """The image (H, W, 3) with random brightness, tint, tone curve, blur and noise."""
    light = rng.uniform(0.4, 1.2) * rng.uniform(0.8, 1.2, 3)
    tones = (np.arange(256)[:, None] / 255.0) ** rng.uniform(0.7, 1.4) * light
    taken = cv2.LUT(color, 255.0 * np.clip(tones, 0.0, 1.0)[None])
    taken = cv2.GaussianBlur(taken, (0, 0), rng.uniform(0.4, 0.9)) + rng.normal(0.0, 4.0, taken.shape)
    return np.asarray(np.clip(np.rint(taken), 0, 255), np.uint8)


def _selected(points: Float64, descriptors: Float32, refound: Float64, count: int) -> Int64:
    """Indices of at most `count` features that were detected again, the most often first, without
    duplicates."""
    chosen = np.empty(0, np.int64)
    for k in np.argsort(-refound, kind="stable"):
        if not refound[k] or len(chosen) == count:
            break
        near = chosen[np.linalg.norm(points[chosen] - points[k], axis=1) < DUPLICATE_M]
        if not (descriptors[near] @ descriptors[k] > DUPLICATE_SIMILARITY).any():
            chosen = np.append(chosen, k)
    return chosen
