"""Which views of an object look like what is in which windows? All pairs of both, by their codes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int64
from huepose.geometry.camera import Camera
from huepose.perception.clear_view import ClearView
from huepose.perception.window_table import WindowTable, middle_hues
from huepose.perception.windows import Windows
from huepose.propose.quick_look import product
from huepose.propose.template_table import MILLIMETRES
from huepose.propose.view_codes import codes_of_windows
from huepose.propose.view_pictures import window_pictures
from huepose.propose.views import onto_rays


@dataclass(frozen=True, eq=False)
class Looks:
    """Pairs of a window and a view, best first: poses T_cam_obj (K, 4, 4), likenesses (K,), windows (K,)."""

    poses: Float64
    likenesses: Float64
    windows: Int64


def promising(table: WindowTable, windows: Windows) -> Int64:
    """Indices (W,) of windows: first the pieces', then by how near the hue of their middle is to the
    object's."""
    weight = windows.cells[..., 4]
    weighted = np.stack([weight * windows.cells[..., 1], weight * windows.cells[..., 2]])
    hues = middle_hues(weight, weighted)
    apart = ((hues[:, None] - table.hues[None]) ** 2).sum(-1).min(1)
    apart[: windows.pieces] -= 1e6
    return np.argsort(apart, kind="stable")


def codes_of(view: ClearView, windows: Windows, diameter_m: float, known: int = 0) -> Float32:
    """Codes (W - known, D) of windows (W) of an object of that size, from number `known` on."""
    places = windows.pixels[known:], windows.depth_m[known:], windows.span_px[known:]
    return codes_of_windows(*window_pictures(view.crop.color, view.depth, *places, diameter_m))


def look(
    table: WindowTable, windows: Windows, codes: Float32, camera: Camera, count: int, each: int
) -> Looks:
    """The `count` likest pairs of all, at most `each` of one window; codes (W, D): of the windows."""
    if not len(windows):
        return Looks(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, np.int64))
    alike = product(table.codes, codes.T)
    views = table.views
    each = min(each, alike.shape[0])
    best = np.argpartition(-alike, each - 1, axis=0)[:each]
    window = np.broadcast_to(np.arange(len(windows)), best.shape).ravel()
    view = best.ravel()
    order = np.argsort(-alike[view, window], kind="stable")[:count]
    view, window = view[order], window[order]
    depth_m = windows.depth_m[window] + _behind_mm(table, windows.cells, view, window) / MILLIMETRES
    rays = camera.rays(windows.pixels[window])
    turns = onto_rays(rays)
    poses = np.tile(np.eye(4), (len(order), 1, 1))
    poses[:, :3, :3] = turns @ views.rotations[view]
    poses[:, :3, 3] = rays * depth_m[:, None] + np.einsum("nij,nj->ni", turns, views.origins[view])
    return Looks(poses, alike[view, window].astype(np.float64), window)


def _behind_mm(table: WindowTable, cells: Float32, view: Int64, window: Int64) -> Float64:
    """By how many millimetres each view (K,) lies behind the middle of its window (K,), where both are
    known: the views' relief is from their own median depth."""
    t = table.views
    seen = cells[:, t.used]
    weight = t.coverage[view] * seen[window, :, 4]
    gap = t.coverage[view] * seen[window, :, 3] - t.first[3, view]
    return np.asarray(
        (seen[window, :, 4] * gap).sum(1) / np.maximum(weight.sum(1), np.float32(1e-3)), np.float64
    )
