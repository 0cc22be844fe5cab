"""The outline of a pose in the image, and the strength of the image's edges beside it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.geometry.arrays import Float32, Float64, UInt8
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth

FEWEST, BORDER_PX = 30, 8
"""Least number of outline points of an object, and their least distance from the image border, pixels."""

RELATED_PX = 6.0
"""Correlation length along an outline, pixels: nearer points are not independent."""

FAINT = 2.0
"""Strength of an image edge that is as strong as noise, opponent units."""

_OCCLUDER_M = 0.01
"""A reading this much in front of an outline point occludes it, metres."""

_EDGE_PX = 2.0
"""Distance across an edge, from one side to the other, pixels."""

_STEP_PX = 0.5

MOST_ROWS = 16384
"""Points whose lines are read at once."""


def smoothed(color: UInt8) -> Float32:
    """The opponents of an image (H, W, 3) without the noise of single pixels."""
    return np.asarray(cv2.GaussianBlur(opponents_of_bytes(color), (0, 0), 0.8), dtype=np.float32)


def free_outline(model: ReferenceModel, frame: RgbdFrame, T_cam_obj: Float64) -> tuple[Float64, Float64]:
    """Free pixels (N, 2) of a pose's outline, neither occluded nor near the image border, and their outward
    normals (N, 2)."""
    depth = render_depth(model.mesh, T_cam_obj, frame.camera)
    inside = (depth > 0).astype(np.uint8)
    outlines, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return np.zeros((0, 2)), np.zeros((0, 2))
    pixels = np.concatenate([line[:, 0] for line in outlines]).astype(int)
    blurred = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 1.5)
    slope = np.stack([cv2.Sobel(blurred, cv2.CV_32F, *axes) for axes in ((1, 0), (0, 1))], axis=-1)
    outward = -slope[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    length = np.linalg.norm(outward, axis=1)
    height, width = depth.shape
    last = np.array([width - 1, height - 1])
    free = (length > 1e-3) & (pixels >= BORDER_PX).all(1) & (pixels <= last - BORDER_PX).all(1)
    pixels, outward = pixels[free], outward[free] / length[free, None]
    rim = depth[pixels[:, 1], pixels[:, 0]]
    occluded = np.zeros(len(pixels), bool)
    for far in (-5.0, -3.0, 2.0, 4.0, 6.0):
        x, y = np.clip(np.rint(pixels + far * outward).astype(int), 0, last).T
        own = np.where(depth[y, x] > 0, depth[y, x], rim)
        occluded |= (frame.depth[y, x] > 0) & (frame.depth[y, x] < own - _OCCLUDER_M)
    return pixels[~occluded].astype(np.float64), outward[~occluded]


@dataclass(frozen=True, eq=False)
class EdgesAcross:
    """strength (N, K): of an image's edges across N outline points, at K positions step_px apart along their
    normals, from -reach_px to reach_px; divided by the mean of each point."""

    strength: Float64
    reach_px: float
    step_px: float = _STEP_PX

    def at(self, places_px: Float64) -> Float64:
        """Strengths (..., N) at positions (..., N), pixels outwards from each point."""
        at = np.clip((places_px + self.reach_px) / self.step_px, 0.0, self.strength.shape[1] - 1.001)
        low = at.astype(int)
        part, row = at - low, np.arange(len(self.strength))
        return np.asarray((1.0 - part) * self.strength[row, low] + part * self.strength[row, low + 1])


def edges_across(picture: Float32, pixels: Float64, normals: Float64, reach_px: float) -> EdgesAcross:
    """The edges of a smoothed image (H, W, 3) along normals (N, 2) at pixels (N, 2)."""
    half = 0.5 * _EDGE_PX
    places = np.arange(-reach_px - half, reach_px + half + 0.01, _STEP_PX)
    x = (pixels[:, 0, None] + places * normals[:, 0, None]).astype(np.float32)
    y = (pixels[:, 1, None] + places * normals[:, 1, None]).astype(np.float32)
    # cv2.remap takes at most 32767 rows: the outlines of a dozen objects in an image of 4K have more points.
    values = np.concatenate(
        [
            cv2.remap(picture, x[some], y[some], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for some in (slice(k, k + MOST_ROWS) for k in range(0, len(x), MOST_ROWS))
        ]
    )
    apart = round(_EDGE_PX / _STEP_PX)
    steps = np.linalg.norm(values[:, apart:] - values[:, :-apart], axis=-1)
    strength = steps / (steps.mean(axis=1, keepdims=True) + FAINT)
    return EdgesAcross(np.asarray(strength, dtype=np.float64), reach_px)
