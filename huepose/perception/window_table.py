"""A model's view templates as the detector compares them with windows of an image: fewer views, larger
cells, codes; and the most similar ones as poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int64
from huepose.geometry.camera import Camera
from huepose.model.types import ReferenceModel, ViewTemplates
from huepose.perception.windows import Windows
from huepose.propose.products import product
from huepose.propose.templates import COARSE_SIDE, MILLIMETRES, CoarseViews, coarse_views, view_poses
from huepose.propose.view_codes import codes_of_views
from huepose.propose.views import onto_rays
from huepose.support.jit import jit
from huepose.support.kept import kept, once_for_each
from huepose.support.stages import stage

VIEWS, ROLL_STRIDE = 42, 2
"""The first 42 directions are the icosphere of level 1, 32 degrees apart; every second roll, 30 degrees
apart."""

MIN_COVERAGE = 0.25
"""Least coverage (0..1) of a cell that counts."""

_GRID = np.indices((COARSE_SIDE, COARSE_SIDE)) - (COARSE_SIDE - 1) / 2.0
_MIDDLE = (np.hypot(*_GRID) <= COARSE_SIDE / 4.0).ravel().astype(np.float32)


@dataclass(frozen=True, eq=False)
class WindowTable:
    """Tables of N views. codes (N, D) float32; rotations (N, 3, 3), origins (N, 3): as in a
    `TemplateTable`; used (P,): the cells that any view covers; of these, coverage (N, P) float32 and relief
    (N, P) float32: millimetres from a view's own median depth, times coverage. hues (V, 2) float32: the two
    colour opponents in the middle of the views from each direction."""

    codes: Float32
    rotations: Float64
    origins: Float64
    used: Int64
    coverage: Float32
    relief: Float32
    hues: Float32


@once_for_each
def window_table(model: ReferenceModel) -> WindowTable:
    """The table of a model (about 2 MB; 0.3 s if it has to be made), kept as long as the model exists."""
    return kept(WindowTable, model.digest, lambda: _made(model))


def _made(model: ReferenceModel) -> WindowTable:
    t = model.templates
    some = ViewTemplates(t.directions[:VIEWS], t.planes[:VIEWS, ::ROLL_STRIDE], t.origins[:VIEWS], t.span)
    coarse = coarse_views(some, MIN_COVERAGE)
    return WindowTable(
        codes_of_views(model.mesh, model.diameter_m),
        *view_poses(some),
        coarse.used,
        coarse.coverage,
        coarse.coverage * coarse.values[..., 3],
        _hues(coarse, some.planes.shape[1]),
    )


def middle_hues(weight: Float32, weighted: Float32) -> Float32:
    """Means (N, 2) of two channels over the middle cells: weight (N, P), weighted (2, N, P)."""
    total = np.maximum(weight @ _MIDDLE, np.float32(1e-3))
    return np.asarray((weighted @ _MIDDLE / total).T, dtype=np.float32)


def _hues(coarse: CoarseViews, rolls: int) -> Float32:
    weight = _in_all_cells(coarse, coarse.coverage)
    opponents = np.moveaxis(coarse.values[..., 1:3], -1, 0)
    means = middle_hues(weight, _in_all_cells(coarse, coarse.coverage * opponents))
    return np.asarray(means.reshape(-1, rolls, 2).mean(1), dtype=np.float32)


def _in_all_cells(coarse: CoarseViews, values: Float32) -> Float32:
    """Values (..., P) of the cells that are used, in all cells of a window."""
    out = np.zeros((*values.shape[:-1], COARSE_SIDE**2), np.float32)
    out[..., coarse.used] = values
    return out


APART, BESIDE, MOST_SIMILAR, LIKE = 0.3, 0.36, 16, 0.18
"""A coarse-to-fine search. First, windows at least APART diameters from each other are encoded. Then all
windows within BESIDE diameters of the MOST_SIMILAR most similar ones are encoded, if these have a likeness of
LIKE with some view (docs/detection_measured.md, codes of views)."""


@dataclass(frozen=True, eq=False)
class SimilarViews:
    """Pairs of a window and a view, most similar first: poses T_cam_obj (K, 4, 4), cosines of their codes
    (K,), and the windows' indices (K,)."""

    poses: Float64
    likenesses: Float64
    windows: Int64


def promising(table: WindowTable, windows: Windows) -> Int64:
    """Indices (W,) of all windows, most promising first: those on separate pieces, then by the distance
    between the hue of their middle and the nearest hue of the object's views."""
    cells = windows.middles
    weight = cells[..., 4]
    weighted = np.stack([weight * cells[..., 1], weight * cells[..., 2]])
    hues = middle_hues(weight, weighted)
    apart = ((hues[:, None] - table.hues[None]) ** 2).sum(-1).min(1)
    apart[: windows.pieces] -= 1e6
    return np.argsort(apart, kind="stable")


def compared(table: WindowTable, windows: Windows, chosen: Int64) -> Float32:
    """Cosines (N, W) between the codes of all views of an object and of the chosen windows (W,)."""
    if not len(chosen):
        return np.zeros((len(table.codes), 0), np.float32)
    codes = windows.codes(chosen)
    with stage("look"):
        return product(table.codes, codes.T)


def narrowed(table: WindowTable, windows: Windows, chosen: Int64, first: int) -> tuple[Int64, Float32]:
    """Encode some of the chosen windows (W,). Returns these (K,), in the same order, and cosines (N, K) of
    all views with them.

    Always encoded are the `first` ones, those on separate pieces, and those recalled from memory. Of the
    others, a subset APART diameters apart is encoded, and then the neighbours of the most similar ones that
    are similar enough."""
    from scipy.spatial.distance import cdist  # 0.1 s to import, which the tracker saves

    places = windows.places_diameters(chosen)
    taken = (np.arange(len(chosen)) < first) | (chosen < windows.pieces) | windows.recalled[chosen]
    _spread(places, taken)
    some = np.flatnonzero(taken)
    alike = compared(table, windows, chosen[some])
    most = alike.max(0)
    order = np.argsort(-most, kind="stable")[:MOST_SIMILAR]
    similar = some[order[most[order] >= LIKE]]
    with stage("look"):
        beside = (cdist(places, places[similar]) < BESIDE).any(1)
    more = np.flatnonzero(beside & ~taken)
    both = np.concatenate([some, more])
    order = np.argsort(both)
    alike = np.concatenate([alike, compared(table, windows, chosen[more])], axis=1)
    return chosen[both[order]], alike[:, order]


def most_similar_views(
    table: WindowTable,
    windows: Windows,
    chosen: Int64,
    alike: Float32,
    camera: Camera,
    count: int,
    each: int,
) -> SimilarViews:
    """The `count` most similar pairs of a view and one of the chosen windows (W,), at most `each` per
    window. alike: cosines (N, W) of views and windows. A pose has the depth at which the view's relief
    fits."""
    if not len(chosen):
        return SimilarViews(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, np.int64))
    with stage("look"):
        each = min(each, alike.shape[0])
        best = np.argpartition(-alike, each - 1, axis=0)[:each]
        window = np.broadcast_to(np.arange(len(chosen)), best.shape).ravel()
        view = best.ravel()
        order = np.argsort(-alike[view, window], kind="stable")[:count]
        view, window = view[order], window[order]
        among, again = np.unique(window, return_inverse=True)
        behind_mm = _behind_mm(table, windows.cells(chosen[among]), view, again.reshape(-1))
        depth_m = windows.depth_m[chosen[window]] + behind_mm / MILLIMETRES
        rays = camera.rays(windows.pixels[chosen[window]])
        to_rays = onto_rays(rays)
        poses = np.tile(np.eye(4), (len(order), 1, 1))
        poses[:, :3, :3] = to_rays @ table.rotations[view]
        poses[:, :3, 3] = rays * depth_m[:, None] + np.einsum("nij,nj->ni", to_rays, table.origins[view])
    return SimilarViews(poses, alike[view, window].astype(np.float64), window)


@jit
def _spread(places: Float64, taken: Bool) -> None:
    """Mark in `taken` (W,) each of places (W, 3) that is at least APART from all marked ones (greedy)."""
    for k in range(places.shape[0]):
        free = not taken[k]
        for i in range(places.shape[0]):
            if not free:
                break
            if i != k and taken[i]:
                away = 0.0
                for c in range(3):
                    away += (places[k, c] - places[i, c]) ** 2
                free = away >= APART * APART
        taken[k] |= free


def _behind_mm(table: WindowTable, cells: Float32, view: Int64, window: Int64) -> Float64:
    """Mean offset in depth (K,), mm, between each view and its window, over cells where both are known."""
    known = cells[:, table.used]
    weight = table.coverage[view] * known[window, :, 4]
    gap = table.coverage[view] * known[window, :, 3] - table.relief[view]
    return np.asarray(
        (known[window, :, 4] * gap).sum(1) / np.maximum(weight.sum(1), np.float32(1e-3)), np.float64
    )
