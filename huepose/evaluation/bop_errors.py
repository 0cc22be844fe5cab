"""The pose errors of the BOP challenge, and its average recall. Pure functions; errors in metres and pixels.

Hodan et al., *BOP Challenge 2020 on 6D Object Localization*; thresholds as in bop_toolkit's
`scripts/eval_bop19_pose.py`. A missing pose is wrong at every threshold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from huepose.geometry import Camera, Mesh, se3, symmetry
from huepose.geometry.arrays import Float, Float32, Float64
from huepose.rendering import render_depth

VSD_DELTA_M = 0.015
"""Tolerance of the visibility masks on YCB-V."""

FRACTIONS = np.arange(0.05, 0.51, 0.05)
"""Misalignment tolerances of VSD and thresholds of MSSD, as shares of the diameter; thresholds of VSD."""

PIXELS = np.arange(5, 51, 5)
"""Thresholds of MSPD in an image 640 pixels wide."""

_SYMMETRY_STEP_RAD = 0.02
"""Between two samples of a continuous symmetry a point moves by at most a hundredth of the diameter."""


@dataclass(frozen=True, eq=False)
class BopObject:
    """An object for BOP's errors. mesh: in metres; diameter_m: as the data set states it; symmetries
    (S, 4, 4): T_cam_obj and T_cam_obj @ symmetry count as the same pose."""

    mesh: Mesh
    diameter_m: float
    symmetries: Float64

    @staticmethod
    def of(mesh: Mesh, info: Mapping[str, Any]) -> BopObject:
        """info: the mesh's entry in `models_info.json` (millimetres)."""
        return BopObject(
            mesh, float(info["diameter"]) / 1000.0, symmetry.sampled(info, step_rad=_SYMMETRY_STEP_RAD)
        )


_LIMITS = np.stack([*[FRACTIONS] * len(FRACTIONS), FRACTIONS, PIXELS])
"""Thresholds (12, 10) of VSD by tolerance, MSSD, MSPD."""


@dataclass(frozen=True)
class BopErrors:
    """vsd: by misalignment tolerance, 0..1; mssd: as a share of the diameter; mspd_px: in an image 640 px
    wide."""

    vsd: tuple[float, ...]
    mssd: float
    mspd_px: float

    @staticmethod
    def missing() -> BopErrors:
        """The errors of a missing pose."""
        return BopErrors((1.0,) * len(FRACTIONS), np.inf, np.inf)


@dataclass(frozen=True)
class BopScore:
    """errors: of the pose that is assigned to a label; recalls: shares of the thresholds of VSD, MSSD and
    MSPD at which some pose matches the label."""

    errors: BopErrors
    recalls: tuple[float, float, float]

    def as_json(self) -> dict[str, Any]:
        """The score in its file form."""
        e = self.errors
        return {"vsd": list(e.vsd), "mssd": e.mssd, "mspd_px": e.mspd_px, "recalls": list(self.recalls)}


def bop_errors(
    obj: BopObject, T_estimate: Float | None, T_truth: Float, depth_m: Float32, camera: Camera
) -> BopErrors:
    """All three errors of a pose (4, 4), or of a missing one (None), in a frame with this depth (H, W)."""
    if T_estimate is None:
        return BopErrors.missing()
    rendered = [render_depth(obj.mesh, T, camera) for T in (T_estimate, T_truth)]
    discrepancy = vsd(rendered[0], rendered[1], depth_m, camera, obj.diameter_m)
    surface, projection = mssd_mspd(obj.mesh.vertices, T_estimate, T_truth, obj.symmetries, camera)
    return BopErrors(tuple(discrepancy.tolist()), surface / obj.diameter_m, projection * 640.0 / camera.width)


def vsd(
    depth_estimate_m: Float32,
    depth_truth_m: Float32,
    depth_m: Float32,
    camera: Camera,
    diameter_m: float,
) -> Float64:
    """Visible surface discrepancy (10,) at the tolerances FRACTIONS, from rendered and measured depths (H,
    W).

    A pixel without depth occludes nothing. Where the label's surface is visible, the estimate's is, too."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    slope_x, slope_y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy

    def distance(depth: Float32) -> Float64:
        return np.asarray(np.sqrt((slope_x * depth) ** 2 + (slope_y * depth) ** 2 + depth.astype(float) ** 2))

    measured, truth, estimate = distance(depth_m), distance(depth_truth_m), distance(depth_estimate_m)
    seen_truth = (truth > 0) & ((truth - measured <= VSD_DELTA_M) | (measured == 0))
    seen_estimate = (estimate > 0) & ((estimate - measured <= VSD_DELTA_M) | (measured == 0) | seen_truth)
    both, either = seen_truth & seen_estimate, int((seen_truth | seen_estimate).sum())
    if not either:
        return np.ones(len(FRACTIONS))
    apart = np.sort(np.abs(truth[both] - estimate[both]) / diameter_m)
    wrong = len(apart) - np.searchsorted(apart, FRACTIONS, side="left")
    return np.asarray((wrong + (either - len(apart))) / either, np.float64)


def mssd_mspd(
    points_obj: Float, T_estimate: Float, T_truth: Float, symmetries: Float, camera: Camera
) -> tuple[float, float]:
    """Maximum symmetry-aware distances of surface points (N, 3), metres, and of their projections, pixels."""
    points = np.asarray(points_obj, np.float64)
    estimate = se3.apply(T_estimate, points)
    pixels = _projected(estimate, camera)
    surface = projection = np.inf
    for rotation in symmetries:
        truth = se3.apply(T_truth @ rotation, points)
        surface = min(surface, float(((estimate - truth) ** 2).sum(1).max()))
        projection = min(projection, float(((pixels - _projected(truth, camera)) ** 2).sum(1).max()))
    return float(np.sqrt(surface)), float(np.sqrt(projection))


def _projected(points_cam: Float64, camera: Camera) -> Float64:
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    with np.errstate(divide="ignore", invalid="ignore"):  # a point at the camera is far from any pixel
        pixels = points_cam[:, :2] / points_cam[:, 2:] * focal + centre
    return np.asarray(np.nan_to_num(pixels, nan=np.inf), np.float64)


def matched_recalls(errors: Sequence[Sequence[BopErrors]]) -> list[tuple[float, float, float]]:
    """BopScore.recalls of an object's labels in an image. errors: by pose, in order of decreasing score,
    and by label.

    As in BOP's localisation task: at each threshold the pose with the highest score matches the label with
    the least error, if that is below the threshold. The next poses match among the remaining labels."""
    values = np.array([[(*e.vsd, e.mssd, e.mspd_px) for e in row] for row in errors], np.float64)
    free = np.ones((values.shape[1], *_LIMITS.shape), bool)
    for own in values[..., None]:
        near = np.where(free & (own < _LIMITS), own, np.inf)
        hit = np.isfinite(near).any(axis=0)
        free[(near.argmin(axis=0)[hit], *np.nonzero(hit))] = False
    n = len(FRACTIONS)
    return [(float(t[:n].mean()), float(t[n].mean()), float(t[n + 1].mean())) for t in ~free]


def average_recalls(scores: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """`ar` and its parts `ar_vsd`, `ar_mssd`, `ar_mspd` of N scores in their file form, percent.

    Each part is the mean recall over its thresholds (for VSD also over its tolerances); AR is the mean of the
    three."""
    if not scores:
        return dict.fromkeys(("ar", "ar_vsd", "ar_mssd", "ar_mspd"))
    v, s, p = (100.0 * np.mean([score["recalls"] for score in scores], axis=0)).tolist()
    return {"ar": (v + s + p) / 3.0, "ar_vsd": v, "ar_mssd": s, "ar_mspd": p}
