"""From colour pairs in an image to colour pairs on a surface: position, normal, and the direction across the
edge.

Depth of single pixels is noisy, and worst at colour edges, where stereo matching is inconsistent. So each
pair is placed on a plane that is fitted to the depth around it. A plane in space is linear in inverse depth
over the image, which makes the fit a small linear system; a gate excludes readings on another surface.
"""

from __future__ import annotations

import numpy as np

from huepose.colorpair.types import ColorPairs, SurfacePairs
from huepose.geometry.arrays import Bool, Float, Float32, Float64
from huepose.geometry.camera import Camera
from huepose.support.jit import jit

RADIUS_PX, GATE_M = 4, 0.012
"""The plane at a pair is fitted to readings within this many pixels and this many metres of depth."""

MIN_FACING = 0.25
"""Colour pairs and edges are used from this cosine between the surface's normal and the line of sight."""


def lift(
    pairs: ColorPairs,
    depth: Float32,
    mask: Bool,
    camera: Camera,
    *,
    radius_px: int = RADIUS_PX,
    gate_m: float = GATE_M,
    min_facing: float = MIN_FACING,
) -> SurfacePairs:
    """Colour pairs of an image, lifted to the surface, camera axes.

    depth (H, W) float32 metres, 0 = nothing; only depth inside `mask` (H, W) is used. Pairs without depth
    around them, and those with a viewing cosine under `min_facing`, are dropped. The tangent is the image
    direction, moved along the viewing ray into the plane.
    """
    z, normals, known = local_planes(depth, mask, camera, pairs.pixels, radius_px, gate_m)
    rays = camera.rays(pairs.pixels)
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    facing = -(unit * normals).sum(1)
    way = np.stack([np.cos(pairs.directions), np.sin(pairs.directions)], 1)
    ahead = camera.rays(pairs.pixels + 0.5 * way) - camera.rays(pairs.pixels - 0.5 * way)
    kept = known & (facing > min_facing)
    along = (ahead * normals).sum(1) / np.where(kept, -facing, -1.0)
    tangents = ahead - along[:, None] * unit
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1), 1e-12)[:, None]
    return SurfacePairs(
        (rays * z[:, None])[kept].astype(np.float32),
        normals[kept].astype(np.float32),
        tangents[kept].astype(np.float32),
        pairs.colors[kept],
    )


def local_planes(
    depth: Float32, mask: Bool, camera: Camera, pixels: Float, radius_px: int, gate_m: float
) -> tuple[Float64, Float64, Bool]:
    """Depth (N,) and unit normal (N, 3), towards the camera, of the surface at pixels (N, 2); and whether
    they are known (N,).

    Fitted to the depth inside `mask` within `radius_px` that differs from the depth at the pixel by at most
    `gate_m`.
    """
    out = _planes(
        np.ascontiguousarray(depth, np.float32),
        np.ascontiguousarray(mask),
        np.ascontiguousarray(pixels, np.float64),
        radius_px,
        gate_m,
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
    )
    return out[0], out[1], out[2]


@jit
def _middle(depth: Float32, mask: Bool, u: int, v: int) -> float:
    """Depth at a pixel, or the nearest one within two pixels; 0 when there is none."""
    height, width = depth.shape
    best = 9
    found = 0.0
    for y in range(max(v - 2, 0), min(v + 3, height)):
        for x in range(max(u - 2, 0), min(u + 3, width)):
            d = (x - u) * (x - u) + (y - v) * (y - v)
            if d < best and depth[y, x] > 0.0 and mask[y, x]:
                best = d
                found = depth[y, x]
    return found


@jit
def _planes(
    depth: Float32,
    mask: Bool,
    pixels: Float64,
    radius: int,
    gate: float,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
) -> tuple[Float64, Float64, Bool]:
    height, width = depth.shape
    count = pixels.shape[0]
    z = np.zeros(count)
    normals = np.zeros((count, 3))
    known = np.zeros(count, np.bool_)
    for i in range(count):
        u, v = int(np.floor(pixels[i, 0] + 0.5)), int(np.floor(pixels[i, 1] + 0.5))
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        middle = _middle(depth, mask, u, v)
        if middle <= 0.0:
            continue
        n, sx, sy, sxx, sxy, syy, sw, sxw, syw = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for y in range(max(v - radius, 0), min(v + radius + 1, height)):
            for x in range(max(u - radius, 0), min(u + radius + 1, width)):
                d = depth[y, x]
                if d <= 0.0 or not mask[y, x] or abs(d - middle) > gate:
                    continue
                a, b, w = x - pixels[i, 0], y - pixels[i, 1], 1.0 / d
                n += 1.0
                sx += a
                sy += b
                sxx += a * a
                sxy += a * b
                syy += b * b
                sw += w
                sxw += a * w
                syw += b * w
        if n < 10:
            continue
        sxx += 0.5  # across a narrow strip of readings the plane faces the camera
        syy += 0.5
        det = sxx * (syy * n - sy * sy) - sxy * (sxy * n - sy * sx) + sx * (sxy * sy - syy * sx)
        if abs(det) < 1e-9:
            continue
        slope_x = (sxw * (syy * n - sy * sy) - sxy * (syw * n - sy * sw) + sx * (syw * sy - syy * sw)) / det
        slope_y = (sxx * (syw * n - sw * sy) - sxw * (sxy * n - sy * sx) + sx * (sxy * sw - syw * sx)) / det
        inverse = (sw - slope_x * sx - slope_y * sy) / n
        if inverse <= 0.0:
            continue
        # n . X = 1 for the plane: inverse depth is n0 x + n1 y + n2 on rays (x, y, 1)
        n0, n1 = slope_x * fx, slope_y * fy
        n2 = inverse - slope_x * (pixels[i, 0] - cx) - slope_y * (pixels[i, 1] - cy)
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        normals[i, 0], normals[i, 1], normals[i, 2] = -n0 / length, -n1 / length, -n2 / length
        z[i] = 1.0 / inverse
        known[i] = True
    return z, normals, known
