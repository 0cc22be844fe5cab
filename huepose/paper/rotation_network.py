"""The learned rotation between two frames (paper, section III-E): a network over points, run by ONNX Runtime.

The rotation comes first, from canonical features alone. Given it, every match votes for a translation, and
the robust mean is taken. The network regresses either the whole rotation ("direct") or the residual of the
closed form ("residual"). Training prepares its inputs with the functions of this module.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float32, Float64
from huepose.geometry.kabsch import INLIER_M, MIN_INLIERS
from huepose.paper.canonical import FEATURES, Canonical, canonical
from huepose.paper.relative_pose import LiftedMatches, RelativePose, robust_kabsch
from huepose.support.errors import InputError

ROUNDS = 8
"""Of the weighted mean, each of which sets the weights of the next."""

Regressor = Callable[[Float32, Float64], Float64]
"""Rotation (3, 3) from the first canonical frame to the second, of features (N, 15) and weights (N,)."""


def translation_given(
    R_b_a: Float, points_a: Float, points_b: Float, weights: Float, inlier_m: float
) -> Float64:
    """Translation (3,) of a motion with a known rotation, from matched points (N, 3) with weights (N,): the
    component-wise median first, then a mean with Tukey's biweight, which forgets matches that are off by more
    than `inlier_m` metres. With no weight at all the plain median."""
    votes = np.asarray(points_b, np.float64) - np.asarray(points_a, np.float64) @ np.asarray(R_b_a).T
    t = np.median(votes, axis=0)
    for _ in range(ROUNDS):
        miss = np.linalg.norm(votes - t, axis=1)
        w = weights * np.maximum(1.0 - (miss / inlier_m) ** 2, 0.0) ** 2
        if w.sum() <= 0.0:
            break
        t = w @ votes / w.sum()
    return np.asarray(t)


def motion_given(R_b_a: Float, matches: LiftedMatches) -> Float64 | None:
    """The motion (4, 4) with a known rotation (3, 3); None when too few matches agree with it."""
    t = translation_given(R_b_a, matches.points_a, matches.points_b, matches.weights, INLIER_M)
    T = se3.orthonormalised(se3.make(R_b_a, t))
    miss = np.linalg.norm(se3.apply(T, matches.points_a) - matches.points_b, axis=1)
    return T if (miss < INLIER_M).sum() >= MIN_INLIERS else None


def rotation_first(regress: Regressor, matches: LiftedMatches) -> Float64 | None:
    """A RelativePose by a regressor of the whole rotation."""
    if len(matches) < MIN_INLIERS:
        return None
    seen = canonical(matches.points_a, matches.points_b, matches.weights)
    return motion_given(seen.rotation(regress(seen.features, matches.weights)), matches)


def residual_rotation(regress: Regressor, matches: LiftedMatches) -> Float64 | None:
    """A RelativePose: closed form, then the residual rotation by a regressor, then the translation."""
    question = posed(matches, "residual")
    if question is None:
        return None
    left = question.seen.rotation(regress(question.seen.features, matches.weights))
    return motion_given(left @ question.R_first, matches)


Kind = Literal["residual", "direct"]
POINTS = 128
"""Matches that the network takes as input."""

WEIGHTS = Path(__file__).parent / "weights"
"""KIND.onnx for each kind; rotation.json beside them says how they were made."""


def learned(kind: Kind, file: Path | None = None) -> RelativePose:
    """A RelativePose with a network of a kind: from a file, else the one that is shipped. Raises InputError
    for a file that is missing or not such a network."""
    regress = OnnxRotation(WEIGHTS / f"{kind}.onnx" if file is None else file)
    return partial(residual_rotation if kind == "residual" else rotation_first, regress)


@dataclass(frozen=True, eq=False)
class Posed:
    """Input of the network: features of matches (`seen`), after the first cloud was rotated by R_first (3,
    3)."""

    seen: Canonical
    R_first: Float64


def posed(matches: LiftedMatches, kind: Kind) -> Posed | None:
    """The matches as the network sees them. For "residual" the closed form moves the first cloud onto the
    second before; None where it finds no motion."""
    if kind == "direct":
        return Posed(canonical(matches.points_a, matches.points_b, matches.weights), np.eye(3))
    T_b_a = robust_kabsch(matches)
    if T_b_a is None:
        return None
    moved = se3.apply(T_b_a, matches.points_a)
    return Posed(canonical(moved, matches.points_b, matches.weights), T_b_a[:3, :3])


def fixed_count(features: Float32, weights: Float) -> tuple[Float32, Float32]:
    """Exactly POINTS rows of features (N, 15) and weights (N,), heaviest first; few are repeated."""
    order = np.argsort(-np.asarray(weights), kind="stable")
    rows = order[np.arange(POINTS) % len(order)]
    return features[rows].astype(np.float32), np.asarray(weights)[rows].astype(np.float32)


class OnnxRotation:
    """A Regressor from a file that `huepose train rotation` made; one thread.

    The file takes `features` (1, 128, 15) and `weights` (1, 128) and gives `rotation` (1, 3, 3), all float32.
    Raises InputError for a file that is not there or is something else.
    """

    def __init__(self, file: Path) -> None:
        import onnxruntime as ort

        if not file.is_file():
            raise InputError(f"rotation network {file}", found="no such file", fix="name an existing .onnx")
        options = ort.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 3
        try:
            self._session = ort.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime has no common class for its errors
            raise InputError(
                f"rotation network {file}",
                found=str(error).split("\n")[0],
                expected="a network by `huepose train rotation`",
            ) from error
        shapes = {i.name: list(i.shape) for i in self._session.get_inputs()}
        if shapes != {"features": [1, POINTS, FEATURES], "weights": [1, POINTS]}:
            raise InputError(
                f"rotation network {file}",
                found=f"inputs {shapes}",
                expected=f"features [1, {POINTS}, {FEATURES}] and weights [1, {POINTS}]",
                fix="use a network by `huepose train rotation` of this version",
            )

    def __call__(self, features: Float32, weights: Float64) -> Float64:
        """See Regressor."""
        rows, heavy = fixed_count(features, weights)
        (R,) = self._session.run(["rotation"], {"features": rows[None], "weights": heavy[None]})
        return np.asarray(R[0], np.float64)
