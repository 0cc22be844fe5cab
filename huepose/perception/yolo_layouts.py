"""What the outputs of the YOLO family mean, told apart by their shape, or named.

With an input of H x W there are G = sum of (H/s)(W/s) over the strides 8, 16, 32 places:

| layout      | output            | columns                                          |
|-------------|-------------------|--------------------------------------------------|
| `v8`        | 1 x (4+nc) x G    | cx cy w h, scores                                 |
| `v5`        | 1 x 3G x (5+nc)   | cx cy w h, objectness, scores                     |
| `yolox`     | 1 x G x (5+nc)    | the same                                          |
| `yolox_raw` | 1 x G x (5+nc)    | offset in its place and logarithm of size, by stride |
| `end2end`   | 1 x n x 6         | x0 y0 x1 y1, score, class; overlaps are gone      |

A shape alone does not tell `yolox` from `yolox_raw`: decoded boxes are hundreds of pixels, raw ones are small
numbers. With one or two classes some shapes fit two layouts: then the layout has to be named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float64

STRIDES = (8, 16, 32)
LAYOUTS = ("v5", "v8", "yolox", "yolox_raw", "end2end")
# Decoded centres reach across the input; raw offsets and logarithms stay below this.
_RAW_LIMIT = 24.0


@dataclass(frozen=True, eq=False)
class Candidates:
    """Boxes (N, 4) x0 y0 x1 y1 in pixels of the input, scores (N,), classes (N,)."""

    corners: Float64
    scores: Float64
    classes: np.ndarray


def places(input_size: tuple[int, int]) -> int:
    """How many places the three grids of an input (height, width) have."""
    return sum((input_size[0] // s) * (input_size[1] // s) for s in STRIDES)


def layouts_of(shape: tuple[int, ...], input_size: tuple[int, int]) -> tuple[str, ...]:
    """The layouts that an output shape (1, rows, columns) can have; `yolox` stands for `yolox_raw` too.

    >>> layouts_of((1, 84, 8400), (640, 640)), layouts_of((1, 300, 6), (640, 640))
    (('v8',), ('end2end',))
    """
    if len(shape) != 3 or shape[0] != 1:
        return ()
    _, rows, columns = shape
    grid, found = places(input_size), []
    if columns == grid and rows >= 5:
        found.append("v8")
    if rows == 3 * grid and columns >= 6:
        found.append("v5")
    if rows == grid and columns >= 6:
        found.append("yolox")
    if columns == 6 and rows not in (grid, 3 * grid):
        found.append("end2end")
    return tuple(found)


def classes_in(layout: str, shape: tuple[int, ...]) -> int | None:
    """How many classes an output of a layout has; None where its shape does not say."""
    if layout == "end2end":
        return None
    return shape[1] - 4 if layout == "v8" else shape[2] - 5


def is_raw(output: Float) -> bool:
    """Whether an output (1, G, 5+nc) of YOLOX has boxes that are still offsets and logarithms."""
    return bool(np.abs(output[0, :, :4]).max() < _RAW_LIMIT)


def candidates(output: Float, layout: str, input_size: tuple[int, int], confidence: float) -> Candidates:
    """The boxes of an output (1, rows, columns) whose score is over `confidence`."""
    rows = np.asarray(output[0], dtype=np.float32)
    if layout == "end2end":
        rows = rows[rows[:, 4] > confidence]
        return Candidates(
            rows[:, :4].astype(np.float64), rows[:, 4].astype(np.float64), rows[:, 5].astype(int)
        )
    if layout == "v8":
        boxes, scores = rows[:4].T, rows[4:].T
    else:
        boxes, scores = rows[:, :4], rows[:, 5:] * rows[:, 4:5]
    classes = scores.argmax(axis=1)
    best = scores[np.arange(len(scores)), classes]
    keep = np.flatnonzero(best > confidence)
    kept = boxes[keep].astype(np.float64)
    if layout == "yolox_raw":
        kept = _decoded(kept, keep, input_size)
    half = kept[:, 2:] / 2.0
    corners = np.concatenate([kept[:, :2] - half, kept[:, :2] + half], axis=1)
    return Candidates(corners, best[keep].astype(np.float64), classes[keep])


def _decoded(boxes: Float64, index: np.ndarray, input_size: tuple[int, int]) -> Float64:
    """Raw boxes (N, 4) of the places `index`: centre (offset + place) stride, size exp(size) stride."""
    grids, strides = [], []
    for stride in STRIDES:
        height, width = input_size[0] // stride, input_size[1] // stride
        ys, xs = np.mgrid[0:height, 0:width]
        grids.append(np.stack([xs, ys], -1).reshape(-1, 2))
        strides.append(np.full((height * width, 1), stride))
    grid, stride_of = np.concatenate(grids)[index], np.concatenate(strides)[index]
    centres = (boxes[:, :2] + grid) * stride_of
    sizes = np.exp(np.minimum(boxes[:, 2:], 10.0)) * stride_of
    return np.asarray(np.concatenate([centres, sizes], axis=1))
