"""How poses that score nearly alike are told apart."""

from __future__ import annotations

from dataclasses import dataclass, field

from huepose.judge.terms import ScoreWeights


@dataclass(frozen=True)
class NearTieWeights:
    """What each term of a contest weighs.

    dense: how far behind the first by total (never over 0); detail, broad: how well the
    texture's detail and its broader parts explain the same pixels; pairs: the pairs' colours.

    Origin: fitted, `studies.near_ties --fit` on drawn heaps, path-traced piles and real frames, some of them
    those of docs/accuracy.md, near the largest likelihood that the right contender wins (a softmax of their
    weighted sums). Fitted on drawn frames alone they lose 3.4 points of ADD on path-traced piles.
    """

    dense: float = 1.0
    detail: float = 1.5
    broad: float = 6.5
    pairs: float = 0.6


@dataclass(frozen=True)
class CloseLookConfig:
    """How a pose is refined on detail and outline. Origin of all numbers: chosen.

    weights: of the dense score with detail and blunt colours; these count alike, and more than at first
    sight. rim_weight: of the agreement of the outline with the picture's edges, in units of the total.
    steps_deg: of the search, from coarse to fine, in degrees of turn at the object's surface.
    samples: of the surface. tolerances: depth may be so many of the region's tolerances off a pose where
    textures are compared: they are compared on the surface, not on what lies before or behind it.
    room_px: round the poses in the picture that is looked at.
    """

    weights: ScoreWeights = field(default_factory=lambda: ScoreWeights(color=1.5, coarse=1.0))
    rim_weight: float = 0.75
    steps_deg: tuple[float, ...] = (3.0, 1.5, 0.7, 0.35)
    samples: int = 600
    tolerances: float = 1.5
    room_px: float = 10.0


@dataclass(frozen=True)
class NearTieConfig:
    """When poses are near ties, and how they are weighed.

    contenders: most poses that are looked at closely. within: a pose contends when its total is this close to
    the best: noise and light move totals as far. Origin: chosen, with time in mind.

    share: a weighed difference of one says as much
    as a difference of this of the total. Origin: chosen, so that quality reads both alike.
    """

    contenders: int = 4
    within: float = 0.12
    weights: NearTieWeights = NearTieWeights()
    share: float = 0.35
    close: CloseLookConfig = field(default_factory=CloseLookConfig)
