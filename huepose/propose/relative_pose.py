"""The motion between two frames from 3D correspondences (paper, section III-E, third step), which are pixels
lifted with depth that is never averaged over an occlusion edge.

The paper regresses the rotation with a network. The default here is a robust weighted Kabsch fit, which needs
no training; both implement the protocol `RelativePose`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from huepose.geometry import kabsch
from huepose.geometry.arrays import Bool, Float, Float32, Float64
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.propose.correspondences import Correspondences

EDGE_M = 0.006
EDGE_SHARE = 0.012
"""Four neighbouring readings that differ by more than this and this share of the distance belong to two
surfaces."""


def lift(depth: Float32, camera: Camera, pixels: Float) -> tuple[Float64, Bool]:
    """Points (N, 3), camera axes, of pixels (N, 2) on a depth image (H, W), and which of them are known (N,).

    Depth is bilinear where the four readings belong to one surface. At an edge the reading of the nearest
    pixel counts if a second one of the four confirms it; otherwise, without a reading or outside, it is
    unknown.
    """
    p = np.asarray(pixels, np.float64)
    height, width = depth.shape
    u, v = p[:, 0], p[:, 1]
    inside = np.isfinite(p).all(1) & (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
    x0, y0 = np.minimum(u.astype(int), width - 2), np.minimum(v.astype(int), height - 2)
    a, b = u - x0, v - y0
    corners = np.stack([depth[y0, x0], depth[y0, x0 + 1], depth[y0 + 1, x0], depth[y0 + 1, x0 + 1]], 1)
    corners = np.where(np.isfinite(corners), corners, 0.0).astype(np.float64)
    shares = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], 1)
    nearest = np.take_along_axis(corners, shares.argmax(1)[:, None], 1)[:, 0]
    agree = (corners > 0) & (np.abs(corners - nearest[:, None]) < EDGE_M + EDGE_SHARE * nearest[:, None])
    one_surface = agree.all(1)
    z = np.where(one_surface, (corners * shares).sum(1), nearest)
    known = inside & (nearest > 0) & (agree.sum(1) >= 2)
    # A reading that is kept from its own pixel is a point on that pixel's ray.
    at = np.stack([x0 + (shares.argmax(1) % 2), y0 + shares.argmax(1) // 2], 1)
    points = camera.backproject(np.where(one_surface[:, None], p, at), np.where(known, z, 0.0))
    return np.where(known[:, None], points, 0.0), known


@dataclass(frozen=True, eq=False)
class LiftedMatches:
    """points_a, points_b (N, 3): the same surface points in camera axes at two moments; pixels_a, pixels_b
    (N, 2); weights (N,)."""

    points_a: Float64
    points_b: Float64
    pixels_a: Float64
    pixels_b: Float64
    weights: Float64

    def __len__(self) -> int:
        return len(self.points_a)


@dataclass(frozen=True, eq=False)
class Motion:
    """T_b_a (4, 4): moves points of the first moment to the second, both in camera axes; inliers of
    `matches`."""

    T_b_a: Float64
    inliers: int
    matches: int


class RelativePose(Protocol):
    """Estimates a rigid motion from 3D correspondences."""

    def estimate(self, matches: LiftedMatches) -> Motion | None:
        """The motion, or None when the matches do not determine one."""
        ...


@dataclass(frozen=True)
class RobustKabsch:
    """RANSAC over triples, then reweighted least squares. inlier_m: residual of a believed match, metres;
    min_inliers under which there is no motion."""

    inlier_m: float = 0.006
    min_inliers: int = 8
    trials: int = 60

    def estimate(self, matches: LiftedMatches) -> Motion | None:
        """See RelativePose; the same matches give the same motion."""
        if len(matches) < self.min_inliers:
            return None
        T, inliers, _ = kabsch.robust_fit(
            matches.points_a,
            matches.points_b,
            matches.weights,
            inlier_m=self.inlier_m,
            rng=np.random.default_rng(0),
            trials=self.trials,
        )
        count = int(inliers.sum())
        return Motion(T, count, len(matches)) if count >= self.min_inliers else None


def lift_matches(frame_a: RgbdFrame, frame_b: RgbdFrame, matches: Correspondences) -> LiftedMatches:
    """Both ends of the matches in 3D; those without depth at either end are dropped."""
    a, known_a = lift(frame_a.depth, frame_a.camera, matches.pixels_a)
    b, known_b = lift(frame_b.depth, frame_b.camera, matches.pixels_b)
    k = known_a & known_b
    return LiftedMatches(a[k], b[k], matches.pixels_a[k], matches.pixels_b[k], matches.weights[k])
