"""The learned rotation between two frames (paper, section III-E): a network over points, run by ONNX Runtime.

The rotation comes first, from canonical features alone. With it every match votes for a translation, and
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
"""Iterations of the weighted mean; each sets the weights of the next."""

Regressor = Callable[[Float32, Float64], Float64]
"""From features (N, 15) and weights (N,) to the rotation (3, 3) from the first canonical frame to the
second."""


def translation_given(
    R_b_a: Float, points_a: Float, points_b: Float, weights: Float, inlier_m: float
) -> Float64:
    """Translation (3,) of a motion with a known rotation, from matched points (N, 3) with weights (N,): first
    the component-wise median, then a mean with Tukey's biweight, which ignores matches with an error over
    `inlier_m` metres. The median if no weight is left."""
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
    """The motion (4, 4) with a known rotation (3, 3); None if too few matches agree with it."""
    t = translation_given(R_b_a, matches.points_a, matches.points_b, matches.weights, INLIER_M)
    T = se3.orthonormalised(se3.make(R_b_a, t))
    miss = np.linalg.norm(se3.apply(T, matches.points_a) - matches.points_b, axis=1)
    return T if (miss < INLIER_M).sum() >= MIN_INLIERS else None


Kind = Literal["residual", "direct"]
POINTS = 128
"""Matches that the network takes as input."""

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of KIND.onnx for each kind; its rotation.json says how they were trained."""


def learned(kind: Kind, file: Path | None = None) -> RelativePose:
    """A RelativePose with a network of a kind: from a file, else the one in the package. Raises InputError
    for a file that is missing or not such a network."""
    regress = OnnxRotation(WEIGHTS / f"{kind}.onnx" if file is None else file)
    return partial(regressed, kind, regress)


def regressed(kind: Kind, regress: Regressor, matches: LiftedMatches) -> Float64 | None:
    """A RelativePose: the rotation by a regressor of a kind, then the translation."""
    given = canonical_input(matches, kind) if len(matches) >= MIN_INLIERS else None
    if given is None:
        return None
    rotation = given.clouds.rotation(regress(given.clouds.features, matches.weights))
    return motion_given(rotation @ given.R_first, matches)


@dataclass(frozen=True, eq=False)
class CanonicalInput:
    """The canonical clouds of the matches, after the first cloud was rotated by R_first (3, 3)."""

    clouds: Canonical
    R_first: Float64


def canonical_input(matches: LiftedMatches, kind: Kind) -> CanonicalInput | None:
    """The matches as input of the network. For "residual" the closed form first moves the first cloud onto
    the second; None if it finds no motion."""
    if kind == "direct":
        return CanonicalInput(canonical(matches.points_a, matches.points_b, matches.weights), np.eye(3))
    T_b_a = robust_kabsch(matches)
    if T_b_a is None:
        return None
    moved = se3.apply(T_b_a, matches.points_a)
    return CanonicalInput(canonical(moved, matches.points_b, matches.weights), T_b_a[:3, :3])


def fixed_count(features: Float32, weights: Float) -> tuple[Float32, Float32]:
    """Exactly POINTS rows of features (N, 15) and weights (N,), heaviest first; if N is smaller, rows are
    repeated."""
    order = np.argsort(-np.asarray(weights), kind="stable")
    rows = order[np.arange(POINTS) % len(order)]
    return features[rows].astype(np.float32), np.asarray(weights)[rows].astype(np.float32)


class OnnxRotation:
    """A Regressor from a file that `huepose train rotation` made; one thread.

    The file takes `features` (1, 128, 15) and `weights` (1, 128) and gives `rotation` (1, 3, 3), all float32.
    Raises InputError for a file that is missing or not such a network.
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
