"""Is it this texture that is seen? What the dense score cannot say, measured on the pose that is answered.

A look-alike (the same shape in another texture) agrees in colour less than the object itself, but no less
than an object without much texture does. So what is asked for is what is lacking: how much higher the
agreement of the two opponent colours would be if the picture showed just this texture, which is little where
there is little texture. And at which contrast details are seen: sharp ones tell poses apart that blurred ones
do not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.judge.arrays import model_arrays, nearest_view, region_arrays
from huepose.judge.color_correlation import PLAIN
from huepose.judge.region import Region
from huepose.judge.terms import CLOSE_SAMPLES, DEFAULT_WEIGHTS
from huepose.model.types import ReferenceModel

FEWEST = 15
"""Samples that fit the depth, under which nothing is said."""

DETAIL_FLOOR = 0.75
"""Variance of detail (opponent units) that is noise."""

HUE_FLOOR = 40.0
"""Variance of hues (opponent units, both scales together) that is noise."""


@dataclass(frozen=True)
class TextureEvidence:
    """missing: agreement of the opponent colours that the picture owes to the texture, 0 (all is there) to
    about 0.8; foreign: deviation of the picture's opponent colours from the texture's, up to one offset
    (standard deviation, opponent units); detail: correlation of what is smaller than 3.5 mm, -1..1, low
    where it cannot be seen; turned: how far the hues of picture and texture are turned against each other as
    a whole, 0..1."""

    missing: float
    foreign: float
    detail: float
    turned: float


def texture_evidence(model: ReferenceModel, region: Region, T_cam_obj: Float) -> TextureEvidence:
    """Of a pose (4, 4). Where too little of the surface is seen, nothing is missing, nothing foreign and no
    detail is there."""
    seen = _seen_texture(model, region, np.ascontiguousarray(T_cam_obj, dtype=np.float64))
    if seen is None:
        return TextureEvidence(0.0, 0.0, 0.0, 0.0)
    weight, texture_colors, picture = seen
    share = weight / weight.sum()
    texture_colors = texture_colors - share @ texture_colors
    picture = picture - share @ picture
    of_texture, of_picture = share @ texture_colors**2, share @ picture**2
    both = share @ (texture_colors * picture)
    w = DEFAULT_WEIGHTS
    # Columns: lightness, red-green, yellow-blue at 1 mm, then at 3.5 mm.
    importance = np.sqrt(of_texture) * np.repeat([1.0, w.coarse], 3) * np.tile([w.lightness, 1.0, 1.0], 2)
    agreement = both / (np.sqrt(of_texture * of_picture) + w.color_floor)
    possible = of_texture / (of_texture + w.color_floor)
    chroma = [1, 2, 4, 5]
    missing = (importance * (possible - agreement))[chroma].sum() / (PLAIN + importance.sum())
    foreign = np.sqrt(max((of_texture + of_picture - 2.0 * both)[1:3].sum(), 0.0))
    turned = _turned(share, texture_colors[:, chroma], picture[:, chroma])
    return TextureEvidence(float(missing), float(foreign), _detail(share, texture_colors, picture), turned)


def _turned(share: Float64, texture_colors: Float64, picture: Float64) -> float:
    """Correlation of the picture's hues with the texture's turned by a right angle, of both scales (N, 4).

    Light and exposure move hues and make them fainter, all alike; they turn none towards its neighbour."""
    across, strength = 0.0, HUE_FLOOR
    for k in (0, 2):
        p, q = texture_colors[:, k : k + 2], picture[:, k : k + 2]
        across += float(share @ (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))
        strength += float(np.sqrt((share @ p**2).sum() * (share @ q**2).sum()))
    return abs(across) / strength


def _detail(share: Float64, texture_colors: Float64, picture: Float64) -> float:
    """Correlation of the differences between the two scales, over all three channels."""
    fine_texture = texture_colors[:, :3] - texture_colors[:, 3:]
    fine_picture = picture[:, :3] - picture[:, 3:]
    of_texture = float((share @ fine_texture**2).sum())
    of_picture = float((share @ fine_picture**2).sum())
    both = float((share @ (fine_texture * fine_picture)).sum())
    return both / float(np.sqrt(of_texture * of_picture) + DETAIL_FLOOR)


def _seen_texture(
    model: ReferenceModel, region: Region, T: Float64
) -> tuple[Float64, Float64, Float64] | None:
    """Of the samples that the pose shows and the depth confirms: weights (N,), opponents of the texture and
    of the picture, both (N, 6). None where there are too few."""
    m, r = model_arrays(model), region_arrays(region)
    view = nearest_view(T, m)
    index = m.visible[m.offsets[view] : m.offsets[view + 1]][:CLOSE_SAMPLES]
    points = m.points[index] @ T[:3, :3].T + T[:3, 3]
    normals = m.normals[index] @ T[:3, :3].T
    facing = -(normals * points).sum(1) / np.linalg.norm(points, axis=1)
    z = np.maximum(points[:, 2], 1e-6)
    u, v = points[:, 0] / z * r.fx + r.cx, points[:, 1] / z * r.fy + r.cy
    height, width = r.depth.shape
    inside = (facing > 0.1) & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
    column, row = (np.where(inside, x + 0.5, 0.0).astype(np.int64) for x in (u, v))
    depth = r.depth[row, column]
    fits = inside & (depth > 0) & (np.abs(depth - points[:, 2]) * facing < r.tolerance)
    fits &= ~r.saturated[row, column]
    if int(fits.sum()) < FEWEST:
        return None
    outside = DEFAULT_WEIGHTS.outside
    weight = facing[fits] * (outside + (1.0 - outside) * r.belief[row[fits], column[fits]])
    texture_colors = np.concatenate([m.colors[0][index[fits]], m.colors[1][index[fits]]], axis=1)
    picture = np.concatenate([_between_pixels(colors, u[fits], v[fits]) for colors in r.colors], axis=1)
    return weight, texture_colors.astype(np.float64), picture


def _between_pixels(colors: Float, u: Float64, v: Float64) -> Float64:
    """Values (N, C) of an image (h, w, C) at places between its pixels."""
    height, width = colors.shape[:2]
    u0 = np.clip(u.astype(np.int64), 0, width - 2)
    v0 = np.clip(v.astype(np.int64), 0, height - 2)
    a, b = np.clip(u - u0, 0.0, 1.0)[:, None], np.clip(v - v0, 0.0, 1.0)[:, None]
    upper = (1.0 - a) * colors[v0, u0] + a * colors[v0, u0 + 1]
    lower = (1.0 - a) * colors[v0 + 1, u0] + a * colors[v0 + 1, u0 + 1]
    return np.asarray((1.0 - b) * upper + b * lower, dtype=np.float64)
