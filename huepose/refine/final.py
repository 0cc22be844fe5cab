"""The final refinement: the winning pose is fitted to the depth of the pixels that show the object.

The search on the score leaves a pose a millimetre from the best fit of the surface, because texture pulls it
along; where depth fixes a direction, depth is the better judge. Where it does not, the edges of the texture
are. How exact the pose is then follows from the fit to depth, widened by what else is known (`covariance`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.depth_noise import FLOOR_M, POINTS_PER_READING
from huepose.geometry.frame import RgbdFrame
from huepose.judge.region import Region
from huepose.judge.silhouette import visible_mask
from huepose.judge.terms import totals
from huepose.model.types import ReferenceModel
from huepose.refine.edge_refinement import refine_on_edges
from huepose.refine.point_to_plane import Alignment, align

GATE_M = 0.008
ITERATIONS = 8
POINTS = 1000
WORTH = 0.1
"""A refined pose may lose this much of the score; one that loses more has slid off the texture."""


def final_refinement(
    model: ReferenceModel, frame: RgbdFrame, region: Region, T_cam_obj: Float64
) -> tuple[Float64, Alignment, Bool]:
    """The pose (4, 4) after `refine_on_depth` and then on the edges of its texture; how the fit to depth
    went, and the mask (H, W) of the visible pixels."""
    fit, mask = refine_on_depth(model, frame, region, T_cam_obj)
    return refine_on_edges(model, frame, mask, fit.T_cam_obj), fit, mask


def refine_on_depth(
    model: ReferenceModel, frame: RgbdFrame, region: Region, T_cam_obj: Float64
) -> tuple[Alignment, Bool]:
    """A last robust fit of the pose (4, 4) to the depth of its own visible pixels, and their mask (H, W). Of
    no iterations when the texture objects."""
    tolerance = 1.5 * region.tolerance_m
    mask = visible_mask(model, frame, T_cam_obj, tolerance)
    points = _points(frame, mask)
    fit = align(model.surface, model.grid, points, T_cam_obj, GATE_M, GATE_M, ITERATIONS)
    before, after = totals(model, region, np.stack([T_cam_obj, fit.T_cam_obj]))
    if after < before - WORTH:
        fit = align(model.surface, model.grid, points, T_cam_obj, GATE_M, GATE_M, 0)
    else:
        mask = visible_mask(model, frame, fit.T_cam_obj, tolerance)
    return fit, mask


def _points(frame: RgbdFrame, mask: Bool) -> Float64:
    """At most POINTS evenly strided points (N, 3), camera axes, of mask pixels that have depth."""
    flat = np.flatnonzero(mask & (frame.depth > 0))
    rows, columns = np.divmod(flat[:: max(1, -(-len(flat) // POINTS))], mask.shape[1])
    return frame.camera.backproject(np.stack([columns, rows], -1), frame.depth[rows, columns])


@dataclass(frozen=True)
class PoseNoise:
    """What a fit to depth does not know. Metres and radians, camera axes. Origin: chosen.

    points_per_reading: neighbouring depth pixels err alike, so that many of them count as one.
    depth_sigma_m: of a depth reading, beside the residuals of the fit. texture_sigma: what the texture still
    fixes where depth fixes nothing. floor_sigma: errors of model and calibration, which no number of points
    averages away.
    """

    points_per_reading: float = POINTS_PER_READING
    depth_sigma_m: float = FLOOR_M
    texture_sigma: tuple[float, ...] = (0.004, 0.004, 0.004, 0.05, 0.05, 0.05)
    floor_sigma: tuple[float, ...] = (0.0005, 0.0005, 0.0010, 0.006, 0.006, 0.006)


def covariance(alignment: Alignment, noise: PoseNoise | None = None) -> Float64:
    """Covariance (6, 6) of a pose from the point-to-plane fit at it; order tx ty tz rx ry rz, camera axes."""
    noise = noise or PoseNoise()
    variance = (alignment.rms_m**2 + noise.depth_sigma_m**2) * noise.points_per_reading
    texture, floor = np.array(noise.texture_sigma), np.array(noise.floor_sigma)
    information = alignment.information / variance + np.diag(1.0 / texture**2)
    return np.asarray(np.linalg.inv(information) + np.diag(floor**2))
