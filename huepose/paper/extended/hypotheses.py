"""Poses from colour pairs: light, classes, votes of three kinds, plausibility, clusters (paper, section
III-C).

Votes come from single pairs as frames and from triangles of three classes; if fewer than three classes are
visible, also from point pairs with classes. All sources vote under each of the few lights that could explain
the scene's colours. Votes are weighted by their plausibility in depth and clustered together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from huepose.colorpair.lifting import lift
from huepose.colorpair.types import ColorPairs, SurfacePairs
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel, reference_pairs
from huepose.paper.cloud import ClassifiedCloud
from huepose.paper.extended.frames import frame_votes
from huepose.paper.extended.light import lights_of, relit
from huepose.paper.extended.plausible import plausible
from huepose.paper.ppf import ppf_votes
from huepose.paper.scene import NEEDED_CLASSES, classes_in_sight, classified_scene
from huepose.paper.tables import tables_of
from huepose.paper.triangles import triangle_votes
from huepose.paper.votes import Votes
from huepose.paper.voting import NO_POSES, cluster

SCENE_PAIRS = 220
"""Largest number of a scene's pairs that are used."""

FACING = 0.8
"""Smallest mean cosine between the normals of matched triangles; in the paper they need not agree."""


@dataclass(frozen=True)
class HypothesesConfig:
    """light: False uses the scene's colours as they are. Each source of votes can be switched off (`ppf`, the
    fallback, for legal reasons: see `paper.ppf`)."""

    light: bool = True
    frames: bool = True
    triangles: bool = True
    ppf: bool = True


@dataclass(frozen=True, eq=False)
class Reading:
    """The scene's pairs, corrected for one light. pairs: on the surface, camera axes, colours as under the
    model's light; cloud: their two sides, classified."""

    pairs: SurfacePairs
    cloud: ClassifiedCloud


def hypotheses_of(
    model: ReferenceModel,
    readings: Sequence[Reading],
    frame: RgbdFrame,
    mask: Bool,
    config: HypothesesConfig,
    rng: np.random.Generator,
) -> Float64:
    """Poses (K, 4, 4) of a model from the readings of a mask (H, W), best first, not yet refined.

    Empty without readings: then `paper.extended.shape` can propose start poses.
    """
    if not readings:
        return NO_POSES[0]
    first = [v for r in readings for v in _first_votes(model, r, config, rng)]
    votes = plausible(Votes.joined(first), model.surface, frame.depth, mask, frame.camera, model.diameter_m)
    in_sight = max(classes_in_sight(r.cloud) for r in readings)
    if config.ppf and (not first or in_sight < NEEDED_CLASSES):
        tables = tables_of(model)
        fallback = Votes.joined([ppf_votes(r.cloud, tables, model.diameter_m, rng) for r in readings])
        more = plausible(fallback, model.surface, frame.depth, mask, frame.camera, model.diameter_m)
        votes = Votes.joined([votes, more])
    return cluster(votes, model.mesh.centre, model.diameter_m, model.equivalents)[0]


def read_scene(
    model: ReferenceModel,
    pairs: ColorPairs,
    frame: RgbdFrame,
    mask: Bool,
    config: HypothesesConfig,
    rng: np.random.Generator,
) -> list[Reading]:
    """The pairs of a mask (H, W) on their surface, under each possible light, best first.

    Empty if there is no depth at the pairs, or if the model has no pairs.
    """
    scene = lift(pairs, frame.depth, mask, frame.camera)
    reference = reference_pairs(model.pairs)
    if not len(scene) or not len(reference):
        return []
    scene = scene[rng.permutation(len(scene))[:SCENE_PAIRS]]
    lights = [np.ones(3)]
    if config.light:
        lights = [light for light, _ in lights_of(scene.colors, reference.colors, rng)]
    readings = []
    for light in lights:
        relit_scene = replace(scene, colors=relit(scene.colors, 1.0 / light))
        cloud = classified_scene(model, relit_scene)
        readings.append(Reading(relit_scene, cloud))
    return readings


def _first_votes(
    model: ReferenceModel, reading: Reading, config: HypothesesConfig, rng: np.random.Generator
) -> list[Votes]:
    votes = []
    if config.frames:
        votes.append(frame_votes(reading.pairs, reference_pairs(model.pairs)))
    if config.triangles:
        votes.append(triangle_votes(reading.cloud, tables_of(model), FACING, rng))
    return votes
