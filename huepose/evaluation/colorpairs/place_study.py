"""The places of colour pairs in the full method, measured on labelled scenes: figures and differences.

Boxes are disturbed true ones, masks the embedded segmenter's. What is compared are answers to the same
questions, so the interval of a difference is that of the mean of the differences, over draws of frames.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from huepose.datasets.types import GroundTruth, Scene
from huepose.estimation.config import FullPathConfig
from huepose.estimation.evidence import gather
from huepose.estimation.on_edges import laid_on_edges
from huepose.estimation.prepared import PreparedModels
from huepose.estimation.settle import settle_on_depth
from huepose.evaluation import metrics
from huepose.evaluation.bootstrap import Interval, frame_intervals
from huepose.evaluation.boxes import disturbed, truth_box
from huepose.evaluation.colorpairs.places import FULL, Answer, Shared, places_of
from huepose.evaluation.equivalents import Key
from huepose.evaluation.summary import grouped, table
from huepose.evaluation.targets import PoseError, Targets
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.perception.embedded import DepthSegmenter
from huepose.support.progress import progress

WITHOUT_EDGES = "without the edges in the end"


@dataclass(frozen=True)
class PlaceRow:
    """What one place found for one label in one disturbed box; seconds: CPU time, without masks."""

    place: str
    scene: str
    image: int
    instance: int
    object: str
    seed: int
    add_m: float
    adds_m: float
    diameter_m: float
    seconds: float


@dataclass(frozen=True)
class PlaceFigures:
    """Recall and AUC in percent; ms: mean CPU time an object; more_add, more_auc: what ADD recall and its AUC
    are above those of the full method as it is, with the interval that holds 95 % of draws of frames."""

    place: str
    instances: int
    recall_add: float
    recall_adds: float
    auc_add: float
    auc_adds: float
    ms: float
    more_add: float
    more_add95: Interval
    more_auc: float
    more_auc95: Interval


def study_places(
    scenes: Sequence[Scene],
    targets: Targets,
    equivalents: Mapping[Key, Sequence[Float64]],
    min_visib: float,
    seeds: Sequence[int],
) -> list[PlaceRow]:
    """Rows of all places for every label that is wanted and visible enough."""
    prepared, segmenter = PreparedModels(targets.models_by_name), DepthSegmenter()
    rows: list[PlaceRow] = []
    images = [(scene, image) for scene in scenes for image in scene.image_ids]
    for scene, image in progress(images, "frames"):
        chosen = [t for t in scene.truths(image) if _counts(t, targets, min_visib)]
        frame = scene.frame(image) if chosen else None
        for truth in chosen:
            model = targets.model_of(truth)
            if model is None or frame is None:
                continue
            key = (scene.name, image, truth.instance)
            for seed in seeds:
                found = _answers(frame, truth, model, prepared, segmenter, seed, key)
                for place, T, seconds in found:
                    error = targets.error(model, T, _pose(truth), equivalents.get(key, ()))
                    rows.append(_row(place, key, model, seed, error, seconds))
    return rows


def figures_of(rows: Sequence[PlaceRow]) -> list[PlaceFigures]:
    """Figures of each place over all rows, the full method as it is first."""
    by_place = grouped(rows, lambda r: r.place)
    asked = [(r.scene, r.image, r.instance, r.seed) for r in by_place[FULL]]
    base_right, base_auc = _values(by_place[FULL])
    out = []
    for place, mine in by_place.items():
        by_question = {(r.scene, r.image, r.instance, r.seed): r for r in mine}
        mine = [by_question[q] for q in asked]
        right, auc = _values(mine)
        spans = frame_intervals(
            {"add": right - base_right, "auc": auc - base_auc}, [(r.scene, r.image) for r in mine]
        )
        four = metrics.four_figures(
            np.array([r.add_m for r in mine]),
            np.array([r.adds_m for r in mine]),
            np.array([r.diameter_m for r in mine]),
        )
        recall, recall_s, area, area_s = (float(value or 0.0) for value in four.values())
        ms = 1e3 * float(np.mean([r.seconds for r in mine]))
        more = float((right - base_right).mean()), float((auc - base_auc).mean())
        shown = (recall, recall_s, area, area_s, ms)
        out.append(PlaceFigures(place, len(mine), *shown, more[0], spans["add"], more[1], spans["auc"]))
    return out


def place_lines(figures: Sequence[PlaceFigures]) -> str:
    """The table."""
    header = ["place", "n", "ADD", "ADD-S", "AUC", "AUC-S", "ms", "more ADD", "more AUC"]
    cells = [
        [
            f.place,
            f.instances,
            f.recall_add,
            f.recall_adds,
            f.auc_add,
            f.auc_adds,
            f.ms,
            f"{f.more_add:+.1f} ({f.more_add95[0]:+.1f} to {f.more_add95[1]:+.1f})",
            f"{f.more_auc:+.2f} ({f.more_auc95[0]:+.2f} to {f.more_auc95[1]:+.2f})",
        ]
        for f in figures
    ]
    return table(header, cells)


def _answers(
    frame: RgbdFrame,
    truth: GroundTruth,
    model: ReferenceModel,
    prepared: PreparedModels,
    segmenter: DepthSegmenter,
    seed: int,
    key: Key,
) -> Iterator[tuple[str, Float64 | None, float]]:
    """Each place with its last pose (4, 4) and the CPU seconds that it took."""
    camera = frame.camera
    box = truth_box(truth, model, camera)
    if box is None:
        return
    box = disturbed(box, "perturbed", seed, *key, camera.width, camera.height)
    evidence = gather(frame, segmenter.segment(frame, box, model.diameter_m), box, model.diameter_m)
    if evidence is None:
        yield from ((place, None, 0.0) for place in (FULL, WITHOUT_EDGES))
        return
    shared = Shared(model, prepared.prepared(model.name).table, evidence, FullPathConfig(), (seed, *key[1:]))
    settled: dict[bytes, tuple[Float64, Float64, float]] = {}

    def last(answer: Answer) -> tuple[Float64, Float64, float] | None:
        """The best pose settled on depth, then on edges, and what the edges took."""
        if not len(answer.poses):
            return None
        best = answer.poses[0]
        if best.tobytes() not in settled:
            fit, mask = settle_on_depth(model, frame, evidence.region, best)
            start = time.thread_time()
            on_edges = laid_on_edges(model, frame, mask, fit.T_cam_obj)
            settled[best.tobytes()] = fit.T_cam_obj, on_edges, time.thread_time() - start
        return settled[best.tobytes()]

    for place, answer in places_of(shared).items():
        ending = last(answer)
        if ending is None:
            yield place, None, answer.seconds
            continue
        on_depth, on_edges, seconds = ending
        yield place, on_edges, answer.seconds + seconds
        if place == FULL:
            yield WITHOUT_EDGES, on_depth, answer.seconds


def _counts(truth: GroundTruth, targets: Targets, min_visib: float) -> bool:
    seen = truth.visib_fract is None or truth.visib_fract >= min_visib
    return seen and targets.wants(truth) and truth.T_cam_obj is not None


def _pose(truth: GroundTruth) -> Float64:
    return np.asarray(truth.T_cam_obj, np.float64)


def _row(
    place: str, key: Key, model: ReferenceModel, seed: int, error: PoseError, seconds: float
) -> PlaceRow:
    return PlaceRow(place, *key, model.name, seed, error.add_m, error.adds_m, model.diameter_m, seconds)


def _values(rows: Sequence[PlaceRow]) -> tuple[Float64, Float64]:
    """By row, in percent: whether ADD is right (N,), and its share of the AUC (N,)."""
    add = np.array([r.add_m for r in rows])
    limits = metrics.RECALL_FRACTION * np.array([r.diameter_m for r in rows])
    right = np.where(add < limits, 100.0, 0.0)
    return right, np.asarray(100.0 * np.maximum(0.0, 1.0 - add / metrics.AUC_LIMIT_M))
