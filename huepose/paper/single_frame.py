"""The paper's method on a single frame (section III, A to D).

One mask > colour pairs > classified cloud > semantic triangles, or point pair features if fewer than three
classes are visible > two-stage Hough voting > semantic ICP > the refined pose with the best fit.

Not here, because the paper does not have it: an estimate of the light, votes of single pairs, a test of votes
against depth or of triangles by normals, near-symmetric rotations, a search on a score, dense colour, and
competition with other objects of the frame. The similarity (`colorpair.similarity`), which the method
`colorpair` and the paper's tracker share, differs from the paper in two points (figures:
docs/colour-pairs.md, "What differs from the paper"):

- III-A: the third corner of a pair's triangle is not black but L = -16. With black ADD falls by 1.0 and AUC
  by 2.9 points.
- III-A: a contrast below a floor has no direction. Without the floor the difference cannot be distinguished
  from chance.

What the paper leaves open, and what is done here:

- III, first paragraph: the mask is a segmenter's in the detector's box. Of several masks the first is used.
- III-C, "high-confidence matches": scene pairs whose best pair of classes has enough lead over the second
  (`paper.classes`).
- III-C, "a small, consistent set of initial alignments": the 30 strongest modes of the vote.
- III-D: correspondences are those of the classified clouds alone, as the aggregated cloud "combines all
  individual classes": depth between the edges is not used.
- III-D says how one pose is refined, not which refined pose is the answer: here the one with the largest
  weight of correspondences (`fitness_of`), which the ICP increases.
- The paper has no confidence. The fitness in 0..1 takes its place: it is not a probability, so a pose of this
  method is at most `SUSPECT`.
- Symmetric objects are treated like all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from huepose.colorpair.lifting import lift
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import PaperTables, ReferenceModel
from huepose.paper.cloud import ClassifiedCloud
from huepose.paper.ppf import ppf_votes
from huepose.paper.scene import (
    NEEDED_CLASSES,
    classes_in_sight,
    classified_scene,
    extract_at_model_scale,
    warm_up_point_pairs,
)
from huepose.paper.semantic_icp import AGGREGATE, SEMANTIC, semantic_icp_many
from huepose.paper.tables import tables_of
from huepose.paper.triangles import ANY_FACING, triangle_votes
from huepose.paper.votes import Votes
from huepose.paper.voting import NO_POSES, cluster
from huepose.propose.evidence import Evidence
from huepose.select.distinct import Ranked
from huepose.support.stages import stage

GATE = 0.06
"""Distance from which two points are no correspondence, in diameters of the model's cloud: the third of the
ICP's four gates, which tolerates the noise of depth. Not fitted."""


REFINED = 30
"""Initial alignments that are refined, the paper's "small, consistent set"."""


@dataclass(frozen=True)
class PaperConfig:
    """triangles, ppf: the sources of votes. Without triangles point pair features always vote. Why one may
    switch them off: see `paper.ppf`."""

    triangles: bool = True
    ppf: bool = True


class PaperMethod:
    """The method `paper` as the estimator runs it."""

    bare = True
    """Its best pose is the answer, unchanged."""

    def __init__(self, config: PaperConfig | None = None) -> None:
        self.config = config or PaperConfig()

    def check(self, model: ReferenceModel) -> None:
        """Raises InputError for a model without the tables of this method."""
        tables_of(model)

    def warm_up(self, models: Sequence[ReferenceModel]) -> None:
        """Compile what the first image may not need, but a later one does."""
        if self.config.ppf:
            warm_up_point_pairs(models)

    def poses(self, model: ReferenceModel, evidence: Evidence, rng: np.random.Generator) -> Ranked:
        """Poses by their fitness in 0..1, best first; none without pairs."""
        crop = evidence.region.crop
        frame = RgbdFrame(np.ascontiguousarray(crop.color), np.ascontiguousarray(crop.depth), crop.camera)
        return Ranked.of(*self.in_mask(model, frame, evidence.sources[0], rng))

    def in_mask(
        self, model: ReferenceModel, frame: RgbdFrame, mask: Bool, rng: np.random.Generator
    ) -> tuple[Float64, Float64]:
        """Poses (K, 4, 4) and their fitness (K,), best first, from a frame and the object's mask (H, W).
        Raises InputError for a model without tables."""
        tables = tables_of(model)
        with stage("extract"):
            pairs = extract_at_model_scale(model.pairs, frame, mask)
            scene = lift(pairs, frame.depth, mask, frame.camera)
        if not len(scene):
            return NO_POSES
        with stage("classes"):
            cloud = classified_scene(model, scene)
        with stage("votes"):
            votes = self._votes(model, cloud, rng)
            found, _ = cluster(votes, model.mesh.centre, model.diameter_m)
        if not len(found):
            return NO_POSES
        with stage("semantic_icp"):
            poses = semantic_icp_many(tables, cloud, found[:REFINED])
        with stage("judge"):
            fitness = fitness_of(tables, cloud, poses)
        order = np.argsort(-fitness, kind="stable")
        return poses[order], fitness[order]

    def _votes(self, model: ReferenceModel, cloud: ClassifiedCloud, rng: np.random.Generator) -> Votes:
        """Votes of triangles, or of point pairs if too few classes are visible for triangles."""
        config = self.config
        if config.triangles and (not config.ppf or classes_in_sight(cloud) >= NEEDED_CLASSES):
            return triangle_votes(cloud, tables_of(model), ANY_FACING, rng)
        return ppf_votes(cloud, tables_of(model), model.diameter_m, rng) if config.ppf else Votes.empty()


def fitness_of(tables: PaperTables, scene: ClassifiedCloud, poses: Float64) -> Float64:
    """How well a classified scene fits a model's classified cloud: what semantic ICP improves.

    Share (M,) of the scene's weight that has a correspondence at poses T_cam_obj (M, 4, 4). Each point counts
    by Tukey's biweight of its distance to the nearest model point of its class and to the nearest of any
    class, weighted as in the ICP. 0 without points."""
    model = np.asarray(tables.cloud_points, np.float64)
    weights = np.asarray(scene.weights, np.float64)
    if not len(model) or weights.sum() <= 0.0:
        return np.zeros(len(poses))
    centre = 0.5 * (model.min(0) + model.max(0))
    gate_m = GATE * 2.0 * float(np.linalg.norm(model - centre, axis=1).max())
    R, t = poses[:, :3, :3], poses[:, :3, 3]
    points = (np.asarray(scene.points, np.float64)[None] - t[:, None]) @ R  # object axes (M, N, 3)
    total = AGGREGATE * _kernel(cKDTree(model), points, gate_m)
    for kind in np.unique(scene.classes):
        same, of_kind = tables.cloud_classes == kind, scene.classes == kind
        if same.any():
            total[:, of_kind] += SEMANTIC * _kernel(cKDTree(model[same]), points[:, of_kind], gate_m)
    return np.asarray(total @ weights / (weights.sum() * (SEMANTIC + AGGREGATE)))


def _kernel(tree: cKDTree, points: Float64, gate_m: float) -> Float64:
    """Tukey's biweight (M, N) of the distances of points (M, N, 3) to their nearest ones."""
    distance, _ = tree.query(points.reshape(-1, 3), distance_upper_bound=gate_m)
    weight = np.maximum(1.0 - (np.minimum(distance, gate_m) / gate_m) ** 2, 0.0) ** 2
    return np.asarray(weight.reshape(points.shape[:2]))
