"""The dense score of a pose: does the object at this pose explain depth and colours of a region?

The visible surface samples are compared with the image (depth at the surface, free space, the texture's
colours), and the mask points with the surface (is the mask explained?). Colours are compared by correlation
of opponents at two scales, so that the light's colour and strength do not matter; lightness is compared after
shading is removed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.judge.kernel import SCRATCH_ROWS, TERMS, score_kernel
from huepose.judge.kernel_arrays import ModelArrays, RegionArrays, model_arrays, region_arrays
from huepose.judge.region import Region
from huepose.judge.weights import DEFAULT_WEIGHTS, ScoreWeights
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit

CLOSE_SAMPLES = 800
"""Largest number of surface samples when poses are judged closely: 0.5 % of noise in a share of the
surface."""


@dataclass(frozen=True)
class Terms:
    """What a pose explains of a region. Shares (0..1) are of the visible surface, weighted by the cosine of
    the viewing angle.

    total: weighted sum; about 0 for nonsense, 3 for a perfect view through a right mask, 1.9 without a mask
    (open regions).
    depth_fit 0..1: agreement with depth, where the surface is not occluded and has a reading.
    coverage 0..1: share of the mask that the surface explains.
    violation 0..1: share with a free-space violation, plus half of the share that penetrates something or
    lies behind what is believed to be the object.
    color -1..1: correlation of texture and image without the light, lowered where there is little texture.
    occluded 0..1: something that is not believed to be the object is in front.
    seen 0..1: depth agrees. box_iou 0..1: of the pose's bounds and the given box.
    through 0..1: the free-space part of violation. hidden 0..1: anything is in front.
    blind 0..1: no depth reading. outside 0..1: outside the image.
    contrast: opponent units of texture in view.
    light_l, light_rg, light_yb: mean colour of the image minus that of the texture.
    colored 0..1: seen in colour.
    """

    total: float
    depth_fit: float
    coverage: float
    violation: float
    color: float
    occluded: float
    seen: float
    box_iou: float
    through: float
    hidden: float
    blind: float
    outside: float
    contrast: float
    light_l: float
    light_rg: float
    light_yb: float
    colored: float

    @property
    def light(self) -> tuple[float, float, float]:
        """Offset (3,) that the light adds to opponents, from the mean colours; zeros where no colour was
        seen."""
        return self.light_l, self.light_rg, self.light_yb

    @staticmethod
    def of(row: Float64) -> Terms:
        """The terms of a pose, from its row (17,) of `score_many`."""
        return Terms(*row.tolist())


NOTHING = Terms(*(0.0,) * 11, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""The terms of a pose outside the image."""


def score(model: ReferenceModel, region: Region, T_cam_obj: Float) -> Terms:
    """Judge one pose T_cam_obj (4, 4) in a region, closely."""
    return Terms.of(score_many(model, region, T_cam_obj[None], CLOSE_SAMPLES)[0])


def score_many(model: ReferenceModel, region: Region, poses: Float, samples: int) -> Float64:
    """Judge poses (M, 4, 4) with at most `samples` surface samples in one compiled call: (M, 17), columns in
    the order of the fields of Terms."""
    return score_arrays(model_arrays(model), region_arrays(region), poses, samples)


def score_arrays(model: ModelArrays, region: RegionArrays, poses: Float, samples: int) -> Float64:
    """`score_many` on arrays that are already bundled for the kernels: (M, 17)."""
    out = np.zeros((len(poses), TERMS))
    _score_all(np.ascontiguousarray(poses, dtype=np.float64), model, region, samples, DEFAULT_WEIGHTS, out)
    return out


def totals(model: ReferenceModel, region: Region, poses: Float) -> Float64:
    """Totals (M,) of poses (M, 4, 4), with CLOSE_SAMPLES surface samples."""
    return score_many(model, region, poses, CLOSE_SAMPLES)[:, 0]


@jit
def _score_all(
    poses: Float64,
    model: ModelArrays,
    region: RegionArrays,
    samples: int,
    weights: ScoreWeights,
    out: Float64,
) -> None:
    scratch = np.empty((SCRATCH_ROWS, samples))
    for i in range(poses.shape[0]):
        score_kernel(poses[i], model, region, samples, weights, scratch, out[i], -np.inf)
