"""Figure and ground: does the object, where a pose has it, stand out in colour from what is round it?

The dense score asks whether the texture is there. Of an object that shows hardly any texture, a clamp or the
back of a box, it cannot tell the object from a patch of something else as even; nor does it mind a pose that
lies across two things. But an object ends where its pose ends: the colours in the visible part of its outline
are others than those just outside of it (the region statistics of silhouette trackers, Prisacariu and Reid
2012, used here to judge and not to descend).
"""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float, Float32, Float64
from huepose.geometry.box import Box
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose.support.jit import jit_dividing

RING_PX = 6
"""How far outside the outline the ground is looked at."""

FITS, IN_FRONT = 1.2, 2.0
"""Tolerances within which depth shows the object, and from which what is beside it stands in front of it, and
is no ground: it hides where the object ends."""

BINS = 20
LOWEST = (-120.0, -40.0, -60.0)
WIDTHS = (10.0, 5.0, 7.0)
"""Of the histogram of opponents: bins a channel, least values and widths."""

PRIOR_CONTRAST, PRIOR_PIXELS = 0.55, 50.0
"""How far figure and ground differ in general, and how many pixels say so before any is looked at."""

HULL_POINTS = 400


def figure_ground_contrast(model: ReferenceModel, region: Region, poses: Float) -> Float64:
    """How far the colours of figure and ground differ at poses (N, 4, 4): (N,), 0 where they are the same, 1
    where no colour is in both (one minus the Bhattacharyya coefficient of their histograms)."""
    out = np.full(len(poses), PRIOR_CONTRAST)
    points = model.surface.points[:HULL_POINTS]
    camera = region.crop.camera
    lowest, widths = np.array(LOWEST), np.array(WIDTHS)
    for k, T in enumerate(poses):
        placed = points @ T[:3, :3].T + T[:3, 3]
        if placed[:, 2].min() < 0.05:
            continue
        box = Box.of_pixels(camera.project(placed)).grown(0.05, RING_PX + 2.0)
        rows, columns = box.slices(camera.width, camera.height)
        height, width = rows.stop - rows.start, columns.stop - columns.start
        if height < 2 or width < 2:
            continue
        window = camera.cropped(columns.start, rows.start, width, height)
        rendered = render_depth(model.mesh, np.ascontiguousarray(T), window)
        figure, ground = figure_and_ground(rendered, region.crop.depth[rows, columns], region.tolerance_m)
        out[k] = _difference(figure, ground, region.colors[0, rows, columns], lowest, widths)
    return out


def figure_and_ground(rendered: Float32, observed: Float32, tolerance_m: float) -> tuple[Bool, Bool]:
    """Pixels (h, w) that show the object as rendered (metres, 0 beside it), and those round them that do not
    stand in front of it."""
    inside = rendered > 0
    fits = inside & (observed > 0) & (np.abs(observed - rendered) < FITS * tolerance_m)
    near = cv2.dilate(fits.view(np.uint8), np.ones((5, 5), np.uint8)) > 0
    figure = fits | (inside & (observed == 0) & near)
    side = np.ones((2 * RING_PX + 1, 2 * RING_PX + 1), np.uint8)
    depth_near = cv2.dilate(np.where(figure, rendered, np.float32(0.0)), side)
    rim = cv2.dilate(inside.view(np.uint8), np.ones((3, 3), np.uint8)) > 0
    in_front = (observed > 0) & (observed < depth_near - IN_FRONT * tolerance_m)
    return figure, (depth_near > 0) & ~rim & ~in_front


@jit_dividing
def _difference(figure: Bool, ground: Bool, colors: Float32, lowest: Float64, widths: Float64) -> float:
    """One minus the overlap of both sides' histograms, from PRIOR_CONTRAST where few pixels say so."""
    bins = np.zeros((2, BINS * BINS * BINS), np.int32)
    counts = np.zeros(2)
    for v in range(figure.shape[0]):
        for u in range(figure.shape[1]):
            if not figure[v, u] and not ground[v, u]:
                continue
            cell = 0
            for q in range(3):
                place = int((colors[v, u, q] - lowest[q]) / widths[q])
                cell = cell * BINS + min(max(place, 0), BINS - 1)
            side = 0 if figure[v, u] else 1
            bins[side, cell] += 1
            counts[side] += 1.0
    if counts[0] < 1.0 or counts[1] < 1.0:
        return PRIOR_CONTRAST
    overlap = 0.0
    for i in range(bins.shape[1]):
        if bins[0, i] and bins[1, i]:
            overlap += np.sqrt(float(bins[0, i]) * float(bins[1, i]))
    overlap /= np.sqrt(counts[0] * counts[1])
    known = min(counts[0], counts[1])
    return float(((1.0 - overlap) * known + PRIOR_CONTRAST * PRIOR_PIXELS) / (known + PRIOR_PIXELS))
