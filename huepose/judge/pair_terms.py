"""Judging a pose by colour pairs: do the model's pairs find their two colours where the pose puts them?

The model's pairs that the pose shows are projected, and the picture is read on both sides of each edge, in
colours of which light is an offset (see `opponents`). Light is normalised at the pose itself, by the offset
and the gain per channel that fit all read colours best, which makes the first term a correlation of colours.
The second is that of the differences between the two sides, where light, and shading that changes slowly,
cancel within each pair. Depth, free space and coverage of the mask are judged as for the dense score
(`judge.terms`), with its dense colour switched off.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes, opponents_of_lab
from huepose.geometry.arrays import Float, Float32, Float64
from huepose.judge.arrays import model_arrays, region_arrays
from huepose.judge.color_correlation import PLAIN
from huepose.judge.pair_kernel import (
    PAIR_TERMS,
    Judged,
    PairArrays,
    PairPicture,
    Room,
    pair_kernel,
    scratch,
)
from huepose.judge.region import Crop, Region
from huepose.judge.terms import DEFAULT_WEIGHTS, weight_array
from huepose.model.types import PairReference, ReferenceModel
from huepose.support.jit import jit

GEOMETRY = replace(DEFAULT_WEIGHTS, color=0.0, box=0.2)
"""The dense score's terms without its colours, weighed for pairs."""

CLOSE_PAIRS, CLOSE_PAIR_SAMPLES = 1500, 600
"""Colour pairs and surface samples by which the last few poses are judged closely."""

_opponents: WeakKeyDictionary[PairReference, Float32] = WeakKeyDictionary()
_lock = threading.Lock()

REACH_PX = 2.0
"""How far off the edge the colours of a pair were sampled, in pixels of the reference views: the middle of
the candidates of a sharp edge."""


@dataclass(frozen=True)
class PairWeights:
    """What colour and contrast weigh beside the geometry; lightness: its weight against the other two
    channels; floor: units of opponents that keep the correlation of even surfaces down; even: added to the
    sum of the channels' weights, which lowers objects without texture; few: number of visible pairs at which
    colours count half."""

    color: float = 1.0
    contrast: float = 0.6
    lightness: float = 0.4
    floor: float = DEFAULT_WEIGHTS.color_floor
    even: float = PLAIN
    few: float = 10.0


DEFAULT_PAIR_WEIGHTS = PairWeights()


def pair_picture(model: ReferenceModel, crop: Crop, depth_m: float) -> PairPicture:
    """The crop's colours at the scale of the model's fine reference views, for an object at `depth_m`."""
    h, w = crop.depth.shape
    color = crop.color
    scale = model.pairs.parameters["fine_pixels_per_m"] * depth_m / crop.camera.fx
    if scale < 1.0:
        size = (max(round(w * scale), 2), max(round(h * scale), 2))
        color = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
    return PairPicture(opponents_of_bytes(color), w / color.shape[1], h / color.shape[0])


def pair_score_many(
    model: ReferenceModel,
    region: Region,
    picture: PairPicture,
    poses: Float,
    pairs: int = 600,
    samples: int = 300,
    weights: PairWeights = DEFAULT_PAIR_WEIGHTS,
) -> Float64:
    """Judge poses (M, 4, 4) by at most `pairs` of the model's pairs and `samples` of its surface: (M, 5), the
    total, geometry plus weighted colours, comparable between poses on the same pixels; geometry, the dense
    score without colour; color, contrast, correlations (-1..1), lowered where there is little to go by; the
    number of pairs that were compared."""
    out = np.zeros((len(poses), PAIR_TERMS + 1))
    on = judged_on(model, region, picture, pairs, samples, weights)
    _score_all(np.ascontiguousarray(poses, dtype=np.float64), on, scratch(samples), out)
    return out


def judged_on(
    model: ReferenceModel,
    region: Region,
    picture: PairPicture,
    pairs: int,
    samples: int,
    weights: PairWeights = DEFAULT_PAIR_WEIGHTS,
) -> Judged:
    """At most `pairs` of the model's pairs and `samples` of its surface, and the picture, for the kernel."""
    return Judged(
        model_arrays(model),
        region_arrays(region),
        samples,
        weight_array(GEOMETRY),
        pair_arrays(model.pairs, pairs),
        picture,
        pair_weight_array(weights),
    )


def pair_arrays(reference: PairReference, count: int) -> PairArrays:
    """At most `count` of a model's fine pairs, evenly spread."""
    first = int(reference.parameters["coarse_pairs"])
    step = max(1, -(-(len(reference.points) - first) // count))
    rows = slice(first, None, step)
    return PairArrays(
        np.ascontiguousarray(reference.points[rows]),
        np.ascontiguousarray(reference.normals[rows]),
        np.ascontiguousarray(reference.tangents[rows]),
        np.ascontiguousarray(_fine_opponents(reference)[::step]),  # of one type, however many there are
        REACH_PX / reference.parameters["fine_pixels_per_m"],
    )


def _fine_opponents(reference: PairReference) -> Float32:
    """Colours (N, 2, 3) of the fine pairs as opponents, made once for each model."""
    with _lock:
        found = _opponents.get(reference)
        if found is None:
            first = int(reference.parameters["coarse_pairs"])
            found = _opponents[reference] = opponents_of_lab(reference.colors[first:])
        return found


def pair_weight_array(weights: PairWeights) -> Float64:
    """The weights as kernels read them, in the order of PairWeights."""
    w = weights
    return np.array([w.color, w.contrast, w.lightness, w.floor, w.even, w.few])


@jit
def _score_all(poses: Float64, on: Judged, room: Room, out: Float64) -> None:
    for i in range(poses.shape[0]):
        pair_kernel(poses[i], on, room, -np.inf)
        out[i] = room.out
