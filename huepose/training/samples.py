"""Questions with answers for the rotation network, endlessly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float32
from huepose.paper.rotation_network import Kind, fixed_count, posed
from huepose.propose.relative_pose import RobustKabsch
from huepose.training.turns import Turn, TurnRange, draw_turns


@dataclass(frozen=True, eq=False)
class RotationSample:
    """features (128, 15), weights (128,) as the network gets them; R_canon (3, 3) that it has to answer."""

    features: Float32
    weights: Float32
    R_canon: Float32


def sample_of(turn: Turn, kind: Kind) -> RotationSample | None:
    """The question that the tracker would ask about a turn, with its true answer."""
    question = posed(turn.matches, kind, RobustKabsch())
    if question is None:
        return None
    features, weights = fixed_count(question.seen.features, turn.matches.weights)
    left = turn.T_b_a[:3, :3] @ question.R_first.T
    return RotationSample(features, weights, question.seen.canonical_rotation(left).astype(np.float32))


def endless(seed: int, stream: int, kind: Kind, ranges: TurnRange | None = None) -> Iterator[RotationSample]:
    """Samples without end; the same seed and stream give the same ones. Neighbours share a shape: shuffle."""
    rng = np.random.default_rng([seed, stream])
    ranges = TurnRange() if ranges is None else ranges
    while True:
        for turn in draw_turns(rng, ranges):
            sample = sample_of(turn, kind)
            if sample is not None:
                yield sample
