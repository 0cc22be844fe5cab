"""Training samples for the rotation network: matched points of a textured object before and after a motion.

The functions of the paper's tracker make the samples from two rendered images of the object: optical flow,
matches confirmed by the mask and by colour pairs, lifting to 3D. So flow has the same errors as in tracking.
The true motion is known.
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
from huepose.paper.rotation_network import Kind, canonical_input, fixed_count
from huepose.paper.tracking import GROWTH
from huepose.propose.flow import Flow, compute, consistency
from huepose.training.shapes import random_object
from huepose.training.views import Props, ViewRange, Views, draw_views

PAIRS = ((0, 1), (3, 4), (1, 3), (2, 4), (0, 3), (2, 5), (0, 4), (1, 5), (0, 5))
"""Views that are matched, in both directions: one to five frames apart, as in the paper's harder protocol."""

SEQUENCES = 3
"""Sequences of each object."""

MIN_PIXELS = 200
"""Views in which fewer pixels show the object are not used."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Matches between two views, and the true motion T_b_a (4, 4)."""

    matches: LiftedMatches
    T_b_a: Float64


def render_motions(
    rng: np.random.Generator, props: Props, ranges: ViewRange | None = None
) -> Iterator[Motion]:
    """The motions in the sequences of one random object."""
    ranges = ViewRange() if ranges is None else ranges
    mesh = random_object(rng, rng.uniform(*ranges.diameter_m))
    for _ in range(SEQUENCES):
        yield from motions_of(draw_views(rng, mesh, props, GROWTH, ranges))


def motions_of(views: Views) -> Iterator[Motion]:
    """The pairs of views with enough matches, in both directions."""
    visible = [mask.sum() >= MIN_PIXELS for mask in views.masks]
    images = [f.color for f in views.frames]
    pairs = [pairs_to_follow(*each) for each in zip(images, views.masks, strict=True)]
    for i, j in PAIRS:
        if not (visible[i] and visible[j]):
            continue
        flow = compute(views.frames[i].color, views.frames[j].color, views.boxes[i].grown(GROWTH))
        if flow is None:
            continue
        back = Flow(flow.backward, flow.forward, consistency(flow.backward, flow.forward), flow.x0, flow.y0)
        for a, b, a_to_b in ((i, j, flow), (j, i, back)):
            before, after = views.frames[a], views.frames[b]
            found = match(before.color, after.color, views.masks[a], a_to_b, pairs=pairs[a])
            matches = lift_matches(before, after, found)
            if len(matches) >= MIN_INLIERS:
                T_b_a = se3.compose(views.T_cam_obj[b], se3.inverse(views.T_cam_obj[a]))
                yield Motion(matches, T_b_a)


@dataclass(frozen=True, eq=False)
class RotationSample:
    """features (128, 15), weights (128,): the network's input; R_canon (3, 3): its true output."""

    features: Float32
    weights: Float32
    R_canon: Float32


def sample_of(motion: Motion, kind: Kind) -> RotationSample | None:
    """The network's input for a motion, as in the tracker, with the true output; None if the closed form
    finds no motion (kind "residual")."""
    given = canonical_input(motion.matches, kind)
    if given is None:
        return None
    features, weights = fixed_count(given.clouds.features, motion.matches.weights)
    residual = motion.T_b_a[:3, :3] @ given.R_first.T
    return RotationSample(features, weights, given.clouds.canonical_rotation(residual).astype(np.float32))


def endless(seed: int, stream: int, kinds: Sequence[Kind]) -> Iterator[list[RotationSample]]:
    """Motions without end, each as a sample of every kind; the same seed and stream give the same ones.
    Neighbouring samples share an object: shuffle them."""
    rng = np.random.default_rng([seed, stream])
    props = Props(rng)
    while True:
        for motion in render_motions(rng, props):
            samples = [sample_of(motion, kind) for kind in kinds]
            known = [sample for sample in samples if sample is not None]
            if len(known) == len(kinds):
                yield known
