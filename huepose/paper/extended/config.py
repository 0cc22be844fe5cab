"""How much the method of colour pairs tries."""

from __future__ import annotations

from dataclasses import dataclass, field

from huepose.paper.extended.hypotheses import HypothesesConfig


@dataclass(frozen=True)
class ColorpairPathConfig:
    """How much the colour-pair path tries. refined: hypotheses a mask that are registered; shapes: of them
    starts from shape alone, at most, where colours propose too few, 0 for none; kept: different ones after
    that; with_near_symmetries: of them whose near-symmetric rotations are tried; searched: poses a mask that
    are searched; finished: poses searched finely in the end; alternatives: different poses that are returned.
    semantic: whether semantic ICP adds a pose to each of the best different ones; hypotheses: what votes,
    and under which lights."""

    refined: int = 30
    shapes: int = 20
    kept: int = 8
    with_near_symmetries: int = 5
    searched: int = 8
    finished: int = 3
    alternatives: int = 6
    semantic: bool = True
    hypotheses: HypothesesConfig = field(default_factory=HypothesesConfig)
