"""Near ties, looked at closely: poses that the dense score hardly tells apart compete by detail and outline.

Rolls of a can, the two faces of a box, a marker's sides share shape and mean colours; what tells them apart
is the fine texture and, for what is thin, the outline. Both only speak of a pose that is exact to a pixel, so
each contender is refined on them first, with a rendered view drawn for it (`rendered_view`), and then judged
on the pixels of all of them (`same_pixels`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.box import Box
from huepose.judge.arrays import region_arrays
from huepose.judge.outline import Rim, edge_tensor
from huepose.judge.region import OUTSIDE_WEIGHT, Region
from huepose.judge.rendered_view import detail_colors, draw_rendered_view
from huepose.judge.same_pixels import Likeness, Part, likeness
from huepose.model.types import ReferenceModel
from huepose.refine.coordinate_search import search_rendered_view
from huepose.select.config import CloseLookConfig

HULL_POINTS = 200
"""Of the surface, whose bounds stand for the object's."""


@dataclass(frozen=True, eq=False)
class CloseLook:
    """poses (K, 4, 4) refined on detail and outline; alike: how well their textures explain the same
    pixels."""

    poses: Float64
    alike: Likeness


def close_look(
    model: ReferenceModel, region: Region, poses: Float64, config: CloseLookConfig | None = None
) -> CloseLook | None:
    """A close look at each of the poses (K, 4, 4); None where one shows too little of the object, or is too
    near for a picture of it."""
    config = config or CloseLookConfig()
    rows, columns = _window(model, region, poses, config.room_px)
    weight = np.maximum(region.belief[rows, columns], np.float32(OUTSIDE_WEIGHT))
    color = region.crop.color[rows, columns]
    colors, edges = np.zeros_like(region.colors), np.zeros((*region.belief.shape, 3), np.float32)
    colors[rows, columns] = detail_colors(color, weight)
    edges[rows, columns] = edge_tensor(color)
    arrays = region_arrays(region)._replace(colors=colors)
    refined = poses.copy()
    for k, T in enumerate(poses):
        drawn = draw_rendered_view(model, T, region.crop.camera, config.samples)
        if drawn is None:
            return None
        rim = Rim(drawn.rim_points, drawn.rim_inward, edges, config.rim_weight)
        refined[k] = search_rendered_view(
            model, drawn.arrays, arrays, rim, T, config.steps_deg, config.samples, config.weights
        )
    alike = likeness(model, _part(region, rows, columns, colors, config.tolerances), refined)
    return None if alike is None else CloseLook(refined, alike)


def _part(region: Region, rows: slice, columns: slice, colors: Float32, tolerances: float) -> Part:
    """A part of the region's crop, with the colours (h, w, 6) of the whole crop."""
    crop = region.crop
    return Part(
        crop.camera.cropped(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start),
        colors[rows, columns],
        crop.depth[rows, columns],
        crop.saturated[rows, columns],
        tolerances * region.tolerance_m,
    )


def _window(model: ReferenceModel, region: Region, poses: Float64, room_px: float) -> tuple[slice, slice]:
    """Rows and columns of the crop that the poses cover, with some room."""
    camera = region.crop.camera
    points = model.surface.points[:HULL_POINTS]
    placed = np.concatenate([points @ T[:3, :3].T + T[:3, 3] for T in poses])
    ahead = placed[placed[:, 2] > 0.05]
    if not len(ahead):
        return slice(0, camera.height), slice(0, camera.width)
    return Box.of_pixels(camera.project(ahead)).grown(0.1, room_px).slices(camera.width, camera.height)
