"""Estimate the offset between depth and colour images from the outlines of known objects.

Cameras register depth to colour by a calibration that ages, and by clocks that differ; two to four pixels are
common, in published data as well. Poses follow depth, so their textures and outlines are then displaced in
the image. A single object may have its label elsewhere; a displacement shared by the outlines of all objects
of a frame is an offset of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth

REACH_PX, STEP_PX = 6.0, 0.25
"""Search range and step, pixels."""

FEWEST, BORDER_PX = 30, 8
"""Least number of outline points of an object, and their least distance from the image border, pixels."""

FAINT = 2.0
"""Opponents: an edge of the image as strong as noise."""

OCCLUDER_M = 0.01
"""A reading this much in front of an outline point hides it, metres."""

RELATED_PX = 6.0
"""Correlation length along an outline, pixels: nearer points are not independent."""

CLEAR_SIGMAS, CLEAR_PX = 4.0, 1.0
"""Least significance (standard errors) and length (pixels) of a clear offset."""


@dataclass(frozen=True)
class DepthOffset:
    """right_px, down_px: from where depth says that outlines are to where the image shows them; sigmas: by
    how many standard errors the outlines agree better there than where depth has them; points: of them."""

    right_px: float
    down_px: float
    sigmas: float
    points: int

    @property
    def length_px(self) -> float:
        """How far it is."""
        return float(np.hypot(self.right_px, self.down_px))

    @property
    def clear(self) -> bool:
        """Whether there is one, beyond doubt."""
        return self.length_px >= CLEAR_PX and self.sigmas >= CLEAR_SIGMAS

    def __str__(self) -> str:
        across = f"{abs(self.right_px):.1f} px to the {'right' if self.right_px > 0 else 'left'}"
        along = f"{abs(self.down_px):.1f} px {'below' if self.down_px > 0 else 'above'}"
        way = " and ".join(w for w, x in ((across, self.right_px), (along, self.down_px)) if abs(x) >= 0.5)
        return f"the image shows outlines {way or 'about'} where depth has them"


def depth_offset(frame: RgbdFrame, placed: Sequence[tuple[ReferenceModel, Float64]]) -> DepthOffset | None:
    """How the image's colours lie to its depth, from objects with poses (4, 4) that were fitted to depth;
    None where too little of their outlines is free."""
    smooth = np.asarray(cv2.GaussianBlur(opponents_of_bytes(frame.color), (0, 0), 0.8), dtype=np.float32)
    found = [_outline(model, frame, T) for model, T in placed]
    found = [one for one in found if len(one[0]) >= FEWEST]
    if not found:
        return None
    normals = np.concatenate([n for _, n in found])
    strength = _across(smooth, np.concatenate([p for p, _ in found]), normals)
    best = np.zeros(2)
    for step, reach in ((1.0, REACH_PX), (STEP_PX, 1.0)):
        ticks = np.arange(-reach, reach + step / 2, step)
        tried = best + np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
        tried = tried[np.hypot(tried[:, 0], tried[:, 1]) <= REACH_PX]
        best = tried[int(np.argmax([_at(strength, normals @ d).sum() for d in tried]))]
    gain = _at(strength, normals @ best) - _at(strength, np.zeros(len(normals)))
    error = float(gain.std()) * np.sqrt(RELATED_PX / len(gain)) + 1e-9
    return DepthOffset(float(best[0]), float(best[1]), float(gain.mean() / error), len(normals))


def _outline(model: ReferenceModel, frame: RgbdFrame, T_cam_obj: Float64) -> tuple[Float64, Float64]:
    """Free pixels (N, 2) of a pose's outline and their outward normals (N, 2)."""
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
    hidden = np.zeros(len(pixels), bool)
    for far in (-5.0, -3.0, 2.0, 4.0, 6.0):
        x, y = np.clip(np.rint(pixels + far * outward).astype(int), 0, last).T
        own = np.where(depth[y, x] > 0, depth[y, x], rim)
        hidden |= (frame.depth[y, x] > 0) & (frame.depth[y, x] < own - OCCLUDER_M)
    return pixels[~hidden].astype(np.float64), outward[~hidden]


def _across(picture: Float32, pixels: Float64, normals: Float64) -> Float64:
    """Strength (N, K) of the picture's edges across the normals, at K places a half pixel apart from
    -REACH_PX to REACH_PX, each point's by its own mean."""
    places = np.arange(-REACH_PX - 1.0, REACH_PX + 1.01, 0.5)
    x = (pixels[:, 0, None] + places * normals[:, 0, None]).astype(np.float32)
    y = (pixels[:, 1, None] + places * normals[:, 1, None]).astype(np.float32)
    values = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    steps = np.linalg.norm(values[:, 4:] - values[:, :-4], axis=-1)
    return np.asarray(steps / (steps.mean(axis=1, keepdims=True) + FAINT), dtype=np.float64)


def _at(strength: Float64, places_px: Float64) -> Float64:
    """Strengths (N,) at one place of each point."""
    at = np.clip((places_px + REACH_PX) / 0.5, 0.0, strength.shape[1] - 1.001)
    low = at.astype(int)
    part, row = at - low, np.arange(len(strength))
    return np.asarray((1.0 - part) * strength[row, low] + part * strength[row, low + 1])
