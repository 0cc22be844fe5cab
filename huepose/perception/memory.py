"""What the detector remembers of its last looks through one camera: what stands still looks as it did.

A window that looks as it did when it was coded stays where it was and keeps its codes; features stay where
the picture has not changed. Each is made anew after some looks all the same, so that noise which once hid an
object does not hide it for long. Where a camera moves, nothing is kept, and a look costs a comparison more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from scipy.spatial.distance import cdist

from huepose.geometry.arrays import Bool, Float32, Float64, Int64, UInt8
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.perception.clear_view import ClearView
from huepose.perception.stillness import TILE_PX, Tiles, changed_shares
from huepose.propose.features import Features, FeatureSource

FEWEST, MOST = 6, 18
"""After so many looks something is made anew, spread so that not all of it is in the same look."""

CHANGED = 0.03
"""A window of whose tiles more have changed is another one."""

SAME_PLACE = 0.08
"""A window is one of before when their middles are so near, in diameters: a third of what is between two."""

LONE = 2
"""Of changed tiles with fewer changed ones about them, themselves counted, features are kept: it is noise."""

SHOWN, NOT_SHOWN = 0.5, 0.1
"""Where features are sought in more of a tile than this, and were in less than that, it has changed."""

MUCH = 0.5
"""Where so much of the view would be looked at for features again, all of it is."""

BESIDE_PX = 32
"""Features are made anew with so much of the picture about what has changed, as far as descriptors reach."""


@dataclass(frozen=True, eq=False)
class KeptWindows:
    """Windows of one size that were coded. pixels (N, 2) in the frame, depth_m, span_px (N,), codes (N, D);
    look, until (N,): the look in which they were, and up to which that holds."""

    pixels: Float64
    depth_m: Float64
    span_px: Float64
    codes: Float32
    look: Int64
    until: Int64

    def __getitem__(self, index: np.ndarray) -> KeptWindows:
        return KeptWindows(*(x[index] for x in vars(self).values()))


@dataclass(frozen=True, eq=False)
class KeptFeatures:
    """Features with their pixels in the frame; tiles: what the picture was like where each was found; shown
    (h, w): share of each tile in which they were sought; until: the look up to which they hold."""

    features: Features
    tiles: Tiles
    shown: Float32
    until: int


@dataclass(frozen=True, eq=False)
class Memory:
    """look: the number of the last one; camera: whose; tiles: by look, what the picture was like; windows: by
    size; features: None where nobody asked for any."""

    look: int
    camera: Camera
    tiles: Mapping[int, Tiles]
    windows: Mapping[int, KeptWindows]
    features: KeptFeatures | None = None
    _changed: dict[int, Bool] = field(default_factory=dict, init=False)

    def windows_of(self, size: int) -> KeptWindows | None:
        """Those of one size that look as they did when they were coded; None where there are none."""
        kept = self.windows.get(size)
        if kept is None:
            return None
        same = np.zeros(len(kept.look), bool)
        for look in np.unique(kept.look):
            if look in self.tiles:
                mine, changed = kept.look == look, self._changed_since(int(look))
                same[mine] = changed_shares(changed, kept.pixels[mine], kept.span_px[mine]) <= CHANGED
        return kept[same & (kept.until >= self.look)]

    def _changed_since(self, look: int) -> Bool:
        """Tiles (h, w) that have changed since a look: the same ones for windows of all sizes."""
        if look not in self._changed:
            self._changed[look] = self.tiles[self.look].changed(self.tiles[look])
        return self._changed[look]


def looking(before: Memory | None, frame: RgbdFrame) -> Memory:
    """The memory with which a frame is looked at; nothing is known of another camera."""
    tiles = Tiles.of(frame)
    if before is None or before.camera != frame.camera:
        return Memory(0, frame.camera, {0: tiles}, {})
    look = before.look + 1
    recent = {k: t for k, t in before.tiles.items() if k >= look - MOST}
    return replace(before, look=look, tiles={**recent, look: tiles})


def features_of(memory: Memory, view: ClearView, shown: Bool, source: FeatureSource) -> KeptFeatures:
    """The features of a view (h, w) where something is shown: as they were where nothing has changed."""
    crop, now, kept = view.crop, memory.tiles[memory.look], memory.features
    in_frame = np.zeros(view.frame.depth.shape, bool)
    in_frame[crop.y0 : crop.y0 + shown.shape[0], crop.x0 : crop.x0 + shown.shape[1]] = shown
    shares = _shares(in_frame, now.known.shape)
    if kept is not None and kept.until >= memory.look:
        appeared = (shares > SHOWN) & (kept.shown < NOT_SHOWN)
        anew = _together((now.changed(kept.tiles) & (shares > 0)) | appeared)
        parts = _parts(anew, in_frame.shape)
        if sum((right - left) * (low - top) for left, top, right, low in parts) < MUCH * shown.size:
            return _renewed(kept, now, shares, anew, parts, view.frame.color, in_frame, source)
    found = source.extract(crop.color, shown)
    corner = np.array([crop.x0, crop.y0], np.float32)
    return KeptFeatures(replace(found, pixels=found.pixels + corner), now, shares, memory.look + 2 * FEWEST)


def _renewed(
    kept: KeptFeatures,
    now: Tiles,
    shares: Float32,
    anew: Bool,
    parts: Sequence[tuple[int, int, int, int]],
    color: UInt8,
    shown: Bool,
    source: FeatureSource,
) -> KeptFeatures:
    """Features that were kept, with others in the tiles `anew` (h, w), of parts of the picture."""
    some = [kept.features[~_inside(kept.features.pixels, anew)]]
    for left, top, right, low in parts:
        part = np.s_[top:low, left:right]
        found = source.extract(np.ascontiguousarray(color[part]), np.ascontiguousarray(shown[part]))
        found = replace(found, pixels=found.pixels + np.array([left, top], np.float32))
        some.append(found[_inside(found.pixels, anew)])
    features = Features(
        np.concatenate([f.pixels for f in some]), np.concatenate([f.descriptors for f in some])
    )
    tiles = Tiles(
        np.where(anew[..., None], now.means, kept.tiles.means),
        np.where(anew[..., None], now.deviations, kept.tiles.deviations),
        np.where(anew, now.known, kept.tiles.known),
    )
    return KeptFeatures(features, tiles, np.where(anew, shares, kept.shown), kept.until)


def _shares(shown: Bool, tiles: tuple[int, ...]) -> Float32:
    """Share of each tile (h, w) that is shown in a picture (H, W)."""
    whole = shown[: tiles[0] * TILE_PX, : tiles[1] * TILE_PX]
    return np.asarray(whole.reshape(tiles[0], TILE_PX, tiles[1], TILE_PX).mean((1, 3)), np.float32)


def _together(changed: Bool) -> Bool:
    """Tiles (h, w) that have changed, but for lone ones, and those beside them."""
    ones = np.ones((3, 3), np.float32)
    beside = cv2.filter2D(changed.astype(np.float32), -1, ones, borderType=cv2.BORDER_CONSTANT)
    together = (changed & (beside > LONE - 0.5)).view(np.uint8)
    return np.asarray(cv2.dilate(together, np.ones((3, 3), np.uint8)) > 0)


def _parts(anew: Bool, size: tuple[int, ...]) -> list[tuple[int, int, int, int]]:
    """Left, top, right and lower side of the parts of a picture (H, W) that hold tiles and what is beside
    them."""
    found = cv2.connectedComponentsWithStats(anew.view(np.uint8), connectivity=8)[2][1:, :4]
    return [
        (
            max(TILE_PX * int(x) - BESIDE_PX, 0),
            max(TILE_PX * int(y) - BESIDE_PX, 0),
            min(TILE_PX * int(x + w) + BESIDE_PX, size[1]),
            min(TILE_PX * int(y + h) + BESIDE_PX, size[0]),
        )
        for x, y, w, h in found
    ]


def _inside(pixels: Float32, tiles: Bool) -> Bool:
    """Which pixels (N, 2) lie in some of the tiles (h, w)."""
    x, y = np.clip((pixels / TILE_PX).astype(np.int64), 0, [tiles.shape[1] - 1, tiles.shape[0] - 1]).T
    return np.asarray(tiles[y, x])


def matched(places: Float64, kept: Float64) -> tuple[Int64, Int64]:
    """Which places (W, 3), in diameters, are which of those before (N, 3): indices (K,) into both, none
    twice."""
    none = np.zeros(0, np.int64), np.zeros(0, np.int64)
    if not len(places) or not len(kept):
        return none
    apart = cdist(places, kept)
    nearest = apart.argmin(0)
    of_kept = np.flatnonzero(apart[nearest, np.arange(len(kept))] < SAME_PLACE)
    of_kept = of_kept[np.argsort(apart[nearest[of_kept], of_kept], kind="stable")]
    mine, first = np.unique(nearest[of_kept], return_index=True)
    return mine, of_kept[first]


def until(look: int, count: int) -> Int64:
    """Up to which look (count,) what is made in this one holds."""
    return look + FEWEST + np.arange(count) % (MOST - FEWEST + 1)
