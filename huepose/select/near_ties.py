"""Decide between poses that score nearly alike, by a close look at texture detail and outline.

Rotations of a can, the two faces of a box or the sides of a marker share shape and mean colours, and the
dense score hardly separates them. Fine texture and, for thin objects, the outline do, but only at a pose that
is exact to a pixel. So each of the few best poses is first refined on them with a rendered view
(`judge.rendered_view`), then all are compared on the same pixels and by colour pairs.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAR_M
from huepose.judge.outline import Rim, edge_tensor
from huepose.judge.pairs import (
    CLOSE_PAIR_SAMPLES,
    CLOSE_PAIRS,
    PAIR_WEIGHTS,
    pair_picture,
    pair_score_many,
)
from huepose.judge.region import OUTSIDE_WEIGHT, Region, region_arrays
from huepose.judge.rendered_view import Likeness, Part, detail_colors, draw_rendered_view, likeness
from huepose.judge.terms import totals as totals_of
from huepose.model.types import ReferenceModel
from huepose.refine.coordinate_search import search_rendered_view
from huepose.select.config import CloseLookConfig, NearTieConfig, NearTieWeights
from huepose.select.distinct import Ranked, different_answers

HULL_POINTS = 200
"""Surface points whose bounds stand for those of the object."""


@dataclass(frozen=True, eq=False)
class CloseLook:
    """Result of the close look: refined poses (K, 4, 4); alike: how well their textures explain the same
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
    colors[:, rows, columns] = detail_colors(color, weight)
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
    """A part of the region's crop, with the colours (2, h, w, 3) of the whole crop."""
    crop = region.crop
    return Part(
        crop.camera.cropped(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start),
        colors[:, rows, columns],
        crop.depth[rows, columns],
        crop.saturated[rows, columns],
        tolerances * region.tolerance_m,
    )


def _window(model: ReferenceModel, region: Region, poses: Float64, room_px: float) -> tuple[slice, slice]:
    """Rows and columns of the crop that the poses cover, with some room."""
    camera = region.crop.camera
    points = model.surface.points[:HULL_POINTS]
    placed = np.concatenate([points @ T[:3, :3].T + T[:3, 3] for T in poses])
    ahead = placed[placed[:, 2] > NEAR_M]
    if not len(ahead):
        return slice(0, camera.height), slice(0, camera.width)
    return Box.of_pixels(camera.project(ahead)).grown(0.1, room_px).slices(camera.width, camera.height)


TERMS = tuple(term.name for term in fields(NearTieWeights))
"""Names of the terms in a near tie, see `NearTieWeights`."""


@dataclass(frozen=True, eq=False)
class Contest:
    """Poses in a near tie: poses (K, 4, 4) after the close look, and terms (K, 4) in the order of TERMS."""

    poses: Float64
    terms: Float64

    def weighed(self, weights: NearTieWeights | None = None) -> Float64:
        """Sums (K,) of the terms, each with its weight."""
        return np.asarray(self.terms @ np.array(astuple(weights or NearTieWeights())))


def contest(
    model: ReferenceModel, region: Region, found: Ranked, config: NearTieConfig | None = None
) -> Contest | None:
    """The close look at the best few poses; None where the first is clearly ahead, or one cannot be
    compared."""
    config = config or NearTieConfig()
    rivals = int((found.behind[: config.contenders] < config.within).sum())
    if rivals < 2:
        return None
    poses = found.poses[:rivals]
    look = close_look(model, region, poses, config.close)
    if look is None:
        return None
    alike, pairs = look.alike, pair_colors(model, region, poses)
    columns = [-found.behind[:rivals], alike.detail, alike.broad, pairs]
    return Contest(look.poses, np.stack(columns, axis=-1))


def decided(
    model: ReferenceModel, region: Region, found: Ranked, config: NearTieConfig | None = None
) -> tuple[Ranked, Contest | None]:
    """Poses reordered by the close look at the best few, and the contest where there was one."""
    config = config or NearTieConfig()
    held = contest(model, region, found, config)
    if held is None:
        return found, None
    rivals, weighed = len(held.poses), held.weighed(config.weights)
    poses = np.concatenate([held.poses, found.poses[rivals:]])
    totals = np.concatenate([totals_of(model, region, held.poses), found.totals[rivals:]])
    others = np.maximum(found.behind[rivals:], config.within)
    ranked = Ranked.of(poses, totals, np.concatenate([config.share * (weighed - weighed.max()), -others]))
    return ranked.these(different_answers(model, ranked.poses)), held


def pair_colors(model: ReferenceModel, region: Region, poses: Float64) -> Float64:
    """Colour-pair agreement (K,) at poses (K, 4, 4), 0 without pairs."""
    picture = pair_picture(model, region.crop, region.median_depth_m)
    terms = pair_score_many(model, region, picture, poses, CLOSE_PAIRS, CLOSE_PAIR_SAMPLES)
    return np.asarray(PAIR_WEIGHTS.color * terms[:, 2] + PAIR_WEIGHTS.contrast * terms[:, 3])
