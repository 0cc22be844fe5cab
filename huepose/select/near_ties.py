"""Decide between poses that score nearly alike, by a close look at texture detail and outline.

Rotations of a can, the two faces of a box or the sides of a marker share shape and mean colours, and the
dense score hardly separates them. Fine texture and, for thin objects, the outline do, but only at a pose that
is exact to a pixel. So each of the few best poses is first refined on them with a rendered view
(`judge.rendered_view`), then all are compared on the same pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAR_M
from huepose.judge.implied_light import Light, implied_lights
from huepose.judge.kernel_arrays import model_arrays, region_arrays
from huepose.judge.likeness import Likeness, Part, likeness
from huepose.judge.outline import Rim, edge_tensor
from huepose.judge.region import OUTSIDE_WEIGHT, Region
from huepose.judge.rendered_view import detail_colors, render_view
from huepose.judge.terms import totals as totals_of
from huepose.judge.weights import ScoreWeights
from huepose.model.types import ReferenceModel
from huepose.refine.coordinate_search import search_rendered_view
from huepose.select.distinct import Ranked, different_answers
from huepose.select.shade import in_their_light

WEIGHTS = {"dense": 1.0, "detail": 1.5, "broad": 6.5}
"""Weights of the terms between poses in a near tie. dense: distance to the first in the dense score, at most
0; detail, broad: how well fine and broader texture explain the same pixels.

Fitted on rendered heaps, path-traced piles and real frames, some of them those of docs/accuracy.md, to the
largest likelihood that the right pose wins (softmax of the weighted sums). Fitted on rendered frames alone
they lose 3.4 points of ADD on path-traced piles."""

TERMS = tuple(WEIGHTS)
"""Names of the terms in a near tie."""

CONTENDERS, WITHIN = 4, 0.12
"""Most poses that get a close look (it takes time), and how close to the best total such a pose is: noise and
light change totals as much. Chosen."""

SHARE = 0.35
"""Factor from a weighted difference of the terms to a difference of the total. Chosen, so that quality reads
both alike."""

CLOSE_WEIGHTS, RIM_WEIGHT = ScoreWeights(color=1.5, coarse=1.0), 0.75
"""Weights of the dense score in the close look, on detail and smoothed colours, which count alike and more
than in the first score; weight of the agreement of outline and image edges, in units of the total. Chosen."""

STEPS_DEG, SAMPLES = (3.0, 1.5, 0.7, 0.35), 600
"""The search in the close look: steps, degrees of rotation at the object's surface, and most surface samples.
Chosen."""

TOLERANCES, ROOM_PX = 1.5, 10.0
"""Textures are compared where depth is within this many of the region's tolerances of the pose; margin around
the poses in the image, pixels. Chosen."""

HULL_POINTS = 200
"""Surface points whose bounds count as those of the object."""


@dataclass(frozen=True, eq=False)
class CloseLook:
    """Result of the close look: refined poses (K, 4, 4); alike: how well their textures explain the same
    pixels."""

    poses: Float64
    alike: Likeness


def close_look(
    model: ReferenceModel, region: Region, poses: Float64, lights: Sequence[Light | None]
) -> CloseLook | None:
    """A close look at each of the poses (K, 4, 4), whose textures are compared in its light (K) if that is
    given. None if a pose shows too little of the object or is too near to be rendered, and if all poses are
    outside of the crop."""
    window = _window(model, region, poses)
    if window is None:
        return None
    rows, columns = window
    weight = np.maximum(region.belief[rows, columns], np.float32(OUTSIDE_WEIGHT))
    color = region.crop.color[rows, columns]
    colors, edges = np.zeros_like(region.colors), np.zeros((*region.belief.shape, 3), np.float32)
    colors[:, rows, columns] = detail_colors(color, weight)
    edges[rows, columns] = edge_tensor(color)
    arrays = region_arrays(region)._replace(colors=colors)
    refined = poses.copy()
    for k, (T, light) in enumerate(zip(poses, lights, strict=True)):
        rendered = render_view(model, T, region.crop.camera, SAMPLES, light)
        if rendered is None:
            return None
        rim = Rim(rendered.rim_points, rendered.rim_inward, edges, RIM_WEIGHT)
        refined[k] = search_rendered_view(
            model, rendered.arrays, arrays, rim, T, STEPS_DEG, SAMPLES, CLOSE_WEIGHTS
        )
    alike = likeness(model, _part(region, rows, columns, colors), refined, lights)
    return None if alike is None else CloseLook(refined, alike)


def _part(region: Region, rows: slice, columns: slice, colors: Float32) -> Part:
    """A part of the region's crop, with the colours (2, h, w, 3) of the whole crop."""
    crop = region.crop
    return Part(
        crop.camera.cropped(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start),
        colors[:, rows, columns],
        crop.depth[rows, columns],
        crop.saturated[rows, columns],
        TOLERANCES * region.tolerance_m,
    )


def _window(model: ReferenceModel, region: Region, poses: Float64) -> tuple[slice, slice] | None:
    """Rows and columns of the crop that the poses cover, with a margin; None if they are outside of it."""
    camera = region.crop.camera
    points = model.surface.points[:HULL_POINTS]
    placed = np.concatenate([points @ T[:3, :3].T + T[:3, 3] for T in poses])
    ahead = placed[placed[:, 2] > NEAR_M]
    if not len(ahead):
        return slice(0, camera.height), slice(0, camera.width)
    window = Box.of_pixels(camera.project(ahead)).grown(0.1, ROOM_PX)
    shown = window.clipped(camera.width, camera.height).area > 0.0
    return window.slices(camera.width, camera.height) if shown else None


@dataclass(frozen=True, eq=False)
class Contest:
    """Poses in a near tie: poses (K, 4, 4) after the close look, and terms (K, 3) in the order of TERMS."""

    poses: Float64
    terms: Float64

    def weighed(self) -> Float64:
        """Sums (K,) of the terms, each with its weight."""
        return np.asarray(self.terms @ np.array(list(WEIGHTS.values())))


def contest(model: ReferenceModel, region: Region, found: Ranked, shaded: bool = False) -> Contest | None:
    """The close look at the best few poses, each in the light that it implies where shade matters. None if
    the first is clearly ahead, or one cannot be compared."""
    rivals = int((found.behind[:CONTENDERS] < WITHIN).sum())
    if rivals < 2:
        return None
    poses = found.poses[:rivals]
    lights: Sequence[Light | None] = [None] * rivals
    if shaded:
        lights = implied_lights(model_arrays(model), region_arrays(region), poses)
    look = close_look(model, region, poses, lights)
    if look is None:
        return None
    columns = [-found.behind[:rivals], look.alike.detail, look.alike.broad]
    return Contest(look.poses, np.stack(columns, axis=-1))


def decided(model: ReferenceModel, region: Region, found: Ranked) -> tuple[Ranked, Contest | None]:
    """Poses reordered by the light on near-symmetric rotations and by the close look at the best few, and the
    contest if there was one."""
    found, shaded = in_their_light(model, region, found)
    held = contest(model, region, found, shaded)
    if held is None:
        return found, None
    rivals, weighed = len(held.poses), held.weighed()
    poses = np.concatenate([held.poses, found.poses[rivals:]])
    totals = np.concatenate([totals_of(model, region, held.poses), found.totals[rivals:]])
    others = np.maximum(found.behind[rivals:], WITHIN)
    ranked = Ranked.of(poses, totals, np.concatenate([SHARE * (weighed - weighed.max()), -others]))
    return ranked.these(different_answers(model, ranked.poses)), held
