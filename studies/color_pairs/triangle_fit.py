"""The two weights of a triangle's quality, area and distance of its centroid from the object's centre, chosen
by how much of the vote is right.

For each pair of weights the table of triangles is built anew and asked with rendered scenes whose pose is
known: partly hidden, in disturbed colours, with noisy depth. Every vote has a weight; the share of the weight
that lies within `TURN_DEG` and `SHIFT` of the true pose (or of an equal one) is the figure, averaged over
scenes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from huepose.colorpair.extract import extract
from huepose.colorpair.lifting import lift
from huepose.geometry.arrays import Bool, Float32, Int32, Int64
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.rotations import angles_to
from huepose.model.types import ReferenceModel
from huepose.paper.cloud import ClassifiedCloud
from huepose.paper.extended.hypotheses import HypothesesConfig, read_scene
from huepose.paper.tables import reference_cloud, tables_of
from huepose.paper.triangles import TriangleConfig, build_triangles, triangle_votes
from huepose.support.progress import progress
from studies.color_pairs.similarity_fit import disturbed_color
from studies.color_pairs.views import StudyView, object_views

TURN_DEG, SHIFT = 15.0, 0.1
"""Degrees and diameters within which a vote is right."""

DEPTH_NOISE = 0.001
"""Metres at a distance of 4 diameters: what a depth camera has at half a metre."""

MOST_HIDDEN = 0.5
"""Share of an object that something may hide."""

WEIGHTS: tuple[tuple[float, float], ...] = (
    (0.0, 0.0),
    (1.0, 0.0),
    (1.0, 0.05),
    (1.0, 0.1),
    (1.0, 0.3),
    (1.0, 1.0),
    (0.0, 1.0),
)
"""Of area and of eccentricity; with none of both the triangles are taken as they are drawn."""


@dataclass(frozen=True, eq=False)
class TriangleScene:
    """What a camera saw of an object, disturbed, and classified; the view has the truth."""

    model: ReferenceModel
    view: StudyView
    frame: RgbdFrame
    cloud: ClassifiedCloud


@dataclass(frozen=True)
class TriangleShare:
    """Weights of area and eccentricity; right: share of the votes' weight that is right (0..1)."""

    area: float
    eccentricity: float
    right: float


def triangle_scenes(models: Mapping[str, ReferenceModel], views: int, seed: int = 0) -> list[TriangleScene]:
    """`views` disturbed views of each object, read as matching reads them."""
    rng = np.random.default_rng(seed)
    scenes = []
    for name, model in models.items():
        pixels = model.pairs.parameters["coarse_pixels_per_m"] * model.diameter_m
        for view in object_views({name: model}, views, pixels, int(rng.integers(1 << 30))):
            view = replace(view, mask=half_hidden(view.mask, rng.uniform(0.0, MOST_HIDDEN), rng))
            frame = disturbed_frame(view, rng)
            pairs = extract(frame.color, view.mask)
            if not len(lift(pairs, frame.depth, view.mask, frame.camera)[0]):
                continue
            readings = read_scene(model, pairs, frame, view.mask, HypothesesConfig(), rng)
            scenes.append(TriangleScene(model, view, frame, readings[0].cloud))
    return scenes


def half_hidden(mask: Bool, share: float, rng: np.random.Generator) -> Bool:
    """The mask (H, W) without the `share` of it that lies farthest in a random direction."""
    v, u = np.nonzero(mask)
    angle = rng.uniform(-np.pi, np.pi)
    along = u * np.cos(angle) + v * np.sin(angle)
    shown = along <= np.quantile(along, 1.0 - share)
    out = np.zeros_like(mask)
    out[v[shown], u[shown]] = True
    return out


def disturbed_frame(view: StudyView, rng: np.random.Generator) -> RgbdFrame:
    """The view under another light, seen by a camera with noise in colour and depth."""
    spread: Float32 = rng.normal(0.0, DEPTH_NOISE, view.frame.depth.shape).astype(np.float32)
    depth = np.where(view.mask, view.frame.depth + spread, 0.0).astype(np.float32)
    return RgbdFrame(disturbed_color(view, rng), depth, view.frame.camera)


def triangle_shares(
    scenes: Sequence[TriangleScene], weights: Sequence[tuple[float, float]] = WEIGHTS, seed: int = 0
) -> list[TriangleShare]:
    """Share of right votes for each pair of weights, best first."""
    out = []
    for area, eccentricity in progress(list(weights), "weights"):
        config = replace(TriangleConfig(), area=area, eccentricity=eccentricity)
        tables: dict[str, tuple[Int64, Int32]] = {}
        for model in {s.model.name: s.model for s in scenes}.values():
            tables[model.name] = build_triangles(
                reference_cloud(tables_of(model)), model.diameter_m, config, seed
            )
        shares = [_right_share(s, config, tables[s.model.name], seed) for s in scenes]
        out.append(TriangleShare(area, eccentricity, float(np.mean(shares))))
    return sorted(out, key=lambda share: -share.right)


def _right_share(
    scene: TriangleScene, config: TriangleConfig, table: tuple[Int64, Int32], seed: int
) -> float:
    model = scene.model
    votes = triangle_votes(
        scene.cloud,
        reference_cloud(tables_of(model)),
        *table,
        config.bin * model.diameter_m,
        config,
        np.random.default_rng(seed),
    )
    if not len(votes):
        return 0.0
    T = scene.view.T_cam_obj
    turns = np.min([angles_to(votes.rotations, (T @ e)[:3, :3]) for e in model.equivalents], axis=0)
    centre = model.mesh.centre
    at = votes.rotations @ centre.astype(np.float32) + votes.translations
    moves = np.linalg.norm(at - (T[:3, :3] @ centre + T[:3, 3]), axis=1)
    right = (turns < np.radians(TURN_DEG)) & (moves < SHIFT * model.diameter_m)
    return float(votes.weights[right].sum() / votes.weights.sum())
