"""Fitting presence: from estimates at the detector's places, with known truth, to the weights of
`perception.presence`.

Frames are rendered: three sets with different seeds, to fit, to choose and to report, each with objects that
are apart, heaps and piles. Some frames are reduced in size, so that objects have few pixels, and some have
specks of wrong depth, as from cameras that match a pattern wrongly. Each frame is used a second time in the
colours of another camera, since scenes and models share their textures, and a user's camera has other
colours. The pose's own certainty is added as in `estimation.present`, so that the sum of all is the log odds
of a probability.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from huepose.believe.logistic import Logistic, probabilities
from huepose.believe.presence import Sight, features, logits_of
from huepose.datasets.bop import BopScene
from huepose.datasets.boxes import truth_box
from huepose.datasets.types import Sample
from huepose.estimation import Estimator, EstimatorConfig
from huepose.estimation.present import certainty
from huepose.estimation.types import ObjectQuery
from huepose.evaluation.estimate_protocol import PoseEstimator
from huepose.evaluation.perception_protocol import SAME, first_of_each
from huepose.evaluation.targets import Targets
from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.model import load_models
from huepose.onboarding.bop_folder import bop_models
from huepose.onboarding.meshes import read_mesh
from huepose.perception.clear_view import clear_view
from huepose.perception.config import DetectorConfig
from huepose.perception.presence import alike, outlined, sight
from huepose.perception.types import Detector
from huepose.perception.view_detector import ViewDetector
from huepose.scenes.rendered import PILES, SceneRanges, write_rendered_set
from huepose.support.progress import progress
from studies.likelihood import logistic

SetName = Literal["fit", "choose", "report"]

APART = SceneRanges(
    objects=(2, 5),
    others=(1, 6),
    spread_m=(0.25, 0.42),
    distance_m=(0.6, 1.5),
    elevation_deg=(20.0, 65.0),
    exposure=(-1.8, 1.0),
    tint=(-0.4, 0.4),
    gloss=(0.0, 0.6),
)

KINDS = {"apart": (APART, 7003), "heaps": (SceneRanges(), 7001), "piles": (PILES, 7002)}
"""Ranges of the scenes, and seed of the first set."""

FRAMES: dict[SetName, tuple[int, ...]] = {"fit": (70, 50, 40), "choose": (40, 30, 24), "report": (32, 16, 12)}
"""Frames of each of `KINDS` in each set."""

SEEDS_APART = 1000
"""Difference between the seeds of two sets of a kind."""

SMALLER = (1.0, 0.5, 1.0, 0.35)
SPECKED = (False, False, True, True)
"""Scale of the image, and whether it has specks, for every four frames."""

SPECKS, SPECK_PX, SPECK_M, EMPTY_PX = (5, 20), (3, 10), (0.4, 6.0), 3
"""Number, size and distance of the specks, and width of the border without depth around each."""


def draw(name: SetName, models: Path, work: Path) -> list[Path]:
    """Render the scene folders of a set; existing frames are kept."""
    offset = SEEDS_APART * list(FRAMES).index(name)
    folders = [work / name / kind for kind in KINDS]
    known = bop_models(models, None)
    meshes = {m.name: read_mesh(m.mesh_path, "mm") for m in known}
    ids = {m.name: m.object_id for m in known}
    for folder, (ranges, seed), count in zip(folders, KINDS.values(), FRAMES[name], strict=True):
        write_rendered_set(folder, meshes, ids, count, seed + offset, ranges)
    return folders


def samples(folder: Path) -> Iterator[tuple[Sample, float]]:
    """The frames of a folder as they are used, each with its scale against the labels."""
    scene = BopScene(folder)
    for k, image in enumerate(scene.image_ids):
        frame, smaller = scene.frame(image), SMALLER[k % len(SMALLER)]
        frame = smaller_frame(frame, smaller)
        if SPECKED[k % len(SPECKED)]:
            frame = replace(frame, depth=specked(frame.depth, np.random.default_rng(k)))
        yield Sample(frame, scene.truths(image), scene.name, image), smaller


def scaled(box: Box, scale: float) -> Box:
    """The box in the image scaled by `scale`."""
    return Box(scale * box.x, scale * box.y, scale * box.w, scale * box.h)


def smaller_frame(frame: RgbdFrame, scale: float) -> RgbdFrame:
    """The frame scaled by `scale`."""
    if scale == 1.0:
        return frame
    camera = frame.camera.scaled(scale)
    size = camera.width, camera.height
    color = cv2.resize(frame.color, size, interpolation=cv2.INTER_AREA)
    depth = cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST)
    return RgbdFrame(np.asarray(color, np.uint8), np.asarray(depth, np.float32), camera)


def specked(depth: Float32, rng: np.random.Generator) -> Float32:
    """Depth (H, W) with specks of wrong readings, each with a border without depth."""
    depth = depth.copy()
    height, width = depth.shape
    for _ in range(int(rng.integers(*SPECKS))):
        h, w = (int(n) for n in rng.integers(*SPECK_PX, 2))
        v, u = int(rng.integers(EMPTY_PX, height - h)), int(rng.integers(EMPTY_PX, width - w))
        depth[v - EMPTY_PX : v + h + EMPTY_PX, u - EMPTY_PX : u + w + EMPTY_PX] = 0.0
        depth[v : v + h, u : u + w] = rng.uniform(*SPECK_M) * rng.normal(1.0, 0.002, (h, w))
    return depth


PLACES = 2
"""Number of best places of each object that are used."""

PLAUSIBLE = 0.01
"""Poses with less presence than this are not fitted: they are many and easy, and would determine the weights
instead of the doubtful poses."""


@dataclass(frozen=True, eq=False)
class SeenPlaces:
    """The poses of a frame: names of their objects, the evidence at each, each pose's own certainty (N,) in
    log odds, and whether its object is there (N,)."""

    names: tuple[str, ...]
    sights: tuple[Sight, ...]
    certain: Float64
    there: Bool

    def rough(self) -> SeenPlaces:
        """The same, as if the poses were rough: without verification."""
        return replace(self, sights=tuple(replace(s, verified=None) for s in self.sights))


def seen_in(folder: Path, bundles: Path) -> Sequence[SeenPlaces]:
    """The poses of all objects in the frames of a folder, from disk if they are there."""
    kept = folder / "seen.pkl"
    if kept.exists():
        return list(pickle.loads(kept.read_bytes()))
    targets = Targets(load_models(bundles))
    models = targets.models_by_name
    detector = ViewDetector(models, DetectorConfig(proposals=3, min_score=0.02))
    estimator = Estimator(models, EstimatorConfig(found_level=0.0, threads=1))
    rng, out = np.random.default_rng(5), []
    for sample, smaller in progress(list(samples(folder)), folder.name):
        out += look(sample, smaller, targets, detector, estimator, rng)
    kept.write_bytes(pickle.dumps(out))
    return out


def look(
    sample: Sample,
    smaller: float,
    targets: Targets,
    detector: Detector,
    estimator: PoseEstimator,
    rng: np.random.Generator,
) -> list[SeenPlaces]:
    """Detect and estimate all objects of `targets` in a frame; smaller: its scale against the labels. Returns
    the evidence at their poses in this frame, and in the same frame with the colours of another camera. An
    object is there if the box of its pose's mask overlaps the box of one of its labels by IoU 0.5."""
    models = targets.models_by_name
    places = first_of_each(detector.detect(sample.frame, list(models)), PLACES)
    queries = [ObjectQuery(d.object, box=d.box, instance=i) for i, d in enumerate(places)]
    answers = estimator.estimate(sample.frame, queries) if queries else []
    boxes = [
        (model.name, scaled(box, smaller))
        for t in sample.truths
        if t.T_cam_obj is not None and (model := targets.model_of(t)) is not None
        if (box := truth_box(t, model.mesh, sample.frame.camera)) is not None
    ]
    poses, certain, there = [], [], []
    for answer in answers:
        own = None if answer.mask is None else Box.of_mask(answer.mask)
        if answer.T_cam_obj is None or own is None:
            continue
        poses.append((answer.object, answer.T_cam_obj))
        certain.append(certainty(answer))
        there.append(any(n == answer.object and b.iou(own) >= SAME for n, b in boxes))
    other = replace(sample.frame, color=of_another_camera(sample.frame.color, rng))
    names, rest = tuple(name for name, _ in poses), (np.array(certain), np.array(there, dtype=bool))
    return [SeenPlaces(names, _sights(frame, poses, targets), *rest) for frame in (sample.frame, other)]


def _sights(frame: RgbdFrame, poses: Sequence[tuple[str, Float64]], targets: Targets) -> tuple[Sight, ...]:
    """All evidence for each named pose (4, 4) in a frame."""
    models = targets.models_by_name
    view = clear_view(frame, max(m.diameter_m for m in models.values()))
    if not poses or view is None:
        return ()
    regions = {name: view.with_planes.region(models[name].diameter_m) for name, _ in poses}
    plain = [sight(view, regions[name], models[name], T) for name, T in poses]
    return tuple(outlined(view, models, poses, alike(view, models, poses, plain)))


def of_another_camera(color: UInt8, rng: np.random.Generator) -> UInt8:
    """An image (H, W, 3) as a camera with other filters, white balance, exposure, saturation, tone curve and
    veil would take it."""
    linear = (color / 255.0) ** 2.2 * np.exp(0.15 * rng.normal(size=3)) * np.exp(0.2 * rng.normal())
    filters = np.eye(3) + 0.12 * rng.normal(size=(3, 3))
    linear = np.clip(linear @ (filters / filters.sum(1, keepdims=True)).T, 0.0, None)
    grey = linear.mean(-1, keepdims=True)
    linear = grey + (linear - grey) * np.exp(0.3 * rng.normal() - 0.15)
    curved = np.clip(linear, 0.0, 1.0) ** (np.exp(0.18 * rng.normal()) / 2.2)
    veil = 0.4 * rng.random() ** 2
    veiled = (1.0 - veil) * curved + veil * (0.6 * rng.random() + 0.4 * rng.random(3))
    return np.asarray(255.0 * np.clip(veiled, 0.0, 1.0), np.uint8)


def fit_presence(frames: Sequence[SeenPlaces], start: Logistic) -> Logistic:
    """The maximum-likelihood weights on the plausible poses of these frames; `start` gives the presence that
    decides which are plausible."""
    frames = [frame for frame in frames if frame.names]
    plausible = np.concatenate([chances(frame, start) for frame in frames]) >= PLAUSIBLE
    there = np.concatenate([frame.there for frame in frames])[plausible]
    certain = np.concatenate([frame.certain for frame in frames])[plausible]
    rows = [features(s) for frame in frames for s in frame.sights]
    x = np.array([list(row.values()) for row in rows])[plausible]
    return logistic(x, there, np.ones(len(there)), list(rows[0]), certain)


def chances(frame: SeenPlaces, fit: Logistic) -> Float64:
    """Probability (N,) that each object is there."""
    return probabilities(logits_of(frame.sights, fit) + frame.certain)
