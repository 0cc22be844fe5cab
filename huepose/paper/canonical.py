"""Viewpoint-invariant features of matched points (paper, section III-E, second step).

The features of a rotation should not depend on the object's position in the image, its distance or its size.
So each cloud is centred and rotated into a "look-at" frame, whose z axis is the line of sight to its
centroid; both clouds are divided by one length.

The paper takes the centroid of all points. Here points farther away than three median distances (TRIM) are
left out, as in the training of the networks. With all points the paper's tracker has the same errors
(`huepose eval ablation`, `colorpair/direct`: rotation 0.523 instead of 0.522 of the motion, translation 0.460
instead of 0.455).

What the paper leaves open, and what is done here:
- Frame 2 has its own centroid and look-at rotation, so that each cloud looks as if its object were in the
middle of the image. A rotation R in camera axes is then `R2^T R R1` between the canonical frames.
- The paper's up vector [0, -1, 0] gives diag(-1, -1, 1) for an object on the optical axis: a proper rotation,
kept as it is. Where the line of sight is parallel to the up vector, x' is its limit from the image's middle.
- The 15 numbers are p1 (3), p2 (3), uv1 (2), uv2 (2), p2 - p1 (3), uv2 - uv1 (2).
- Projections are those of a camera that looks at the centroid, scaled by its distance d: x / (1 + z / d) for
canonical x and z. Near parts look larger, but an object twice as far and twice as large looks the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64

FEATURES = 15
"""Numbers of each match, as listed above."""

UP = np.array([0.0, -1.0, 0.0])
"""The paper's up vector, in camera axes."""

TRIM = 3.0
"""Points farther from the centroid than this many median distances count as wrong matches: it is computed
without them."""


def look_at(centroid_cam: Float) -> Float64:
    """Rotation R_cam_canon (3, 3) whose columns are x', y', z' of the look-at frame of a point (3,).

    Raises ValueError for a point at the camera's centre.

    >>> look_at(np.array([0.0, 0.0, 2.0])).diagonal().tolist()
    [-1.0, -1.0, 1.0]
    """
    distance = float(np.linalg.norm(centroid_cam))
    if distance < 1e-9:
        raise ValueError("no line of sight to the camera's own centre")
    z = np.asarray(centroid_cam, np.float64) / distance
    x = np.cross(UP, z)
    length = float(np.linalg.norm(x))
    x = x / length if length > 1e-9 else np.array([-1.0, 0.0, 0.0])
    return np.stack([x, np.cross(z, x), z], 1)


def centroid(points: Float, weights: Float | None = None) -> Float64:
    """Weighted centroid (3,) of points (N, 3) without outliers; equivariant to rotation."""
    p = np.asarray(points, np.float64)
    w = np.ones(len(p)) if weights is None else np.asarray(weights, np.float64)
    first = w @ p / w.sum()
    distance = np.linalg.norm(p - first, axis=1)
    kept = w * (distance <= TRIM * max(float(np.median(distance)), 1e-9))
    return np.asarray(kept @ p / kept.sum()) if kept.sum() > 0 else np.asarray(first)


@dataclass(frozen=True, eq=False)
class Canonical:
    """Two matched clouds without their position, distance and size.

    features (N, 15) float32, see above; R_cam_canon_a, R_cam_canon_b (3, 3): from canonical to camera axes;
    size_m: the length by which both clouds were divided.
    """

    features: Float32
    R_cam_canon_a: Float64
    R_cam_canon_b: Float64
    size_m: float

    def rotation(self, R_canon: Float) -> Float64:
        """The rotation R_b_a (3, 3) in camera axes, from the rotation between the canonical frames."""
        return np.asarray(self.R_cam_canon_b @ R_canon @ self.R_cam_canon_a.T)

    def canonical_rotation(self, R_b_a: Float) -> Float64:
        """Inverse of `rotation`: from a rotation in camera axes to the canonical one (3, 3), the regression
        target."""
        return np.asarray(self.R_cam_canon_b.T @ R_b_a @ self.R_cam_canon_a)


def canonical(points_a: Float, points_b: Float, weights: Float | None = None) -> Canonical:
    """Features of matched points (N, 3) of two frames, camera axes, metres; weights (N,) >= 0.

    Raises ValueError with fewer than three matches or with points that all coincide.
    """
    if len(points_a) < 3 or len(points_a) != len(points_b):
        raise ValueError(f"three or more matches are needed; got {len(points_a)} and {len(points_b)} points")
    centre_a, centre_b = centroid(points_a, weights), centroid(points_b, weights)
    R_a, R_b = look_at(centre_a), look_at(centre_b)
    p_a, p_b = (np.asarray(points_a) - centre_a) @ R_a, (np.asarray(points_b) - centre_b) @ R_b
    size_m = float(np.median(np.linalg.norm(np.concatenate([p_a, p_b]), axis=1)))
    if size_m < 1e-9:
        raise ValueError("all points coincide")
    uv_a = _projected(p_a, float(np.linalg.norm(centre_a)))
    uv_b = _projected(p_b, float(np.linalg.norm(centre_b)))
    features = np.concatenate([p_a, p_b, uv_a, uv_b, p_b - p_a, uv_b - uv_a], 1) / size_m
    return Canonical(features.astype(np.float32), R_a, R_b, size_m)


def _projected(points: Float64, distance_m: float) -> Float64:
    """Projections (N, 2) of canonical points (N, 3), scaled to the centroid's distance; metres."""
    return np.asarray(points[:, :2] / np.maximum(1.0 + points[:, 2:] / distance_m, 0.1))
