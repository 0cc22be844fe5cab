"""The dense score of a pose: does this object, there, explain the depth and the colours of a region?

Samples of the model's surface that the pose shows are compared with the image (depth where the surface
should be, nothing in front of it that we see through, the print's colours), and points of the mask with the
surface (is the mask explained?). Colours are compared by the correlation of their opponents with the
texture's at two scales, so that the light's colour and strength do not matter; lightness also after shading
is taken off.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import lru_cache

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.judge.arrays import ModelArrays, RegionArrays, model_arrays, region_arrays
from huepose.judge.kernel import SCRATCH_ROWS, TERMS, score_kernel
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit

CLOSE_SAMPLES = 800
"""Surface samples by which single poses are judged; 0.5 % of noise in a share of the surface."""


@dataclass(frozen=True)
class ScoreWeights:
    """What each term weighs. `lightness` and `coarse` are relative weights of lightness against the other two
    channels and of the 3.5 mm scale against the 1 mm scale, `outside` of depth that fits outside the mask,
    `color_floor` (units of opponents) keeps the correlation of even surfaces down."""

    depth_fit: float = 0.9
    coverage: float = 0.7
    violation: float = 1.0
    color: float = 1.0
    occluded: float = 0.05
    box: float = 0.5
    lightness: float = 0.8
    coarse: float = 0.5
    outside: float = 0.6
    color_floor: float = 1.5


DEFAULT_WEIGHTS = ScoreWeights()


@dataclass(frozen=True)
class PoseScore:
    """total: the weighted sum, about 0 for nonsense to 3 for a perfect view; depth_fit, coverage, violation,
    occluded, seen, box_iou in 0..1; color in -1..1 (a correlation, lowered where the object has no print)."""

    total: float
    depth_fit: float
    coverage: float
    violation: float
    color: float
    occluded: float
    seen: float
    box_iou: float


def weight_array(weights: ScoreWeights) -> Float64:
    """The weights as the kernels read them, in the order of ScoreWeights."""
    return np.array(_numbers(weights), dtype=np.float64)


@lru_cache(maxsize=64)
def _numbers(weights: ScoreWeights) -> tuple[float, ...]:
    """`astuple` copies deeply, which takes longer than to judge a pose."""
    return astuple(weights)


def score(
    model: ReferenceModel,
    region: Region,
    T_cam_obj: Float,
    samples: int = 800,
    weights: ScoreWeights = DEFAULT_WEIGHTS,
) -> PoseScore:
    """Judge one pose (4, 4) in a region by at most `samples` surface samples."""
    return PoseScore(*(float(x) for x in score_many(model, region, T_cam_obj[None], samples, weights)[0]))


def score_many(
    model: ReferenceModel,
    region: Region,
    poses: Float,
    samples: int = 800,
    weights: ScoreWeights = DEFAULT_WEIGHTS,
) -> Float64:
    """Judge poses (M, 4, 4) in one compiled call: (M, 8), columns in the order of PoseScore's fields."""
    out = np.zeros((len(poses), TERMS))
    _score_all(
        np.ascontiguousarray(poses, dtype=np.float64),
        model_arrays(model),
        region_arrays(region),
        samples,
        weight_array(weights),
        out,
    )
    return out


def totals(model: ReferenceModel, region: Region, poses: Float) -> Float64:
    """Totals (M,) of poses (M, 4, 4), looked at closely."""
    return score_many(model, region, poses, CLOSE_SAMPLES)[:, 0]


@jit
def _score_all(
    poses: Float64, model: ModelArrays, region: RegionArrays, samples: int, weights: Float64, out: Float64
) -> None:
    scratch = np.empty((SCRATCH_ROWS, samples))
    for i in range(poses.shape[0]):
        score_kernel(poses[i], model, region, samples, weights, scratch, out[i], -np.inf)
