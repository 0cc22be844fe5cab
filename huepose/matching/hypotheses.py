"""Poses from colour pairs: light, classes, votes of three kinds, plausibility, clusters (paper, section
III-C).

Votes come from triangles of three classes, from point pairs with classes, and from single pairs as frames.
All are asked under each of the few lights that could explain the scene's colours, weighed by whether depth
allows them, and clustered together.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from huepose.colorpair.extract import ExtractionConfig, extract
from huepose.colorpair.lifting import lift
from huepose.colorpair.light import relit
from huepose.colorpair.types import ColorPairs, SurfacePairs
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.matching.classes import ClassConfig, classified
from huepose.matching.cloud import ClassifiedCloud
from huepose.matching.frames import FrameConfig, frame_votes
from huepose.matching.light import LightConfig, lights_of
from huepose.matching.plausible import plausible
from huepose.matching.ppf import PpfConfig, ppf_votes
from huepose.matching.triangles import TriangleConfig, triangle_votes
from huepose.matching.types import Hypothesis, Votes
from huepose.matching.voting import VotingConfig, cluster
from huepose.model.types import PairReference, ReferenceModel


@dataclass(frozen=True)
class HypothesesConfig:
    """scene_pairs: most that are used; each source of votes can be switched off with None (`ppf` for legal
    reasons, see its module)."""

    scene_pairs: int = 220
    light: LightConfig = field(default_factory=LightConfig)
    classes: ClassConfig = field(default_factory=ClassConfig)
    frames: FrameConfig | None = field(default_factory=FrameConfig)
    triangles: TriangleConfig | None = field(default_factory=TriangleConfig)
    ppf: PpfConfig | None = field(default_factory=PpfConfig)
    voting: VotingConfig = field(default_factory=VotingConfig)


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


def colorpair_hypotheses(
    model: ReferenceModel,
    pairs: ColorPairs,
    frame: RgbdFrame,
    mask: Bool,
    config: HypothesesConfig | None = None,
    rng: np.random.Generator | None = None,
) -> list[Hypothesis]:
    """Likely poses of a model from the colour pairs of a mask (H, W), best first, before any refinement.

    The sources are told apart where only one took part: "triangles", "ppf", "frames"; together: "pairs".
    """
    config = config or HypothesesConfig()
    rng = rng or np.random.default_rng(0)
    scene, _ = lift(pairs, frame.depth, mask, frame.camera)
    reference = reference_pairs(model.pairs)
    if not len(scene) or not len(reference):
        return []
    scene = scene[rng.permutation(len(scene))[: config.scene_pairs]]
    lights = lights_of(scene.colors, reference.colors, rng, config.light)
    votes = Votes.joined(
        [
            vote
            for light, _ in lights
            for vote in _votes(model, relit_pairs(scene, light), reference, config, rng)
        ]
    )
    votes = plausible(votes, model.surface, frame.depth, mask, frame.camera, model.diameter_m)
    return cluster(votes, model.mesh.centre, model.diameter_m, _source(config), config.voting)


def reference_pairs(reference: PairReference) -> SurfacePairs:
    """The model's coarse pairs, in the object's frame."""
    n = int(reference.parameters["coarse_pairs"])
    return SurfacePairs(
        reference.points[:n], reference.normals[:n], reference.tangents[:n], reference.colors[:n]
    )


def reference_cloud(reference: PairReference) -> ClassifiedCloud:
    """The model's classified cloud."""
    return ClassifiedCloud(
        reference.cloud_points, reference.cloud_normals, reference.cloud_classes, reference.cloud_weights
    )


def relit_pairs(scene: SurfacePairs, light: Float64) -> SurfacePairs:
    """Scene pairs as they would look under the model's light, given the scene's light (3,) as a gain."""
    return replace(scene, colors=relit(scene.colors, 1.0 / light))


def _votes(
    model: ReferenceModel,
    scene: SurfacePairs,
    reference: SurfacePairs,
    config: HypothesesConfig,
    rng: np.random.Generator,
) -> list[Votes]:
    table, out = model.pairs, []
    if config.frames is not None:
        out.append(frame_votes(scene, reference, config.frames))
    if config.triangles is None and config.ppf is None:
        return out
    cloud, known = (
        classified(
            scene,
            reference,
            table.side_classes[: len(reference)],
            len(table.centers),
            table.parameters["side_offset_m"],
            config.classes,
        ),
        reference_cloud(table),
    )
    if config.triangles is not None:
        out.append(
            triangle_votes(
                cloud,
                known,
                table.triangle_keys,
                table.triangles,
                table.parameters["triangle_bin_m"],
                config.triangles,
                rng,
            )
        )
    if config.ppf is not None:
        out.append(
            ppf_votes(
                cloud,
                known,
                table.ppf_keys,
                table.ppf,
                table.ppf_alpha,
                table.parameters["ppf_bin_m"],
                model.diameter_m,
                config.ppf,
                rng,
            )
        )
    return out


def _source(config: HypothesesConfig) -> str:
    used = [name for name in ("frames", "triangles", "ppf") if getattr(config, name) is not None]
    return used[0] if len(used) == 1 else "pairs"
