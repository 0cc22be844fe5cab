"""Poses from colour pairs: light, classes, votes of three kinds, plausibility, clusters (paper, section
III-C).

Votes come from single pairs as frames and from triangles of three classes; where fewer than three classes
are in sight, from point pairs with classes too. All are asked under each of the few lights that could
explain the scene's colours, weighed by whether depth allows them, and clustered together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from huepose.colorpair.extract import ExtractionConfig, extract
from huepose.colorpair.lifting import lift
from huepose.colorpair.light import relit
from huepose.colorpair.types import ColorPairs, SurfacePairs
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.pairs import reference_pairs
from huepose.model.types import PairReference, ReferenceModel
from huepose.paper.classes import ClassConfig, classified
from huepose.paper.cloud import ClassifiedCloud
from huepose.paper.frames import FrameConfig, frame_votes
from huepose.paper.light import LightConfig, lights_of
from huepose.paper.plausible import plausible
from huepose.paper.ppf import PpfConfig, ppf_votes
from huepose.paper.triangles import TriangleConfig, triangle_votes
from huepose.paper.voting import VotingConfig, cluster
from huepose.propose.types import Hypothesis, Votes

NEEDED_CLASSES, NEEDED_POINTS = 3, 30
"""Triangles need three classes, each with so many points in sight; where fewer are, point pairs are asked."""


@dataclass(frozen=True)
class HypothesesConfig:
    """scene_pairs: most that are used; each source of votes can be switched off with None (`ppf`, the
    fallback, for legal reasons: see its module)."""

    scene_pairs: int = 220
    light: LightConfig = field(default_factory=LightConfig)
    classes: ClassConfig = field(default_factory=ClassConfig)
    frames: FrameConfig | None = field(default_factory=FrameConfig)
    triangles: TriangleConfig | None = field(default_factory=TriangleConfig)
    ppf: PpfConfig | None = field(default_factory=PpfConfig)
    voting: VotingConfig = field(default_factory=VotingConfig)


@dataclass(frozen=True, eq=False)
class Reading:
    """The scene's pairs read under one light. light (3,): gains (see `colorpair.light`); share: of the
    pairs that it explains, 0..1; pairs: on the surface, camera axes, colours as under the model's light;
    cloud: their two sides, classified."""

    light: Float64
    share: float
    pairs: SurfacePairs
    cloud: ClassifiedCloud


def extract_at_model_scale(
    pairs: PairReference, frame: RgbdFrame, mask: Bool, config: ExtractionConfig | None = None
) -> ColorPairs:
    """Colour pairs of a mask (H, W), extracted at the scale at which the model's were.

    Empty when no pixel of the mask has depth.
    """
    depths = frame.depth[mask & (frame.depth > 0)]
    if not len(depths):
        return ColorPairs.empty()
    scale = pairs.parameters["coarse_pixels_per_m"] * float(np.median(depths)) / frame.camera.fx
    return extract(frame.color, mask, config, scale=min(scale, 1.0))


def hypotheses_of(
    model: ReferenceModel,
    readings: Sequence[Reading],
    frame: RgbdFrame,
    mask: Bool,
    config: HypothesesConfig,
    rng: np.random.Generator,
) -> list[Hypothesis]:
    """Likely poses of a model from the readings of a mask (H, W), best first, before any refinement.

    Empty without readings: `paper.shape` has starts for that case.
    """
    if not readings:
        return []
    first = [v for r in readings for v in _first_votes(model, r, config, rng)]
    votes = plausible(Votes.joined(first), model.surface, frame.depth, mask, frame.camera, model.diameter_m)
    in_sight = max(classes_in_sight(r.cloud) for r in readings)
    if config.ppf is not None and (not first or in_sight < NEEDED_CLASSES):
        fallback = Votes.joined([_ppf_votes(model, r, config.ppf, rng) for r in readings])
        more = plausible(fallback, model.surface, frame.depth, mask, frame.camera, model.diameter_m)
        votes = Votes.joined([votes, more])
    return cluster(votes, model.mesh.centre, model.diameter_m, "pairs", config.voting, model.equivalents)


def read_scene(
    model: ReferenceModel,
    pairs: ColorPairs,
    frame: RgbdFrame,
    mask: Bool,
    config: HypothesesConfig,
    rng: np.random.Generator,
) -> list[Reading]:
    """The pairs of a mask (H, W) on their surface, under each light that could be, best first.

    Empty when there is no depth under the pairs, or when the model has none.
    """
    scene, _ = lift(pairs, frame.depth, mask, frame.camera)
    table = model.pairs
    reference = reference_pairs(table)
    if not len(scene) or not len(reference):
        return []
    scene = scene[rng.permutation(len(scene))[: config.scene_pairs]]
    readings = []
    for light, share in lights_of(scene.colors, reference.colors, rng, config.light):
        relit_scene = replace(scene, colors=relit(scene.colors, 1.0 / light))
        cloud = classified(
            relit_scene,
            reference,
            table.side_classes[: len(reference)],
            len(table.centers),
            table.parameters["side_offset_m"],
            config.classes,
        )
        readings.append(Reading(light, share, relit_scene, cloud))
    return readings


def warm_up(models: Sequence[ReferenceModel], config: HypothesesConfig) -> None:
    """Compile the fallback, which most pictures do without, on the cloud of the first model that has a
    table for it."""
    model = next((m for m in models if len(m.pairs.ppf_keys)), None)
    if config.ppf is not None and model is not None:
        seen = Reading(np.ones(3), 1.0, reference_pairs(model.pairs), reference_cloud(model.pairs))
        _ppf_votes(model, seen, config.ppf, np.random.default_rng(0))


def classes_in_sight(cloud: ClassifiedCloud) -> int:
    """How many classes have enough points for triangles."""
    return int((np.bincount(cloud.classes, minlength=1) >= NEEDED_POINTS).sum())


def reference_cloud(reference: PairReference) -> ClassifiedCloud:
    """The model's classified cloud."""
    return ClassifiedCloud(
        reference.cloud_points, reference.cloud_normals, reference.cloud_classes, reference.cloud_weights
    )


def _first_votes(
    model: ReferenceModel, reading: Reading, config: HypothesesConfig, rng: np.random.Generator
) -> list[Votes]:
    table, votes = model.pairs, []
    if config.frames is not None:
        votes.append(frame_votes(reading.pairs, reference_pairs(table), config.frames))
    if config.triangles is not None:
        votes.append(
            triangle_votes(
                reading.cloud,
                reference_cloud(table),
                table.triangle_keys,
                table.triangles,
                table.parameters["triangle_bin_m"],
                config.triangles,
                rng,
            )
        )
    return votes


def _ppf_votes(model: ReferenceModel, reading: Reading, config: PpfConfig, rng: np.random.Generator) -> Votes:
    table = model.pairs
    return ppf_votes(
        reading.cloud,
        reference_cloud(table),
        table.ppf_keys,
        table.ppf,
        table.ppf_alpha,
        table.parameters["ppf_bin_m"],
        model.diameter_m,
        config,
        rng,
    )
