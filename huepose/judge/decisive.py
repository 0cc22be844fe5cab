"""Which of two poses the decisive pixels of a frame show: those whose depth only one of the two explains.

A near-symmetric rotation explains most of the surface as well as the right pose, and the mean over the
surface hardly differs. A handle differs in few pixels, but nearly all of these are on one side."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.mesh import Mesh
from huepose.judge.kernel_arrays import tolerance_at
from huepose.rendering.render import render_depth

MOST_PX = 128
"""Largest side of the compared images, pixels: some pixels on the width of a handle."""

LEAST_M, SIGMAS = 0.006, 3.0
"""Tolerance of depth, metres, and in standard errors of a reading. Pixels are decisive if the two poses
differ by more than twice that."""

UNSURE = 0.1
"""If this share of the object's pixels is decisive, all on one side, they count half: along borders, depth is
wrong in some, and poses that explain the same differ by some."""

NOWHERE_M = np.float32(1e3)
"""Depth where a pose shows nothing: no reading fits it."""


def decisive_balance(mesh: Mesh, T_a: Float64, T_b: Float64, box: Box, frame: RgbdFrame) -> float:
    """From 1 (the depth of all decisive pixels is that of the first pose T_a (4, 4)) to -1 (that of the
    second); about 0 where there are few of them. box: holds both poses in the image."""
    camera = frame.camera
    rows, columns = box.grown(0.0, 3.0).slices(camera.width, camera.height)
    width, height = columns.stop - columns.start, rows.stop - rows.start
    step = max(1, -(-max(width, height) // MOST_PX))
    depth = frame.depth[rows, columns][::step, ::step]
    if depth.size == 0:
        return 0.0
    every = Camera(
        camera.fx / step,
        camera.fy / step,
        (camera.cx - columns.start) / step,
        (camera.cy - rows.start) / step,
        depth.shape[1],
        depth.shape[0],
    )
    a, b = (render_depth(mesh, T, every) for T in (T_a, T_b))
    shown = 0.5 * float((a > 0.0).sum() + (b > 0.0).sum())
    tolerance = tolerance_at(LEAST_M, SIGMAS, float(se3.apply(T_a, mesh.centre[None])[0, 2]))
    a[a == 0.0], b[b == 0.0] = NOWHERE_M, NOWHERE_M
    decisive = (depth > 0.0) & (np.abs(a - b) > 2.0 * tolerance)
    for_a = int((decisive & (np.abs(depth - a) < tolerance)).sum())
    for_b = int((decisive & (np.abs(depth - b) < tolerance)).sum())
    return (for_a - for_b) / max(for_a + for_b + UNSURE * shown, 1.0)
