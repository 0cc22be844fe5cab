"""Settings for near ties: poses of one object that score nearly alike."""

from __future__ import annotations

from dataclasses import dataclass, field

from huepose.judge.terms import ScoreWeights


@dataclass(frozen=True)
class NearTieWeights:
    """Weights of the terms between poses in a near tie.

    dense: distance to the first in the dense score, at most 0.
    detail, broad: how well fine and broader texture explain the same pixels.
    pairs: agreement of the colour pairs.

    Fitted on drawn heaps, path-traced piles and real frames, some of them those of docs/accuracy.md, to the
    largest likelihood that the right pose wins (softmax of the weighted sums).
    Fitted on drawn frames alone they lose 3.4 points of ADD on path-traced piles.
    """

    dense: float = 1.0
    detail: float = 1.5
    broad: float = 6.5
    pairs: float = 0.6


@dataclass(frozen=True)
class CloseLookConfig:
    """How a pose is refined on texture detail and outline before near ties are decided. All numbers chosen.

    weights: of the dense score on detail and blunt colours, which count alike, and more than in the first
    score.
    rim_weight: of the agreement of outline and picture edges, in units of the total.
    steps_deg: steps of the coordinate search, coarse to fine, degrees of rotation at the object's surface.
    samples: most surface samples.
    tolerances: textures are compared where depth is within this many of the region's tolerances of the pose.
    room_px: margin around the poses in the picture, pixels.
    """

    weights: ScoreWeights = field(default_factory=lambda: ScoreWeights(color=1.5, coarse=1.0))
    rim_weight: float = 0.75
    steps_deg: tuple[float, ...] = (3.0, 1.5, 0.7, 0.35)
    samples: int = 600
    tolerances: float = 1.5
    room_px: float = 10.0


@dataclass(frozen=True)
class NearTieConfig:
    """When poses are in a near tie, and how it is decided.

    contenders: most poses that get a close look. Chosen, with time in mind.
    within: a pose contends when its total is this close to the best; noise and light change totals as much.
    Chosen.
    weights: of the terms.
    share: factor from a weighted difference of the terms to a difference of the total. Chosen, so that
    quality reads both alike.
    """

    contenders: int = 4
    within: float = 0.12
    weights: NearTieWeights = NearTieWeights()
    share: float = 0.35
    close: CloseLookConfig = field(default_factory=CloseLookConfig)
