"""Rigid registration of corresponding points: Kabsch with weights, and a robust version.

Kabsch 1976 (doi 10.1107/S0567739476001873); the robust version is RANSAC over three pairs, followed by
iteratively reweighted least squares with Tukey's biweight.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64

REFINEMENTS = 5
"""Rounds of reweighting after the best triple."""

INLIER_M, MIN_INLIERS, TRIALS = 0.006, 8, 60
"""For `motion`: largest residual of an inlier, metres; fewest inliers; number of triples that are tried."""


def fit(source: Float, target: Float, weights: Float | None = None) -> Float64:
    """Least-squares rigid T_target_source (4, 4) of paired points (N, 3), N >= 3, weights (N,) >= 0.

    Raises ValueError for fewer than three pairs, or if all weights are zero.
    """
    p, q = np.asarray(source, np.float64), np.asarray(target, np.float64)
    w = np.ones(len(p)) if weights is None else np.asarray(weights, np.float64)
    total = float(w.sum())
    if len(p) < 3 or total <= 0:
        raise ValueError(f"a rigid fit needs three weighted pairs; got {len(p)} with total weight {total:g}")
    p0, q0 = w @ p / total, w @ q / total
    U, _, Vt = np.linalg.svd((p - p0).T @ ((q - q0) * w[:, None]))
    sign = np.sign(np.linalg.det(Vt.T @ U.T))
    R = Vt.T @ np.diag([1.0, 1.0, sign]) @ U.T
    return se3.make(R, q0 - R @ p0)


def motion(source: Float, target: Float, weights: Float | None = None) -> Float64 | None:
    """The motion T_target_source (4, 4) of one surface between two frames, from paired points (N, 3) with
    outliers among them; None for fewer than MIN_INLIERS inliers.

    Triples are drawn in proportion to `weights` (N,), from a fixed seed: the same pairs give the same
    motion.
    """
    p, q = np.asarray(source, np.float64), np.asarray(target, np.float64)
    n = len(p)
    w0 = np.ones(n) if weights is None else np.asarray(weights, np.float64)
    if np.count_nonzero(w0) < 3:
        return None
    draws = np.random.default_rng(0).choice(n, (TRIALS, 3), p=w0 / w0.sum())
    R, t = fit_triples(p[draws], q[draws])
    errors = np.linalg.norm(np.einsum("kij,nj->kni", R, p) + t[:, None] - q, axis=2)
    support = (np.maximum(1.0 - (errors / INLIER_M) ** 2, 0.0) * w0).sum(1)
    best = int(np.argmax(support))
    T = se3.make(R[best], t[best])
    w = w0
    for _ in range(REFINEMENTS):
        e = np.linalg.norm(se3.apply(T, p) - q, axis=1)
        w = w0 * np.maximum(1.0 - (e / INLIER_M) ** 2, 0.0) ** 2
        if np.count_nonzero(w) < 3:
            break
        T = fit(p, q, w)
    e = np.linalg.norm(se3.apply(T, p) - q, axis=1)
    return T if (e < INLIER_M).sum() >= MIN_INLIERS else None


def fit_triples(p: Float64, q: Float64) -> tuple[Float64, Float64]:
    """Rigid fits of many triples at once. p, q (K, 3, 3): one point per row; gives R (K, 3, 3), t (K, 3)."""
    p0, q0 = p.mean(1), q.mean(1)
    H = np.einsum("kni,knj->kij", p - p0[:, None], q - q0[:, None])
    U, _, Vt = np.linalg.svd(H)
    V = np.swapaxes(Vt, 1, 2)
    V[:, :, 2] *= np.sign(np.linalg.det(V @ np.swapaxes(U, 1, 2)))[:, None]
    R = V @ np.swapaxes(U, 1, 2)
    return R, q0 - np.einsum("kij,kj->ki", R, p0)
