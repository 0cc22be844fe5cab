"""The segmenter that needs no network: support plane, depth pieces, and a cut by colour.

Its candidate masks are judged together by the poses that they lead to, so a wrong one costs time, not the
answer.

Pieces are connected pixels without a depth step between them. An object appears as one piece, or as several
if something thin crosses it. The object is the set of pieces that together fit the box best. If they fit
badly, they may be the wrong ones; then a second mask is given.

Neighbours that touch without a depth step may still differ in colour. The object's colours are learned from
the mask, most from the middle of the box; other colours from what surrounds the box. Both are histograms;
the object's is learned again from the pixels that were kept. A pixel is kept if its neighbourhood is more
likely the object's. These are the two likelihoods of GrabCut (Rother et al. 2004) with smoothing instead of
a graph cut, which takes a sixth of the time and gives masks as good.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int, Int32, UInt8, median
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.perception.planes import above_plane, find_support_plane
from huepose.perception.stretches import connected, write_values
from huepose.support.jit import jit

COLOR_MIN_PIXELS = 60
"""A colour cut is a candidate if it has more pixels than this."""

COLOR_SAME = 0.8
"""A colour cut is another candidate only if its IoU with the depth mask is less than this."""


class DepthSegmenter:
    """Segments an object in a box by depth, helped by colour. Stateless and deterministic."""

    def segment(self, frame: RgbdFrame, box: Box, diameter_m: float) -> list[Bool]:
        """One to three candidate masks (H, W) of pixels with depth, most likely first. If depth shows no
        object, one mask: the inner half of the box, empty if that has hardly any depth."""
        masks = depth_masks(frame, box, diameter_m)
        if not masks:
            return [_middle_of(frame, box)]
        cut = color_cut(frame.color, box, masks[0])
        agreed, either = np.count_nonzero(cut & masks[0]), np.count_nonzero(cut | masks[0])
        if np.count_nonzero(cut) > COLOR_MIN_PIXELS and agreed < COLOR_SAME * either:
            masks.append(cut)
        return masks


def depth_masks(frame: RgbdFrame, box: Box, diameter_m: float) -> list[Bool]:
    """The candidate masks from depth alone, best first; empty if the box has no piece of depth."""
    if box.clipped(frame.camera.width, frame.camera.height).area < 4:
        return []
    rows, columns = box.grown(0.25, 4.0).slices(frame.camera.width, frame.camera.height)
    depth = np.ascontiguousarray(frame.depth[rows, columns])
    camera = frame.camera.cropped(columns.start, rows.start, depth.shape[1], depth.shape[0])
    local = Box(box.x - columns.start, box.y - rows.start, box.w, box.h)
    plane = find_support_plane(frame.depth, frame.camera, box)
    candidate = above_plane(depth, camera, plane)
    masks = join_pieces(depth, candidate, cut_pieces(depth, candidate, local), local, diameter_m)
    return [_in_frame(mask, frame, rows, columns) for mask in masks]


def _in_frame(mask: Bool, frame: RgbdFrame, rows: slice, columns: slice) -> Bool:
    out = np.zeros(frame.depth.shape, bool)
    out[rows, columns] = mask
    return out


def _middle_of(frame: RgbdFrame, box: Box) -> Bool:
    """The inner half of a box where it has depth: used when the object cannot be separated from its
    support."""
    out = np.zeros(frame.depth.shape, bool)
    rows, columns = box.grown(-0.25).slices(frame.camera.width, frame.camera.height)
    out[rows, columns] = frame.depth[rows, columns] > 0
    return out if np.count_nonzero(out) >= MIN_MASK_PIXELS else np.zeros_like(out)


MIN_PIXELS, MIN_MASK_PIXELS = 15, 25
"""Least pixels of a piece of depth, and of a mask: smaller ones are noise at edges."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of a window, numbered from 0. labels (h, w) int32: piece of each pixel, -1 for none; bounds
    (n, 4): left, top, right, bottom (exclusive); share (n,): part of the piece inside the box; weight (n,):
    pixels, weighted by their nearness to the box's centre; depth (n,): median, metres."""

    labels: Int
    bounds: Float64
    share: Float64
    weight: Float64
    depth: Float64


def cut_pieces(depth: Float32, candidate: Bool, box: Box) -> Pieces:
    """Cut the candidate pixels (h, w) of a window at depth steps; `box` is in the window's pixels."""
    free = candidate & ~depth_steps(depth)
    stretches, count = connected(free.view(np.uint8))
    v, u = np.arange(depth.shape[0]), np.arange(depth.shape[1])
    in_row, in_column = (v >= box.y) & (v < box.y1), (u >= box.x) & (u < box.x1)
    near_row = np.exp(-0.5 * ((v - box.y - box.h / 2) / (0.45 * box.h)) ** 2)
    near_column = np.exp(-0.5 * ((u - box.x - box.w / 2) / (0.45 * box.w)) ** 2)
    size, share, weight = np.zeros((3, count))
    bounds = np.empty((count, 4))
    _sums(stretches, in_row, in_column, near_row, near_column, size, share, weight, bounds)
    keep = np.flatnonzero(size >= MIN_PIXELS)
    number = np.full(count, -1, np.int32)
    number[keep] = np.arange(len(keep))
    labels = np.full(depth.shape, -1, np.int32)
    write_values(stretches, number, labels)
    return Pieces(
        labels, bounds[keep], share[keep] / size[keep], weight[keep], median_depths(depth, labels, len(keep))
    )


@jit
def _sums(
    stretches: Int32,
    in_row: Bool,
    in_column: Bool,
    near_row: Float64,
    near_column: Float64,
    size: Float64,
    inside: Float64,
    near: Float64,
    bounds: Float64,
) -> None:
    """Sum up for each piece (P,) of some stretches: its pixels, those inside the box, and their nearness to
    its centre. Being inside and nearness are products of factors for rows (h,) and columns (w,). bounds
    (P, 4): as in `Pieces`."""
    bounds[:, :2], bounds[:, 2:] = np.inf, -np.inf
    for v, first, last, k in stretches:
        size[k] += last - first
        bounds[k, 0], bounds[k, 2] = min(bounds[k, 0], first), max(bounds[k, 2], last)
        bounds[k, 1], bounds[k, 3] = min(bounds[k, 1], v), v + 1
        for u in range(first, last):
            near[k] += near_row[v] * near_column[u]
            if in_row[v] and in_column[u]:
                inside[k] += 1.0


def depth_steps(depth: Float32) -> Bool:
    """The pixels at the far side of every depth step: rims of near things stay whole."""
    smooth = np.asarray(cv2.medianBlur(np.ascontiguousarray(depth), 3), np.float32)
    step = np.empty(depth.shape, bool)
    _mark_steps(smooth, 0.006 + 0.004 * depth, step)
    return step


@jit
def _mark_steps(smooth: Float32, limit: Float32, step: Bool) -> None:
    """Mark the pixels (h, w) that are farther than a neighbour by more than a limit, that of the upper or
    left one of the two. Plain loops over a row, so that the compiler vectorises them."""
    height, width = smooth.shape
    for v in range(height):
        for u in range(width - 1):
            step[v, u] = smooth[v, u] - smooth[v, u + 1] > limit[v, u]
        step[v, width - 1] = False
        for u in range(1, width):
            step[v, u] |= smooth[v, u - 1] - smooth[v, u] < -limit[v, u - 1]
        if v + 1 < height:
            for u in range(width):
                step[v, u] |= smooth[v, u] - smooth[v + 1, u] > limit[v, u]
        if v > 0:
            for u in range(width):
                step[v, u] |= smooth[v - 1, u] - smooth[v, u] < -limit[v - 1, u]


def median_depths(depth: Float32, labels: Int, count: int) -> Float64:
    """Median depth of each piece."""
    inside = labels >= 0
    values, owner = depth[inside], labels[inside]
    # Positive floats sort like their bits: one sort of integers, with the piece in the high bits.
    bits = np.ascontiguousarray(values, dtype=np.float32).view(np.int32).astype(np.int64)
    order = np.sort((owner.astype(np.int64) << 32) | bits)
    sizes = np.bincount(owner, minlength=count)
    middle = np.concatenate([[0], np.cumsum(sizes)[:-1]]) + sizes // 2
    chosen = (order[middle.astype(int)] & 0x7FFFFFFF).astype(np.int32) if count else np.zeros(0, np.int32)
    return np.asarray(chosen.view(np.float32), dtype=np.float64)


def join_pieces(depth: Float32, candidate: Bool, pieces: Pieces, box: Box, diameter_m: float) -> list[Bool]:
    """One or two masks (h, w), best first: the best piece with those that belong to it, and the same for
    the second best if the first fits the box badly. Empty if no piece touches the box."""
    if not len(pieces.weight):
        return []
    merit = pieces.weight * (0.2 + _ious(pieces.bounds, box)) * pieces.share
    ranked = np.argsort(-merit, kind="stable")
    masks: list[Bool] = []
    fit = 0.0
    for main in ranked[:2]:
        if merit[main] <= 0 or (masks and (merit[main] < 0.15 * merit[ranked[0]] or fit > 0.65)):
            break
        mask, bounds = _joined(pieces, int(main), box, diameter_m)
        mask, fit = _finished(mask, bounds, depth, candidate, box, diameter_m)
        if np.count_nonzero(mask) >= MIN_MASK_PIXELS:
            masks.append(mask)
        elif not masks:
            fit = 0.0
    return masks


def _joined(pieces: Pieces, main: int, box: Box, diameter_m: float) -> tuple[Bool, Float64]:
    """A piece with every other piece that lies in the box, has about the same depth, and does not worsen
    the fit."""
    members = np.zeros(len(pieces.weight) + 1, bool)
    members[main] = True
    bounds = pieces.bounds[main]
    for k in np.argsort(-pieces.weight, kind="stable"):
        if k == main or pieces.share[k] < 0.85:
            continue
        if abs(pieces.depth[k] - pieces.depth[main]) > 0.6 * diameter_m:
            continue
        union = np.concatenate(
            [np.minimum(bounds[:2], pieces.bounds[k, :2]), np.maximum(bounds[2:], pieces.bounds[k, 2:])]
        )
        if _ious(union[None], box)[0] >= _ious(bounds[None], box)[0] - 0.02:
            members[k], bounds = True, union
    return members[pieces.labels], bounds  # label -1 reads the last entry, which is never a member


def _finished(
    mask: Bool, bounds: Float64, depth: Float32, candidate: Bool, box: Box, diameter_m: float
) -> tuple[Bool, float]:
    """The mask with its rims added again, without far-off depth and pixels beside the box; and how well it
    fits the box."""
    near = np.abs(depth - median(depth[mask])) < 0.75 * diameter_m
    grown = cv2.dilate((mask & near).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    mask = grown & candidate & near
    v, u = np.arange(depth.shape[0])[:, None], np.arange(depth.shape[1])[None, :]
    wide = box.grown(0.08)
    inside = mask & (u >= wide.x) & (u < wide.x1) & (v >= wide.y) & (v < wide.y1)
    kept = float(np.count_nonzero(inside)) / max(float(np.count_nonzero(mask)), 1.0)
    return inside, float(_ious(bounds[None], box)[0] * min(1.0, kept + 0.1))


def _ious(bounds: Float64, box: Box) -> Float64:
    """Intersection over union of bounds (n, 4) with a box."""
    w = np.minimum(bounds[:, 2], box.x1) - np.maximum(bounds[:, 0], box.x)
    h = np.minimum(bounds[:, 3], box.y1) - np.maximum(bounds[:, 1], box.y)
    shared = np.maximum(w, 0) * np.maximum(h, 0)
    area = (bounds[:, 2] - bounds[:, 0]) * (bounds[:, 3] - bounds[:, 1])
    return np.asarray(shared / np.maximum(area + box.area - shared, 1e-9))


MAX_SIDE = 72
"""The cut runs on an image reduced to at most this many pixels a side."""

BINS = 16
"""Histogram bins for each channel of CIELAB."""

ROUNDS = 2
"""Rounds of the cut: each learns the object's colours from what the one before kept."""

SMOOTHING_PX = 1.5
"""Sigma of the smoothing of the evidence, pixels of the reduced image."""

MOST_EVIDENCE = 3.0
"""Largest log-likelihood ratio of a single pixel."""

RARE = 1e-4
"""Added to the share of each colour, so that very rare colours are no evidence."""

MIDDLE = 0.4
"""Standard deviation of the weight around the middle of the box, in sizes of the box."""


def color_cut(color: UInt8, box: Box, mask: Bool) -> Bool:
    """The part of a mask (H, W) whose colours (RGB) differ from those outside the box; the mask itself if
    there is nothing to compare."""
    height, width = mask.shape
    rows, columns = box.grown(0.35, 8.0).slices(width, height)
    inside = mask[rows, columns].astype(np.uint8)
    h, w = inside.shape
    if not h or not w:
        return mask
    scale = min(1.0, MAX_SIDE / max(h, w))
    size = (max(2, round(w * scale)), max(2, round(h * scale)))
    small = cv2.resize(np.ascontiguousarray(color[rows, columns]), size, interpolation=cv2.INTER_AREA)
    covered = cv2.resize(inside, size, interpolation=cv2.INTER_NEAREST) > 0
    v = (rows.start + (np.arange(size[1]) + 0.5) * (h / size[1]))[:, None]
    u = (columns.start + (np.arange(size[0]) + 0.5) * (w / size[0]))[None, :]
    wide = box.grown(0.09)
    outside = (v < wide.y) | (v >= wide.y1) | (u < wide.x) | (u >= wide.x1)
    if not covered.any() or not outside.any():
        return mask
    middle = np.exp(-0.5 * ((v - box.y - box.h / 2) / (MIDDLE * box.h)) ** 2) * np.exp(
        -0.5 * ((u - box.x - box.w / 2) / (MIDDLE * box.w)) ** 2
    )
    kept = _likelier(np.asarray(small, dtype=np.uint8), covered, middle, outside)
    grown = cv2.resize(kept.astype(np.uint8) * 255, (w, h), interpolation=cv2.INTER_LINEAR) >= 128
    cut = cv2.morphologyEx(grown.astype(np.uint8) & inside, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    out = np.zeros_like(mask)
    out[rows, columns] = cut > 0
    return out


def _likelier(color: UInt8, covered: Bool, weight: Float64, outside: Bool) -> Bool:
    """The covered pixels (h, w) whose neighbourhood is more likely to have the colours of the covered
    pixels, weighted by `weight`, than the colours outside."""
    lab = cv2.cvtColor(color, cv2.COLOR_RGB2LAB).astype(np.int32) // (256 // BINS)
    place = (lab[..., 0] * BINS + lab[..., 1]) * BINS + lab[..., 2]
    others = np.log(_shares(place, outside.astype(np.float64)) + RARE)
    kept = covered
    for _ in range(ROUNDS):
        ratio = np.log(_shares(place, kept * weight) + RARE) - others
        evidence = np.clip(ratio[place], -MOST_EVIDENCE, MOST_EVIDENCE).astype(np.float32)
        kept = covered & (_smoothed(evidence) > 0)
        if not kept.any():
            break
    return kept


def _smoothed(evidence: Float32) -> Float32:
    return np.asarray(cv2.GaussianBlur(evidence, (0, 0), SMOOTHING_PX), dtype=np.float32)


def _shares(place: np.ndarray, weight: Float64) -> Float64:
    """Share (BINS ** 3,) of each colour in weighted pixels, smoothed over neighbouring bins."""
    counts = np.asarray(np.bincount(place.ravel(), weight.ravel(), BINS**3), np.float64)
    for apart in (BINS * BINS, BINS, 1):
        counts = _blurred(counts, apart)
    return np.asarray(counts / max(float(weight.sum()), 1e-9))


@jit
def _blurred(counts: Float64, apart: int) -> Float64:
    """Counts (BINS ** 3,) smoothed along the channel whose neighbouring bins are `apart`."""
    out = np.empty_like(counts)
    for first in range(0, counts.shape[0], BINS * apart):
        for k in range(BINS):
            here = first + k * apart
            below, above = first + max(k - 1, 0) * apart, first + min(k + 1, BINS - 1) * apart
            for i in range(apart):
                out[here + i] = 0.5 * counts[here + i] + 0.25 * (counts[below + i] + counts[above + i])
    return out
