"""Moments of tracking, made by code: matched points of a textured object before and after a motion.

Everything is as when the paper's method tracks: real optical flow on two pictures of the object, matches that
the mask and their colour pairs confirm, lifted to 3D, by the very functions that the tracker uses. So flow
errs here as it errs there. Each such turn is a question to the rotation network, whose true answer is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.kabsch import MIN_INLIERS
from huepose.paper.correspondences import match, pairs_to_follow
from huepose.paper.relative_pose import LiftedMatches, lift_matches
from huepose.paper.rotation_network import Kind, fixed_count, posed
from huepose.paper.tracking import GROWTH
from huepose.propose.flow import Flow, compute, consistency
from huepose.training.shapes import random_object
from huepose.training.views import Props, ViewRange, Views, draw_views

PAIRS = ((0, 1), (3, 4), (1, 3), (2, 4), (0, 3), (2, 5), (0, 4), (1, 5), (0, 5))
"""Views that are compared, both ways: from one frame apart to five, as in the paper's harder protocol."""

JOURNEYS = 3
"""So often an object is shown before another one is drawn."""

MIN_PIXELS = 200
"""An object that shows less is not followed."""


@dataclass(frozen=True, eq=False)
class Turn:
    """Matches of one moment, and the true motion T_b_a (4, 4)."""

    matches: LiftedMatches
    T_b_a: Float64


def draw_turns(rng: np.random.Generator, props: Props, ranges: ViewRange | None = None) -> Iterator[Turn]:
    """The moments of one object's journeys."""
    ranges = ViewRange() if ranges is None else ranges
    mesh = random_object(rng, rng.uniform(*ranges.diameter_m))
    for _ in range(JOURNEYS):
        yield from turns_of(draw_views(rng, mesh, props, GROWTH, ranges))


def turns_of(views: Views) -> Iterator[Turn]:
    """The pairs of views between which enough matches are found, there and back."""
    seen = [mask.sum() >= MIN_PIXELS for mask in views.masks]
    pictures = [f.color for f in views.frames]
    pairs = [pairs_to_follow(*each) for each in zip(pictures, views.masks, strict=True)]
    for i, j in PAIRS:
        if not (seen[i] and seen[j]):
            continue
        flow = compute(views.frames[i].color, views.frames[j].color, views.boxes[i].grown(GROWTH))
        if flow is None:
            continue
        back = Flow(flow.backward, flow.forward, consistency(flow.backward, flow.forward), flow.x0, flow.y0)
        for a, b, moved in ((i, j, flow), (j, i, back)):
            before, after = views.frames[a], views.frames[b]
            found = match(before.color, after.color, views.masks[a], moved, pairs=pairs[a])
            matches = lift_matches(before, after, found)
            if len(matches) >= MIN_INLIERS:
                T_b_a = se3.compose(views.T_cam_obj[b], se3.inverse(views.T_cam_obj[a]))
                yield Turn(matches, T_b_a)


@dataclass(frozen=True, eq=False)
class RotationSample:
    """features (128, 15), weights (128,) as the network gets them; R_canon (3, 3) that it has to answer."""

    features: Float32
    weights: Float32
    R_canon: Float32


def sample_of(turn: Turn, kind: Kind) -> RotationSample | None:
    """The question that the tracker would ask about a turn, with its true answer."""
    question = posed(turn.matches, kind)
    if question is None:
        return None
    features, weights = fixed_count(question.seen.features, turn.matches.weights)
    left = turn.T_b_a[:3, :3] @ question.R_first.T
    return RotationSample(features, weights, question.seen.canonical_rotation(left).astype(np.float32))


def endless(seed: int, stream: int, kinds: Sequence[Kind]) -> Iterator[list[RotationSample]]:
    """Turns without end, each as a sample of every kind; the same seed and stream give the same ones.
    Neighbours share an object: shuffle."""
    rng = np.random.default_rng([seed, stream])
    props = Props(rng)
    while True:
        for turn in draw_turns(rng, props):
            samples = [sample_of(turn, kind) for kind in kinds]
            known = [sample for sample in samples if sample is not None]
            if len(known) == len(kinds):
                yield known
