"""The detector's memory of one camera: codes and features of what has not changed are used again.

A *look* is one frame that the detector searches. A window keeps its place and codes while its part of the
image is unchanged; image features are kept where the image is unchanged. Both expire after some looks, so
that noise that concealed an object once does not conceal it for long. If the camera moves, nothing is kept;
the comparison costs 1.3 ms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int64, UInt8
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.perception.clear_view import ClearView
from huepose.perception.stillness import TILE_PX, Tiles, changed_shares
from huepose.propose.features import Features, FeatureSource

FEWEST, MOST = 6, 18
"""Codes expire after 6 to 18 looks, spread so that only some of them expire in the same look."""

CHANGED = 0.03
"""A window is encoded again if more than this share of its tiles has changed."""

SAME_PLACE = 0.08
"""Windows whose centres are this near, in diameters, are the same: a third of their spacing."""

LONE = 2
"""A changed tile counts as noise if fewer than this many of the 3 x 3 tiles around it, itself included,
have changed."""

SHOWN, NOT_SHOWN = 0.5, 0.1
"""A tile also counts as changed if features are now searched for in more than SHOWN of it, and before in
less than NOT_SHOWN of it."""

MUCH = 0.5
"""If features have to be searched for again in this share of the view, they are in all of it."""

BESIDE_PX = 32
"""Margin around a changed part in which features are extracted, pixels: the reach of a descriptor."""


@dataclass(frozen=True, eq=False)
class KeptWindows:
    """Encoded windows of one size. pixels (N, 2): centres in the frame; depth_m, span_px (N,); codes
    (N, D); look, until (N,): the look in which each was encoded, and the last look in which its code is
    valid."""

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
    """Image features with pixels in the frame. tiles: the image from which each feature was extracted;
    shown (h, w): share of each tile that was searched; until: the last look in which the features are
    valid."""

    features: Features
    tiles: Tiles
    shown: Float32
    until: int


@dataclass(frozen=True, eq=False)
class Memory:
    """look: number of the latest look; camera: its camera; tiles: the image of each recent look; windows:
    by size; features: None if none were extracted."""

    look: int
    camera: Camera
    tiles: Mapping[int, Tiles]
    windows: Mapping[int, KeptWindows]
    features: KeptFeatures | None = None
    _changed: dict[int, Bool] = field(default_factory=dict, init=False)

    def windows_of(self, size: int) -> KeptWindows | None:
        """The valid windows of one size whose content is unchanged since they were encoded; None if that
        size is new."""
        kept = self.windows.get(size)
        if kept is None:
            return None
        same = np.zeros(len(kept.look), bool)
        for look in np.unique(kept.look):
            if look in self.tiles:
                mine, changed = kept.look == look, self.changed_since(int(look))
                same[mine] = changed_shares(changed, kept.pixels[mine], kept.span_px[mine]) <= CHANGED
        return kept[same & (kept.until >= self.look)]

    def changed_since(self, look: int) -> Bool:
        """Tiles (h, w) that have changed since a look that is remembered."""
        if look not in self._changed:
            self._changed[look] = self.tiles[self.look].changed(self.tiles[look])
        return self._changed[look]


def next_look(before: Memory | None, frame: RgbdFrame) -> Memory:
    """The memory for the look at a new frame; empty if the frame comes from another camera."""
    tiles = Tiles.of(frame)
    if before is None or before.camera != frame.camera:
        return Memory(0, frame.camera, {0: tiles}, {})
    look = before.look + 1
    recent = {k: t for k, t in before.tiles.items() if k >= look - MOST}
    return replace(before, look=look, tiles={**recent, look: tiles})


def features_of(memory: Memory, view: ClearView, shown: Bool, source: FeatureSource) -> KeptFeatures:
    """The features of a view in the pixels `shown` (h, w), extracted again only where the image has
    changed."""
    crop, now, kept = view.crop, memory.tiles[memory.look], memory.features
    in_frame = np.zeros(view.frame.depth.shape, bool)
    in_frame[crop.y0 : crop.y0 + shown.shape[0], crop.x0 : crop.x0 + shown.shape[1]] = shown
    shares = _shares(in_frame, now.known.shape)
    # An image smaller than a tile has no tiles, so changes cannot be found.
    if kept is not None and kept.until >= memory.look and now.known.size:
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
    """Kept features, with those in the tiles `anew` (h, w) replaced by new ones from parts of the image."""
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
    """Share (h, w) of each tile that is True in a mask (H, W)."""
    whole = shown[: tiles[0] * TILE_PX, : tiles[1] * TILE_PX]
    return np.asarray(whole.reshape(tiles[0], TILE_PX, tiles[1], TILE_PX).mean((1, 3)), np.float32)


def _together(changed: Bool) -> Bool:
    """Changed tiles (h, w) without isolated ones, dilated by one tile."""
    ones = np.ones((3, 3), np.float32)
    beside = cv2.filter2D(changed.astype(np.float32), -1, ones, borderType=cv2.BORDER_CONSTANT)
    together = (changed & (beside > LONE - 0.5)).view(np.uint8)
    return np.asarray(cv2.dilate(together, np.ones((3, 3), np.uint8)) > 0)


def _parts(anew: Bool, size: tuple[int, ...]) -> list[tuple[int, int, int, int]]:
    """Bounds (left, top, right, bottom) of the connected parts of tiles, with a margin, in an image
    (H, W)."""
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
    """One-to-one matches between places (W, 3) and kept ones (N, 3), in diameters: indices (K,) into both."""
    from scipy.spatial.distance import cdist  # 0.1 s to import, which the tracker saves

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
    """The last look (count,) in which codes computed in this one are valid."""
    return look + FEWEST + np.arange(count) % (MOST - FEWEST + 1)
