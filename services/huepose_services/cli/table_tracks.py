"""The runs of `huepose eval tables` over sequences."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from huepose.datasets import files
from huepose.datasets.fast_ycb import labelled_sequences, object_of
from huepose.datasets.types import Scene, SomeImages
from huepose.evaluation.ablation import evaluate_ablation, with_networks
from huepose.evaluation.ablation_rows import GAP, AblationResult, AblationRow
from huepose.evaluation.paper_tracker import PaperTracker
from huepose.evaluation.sources import LoopJudge
from huepose.evaluation.tables.journal import Entry, Journal, run_tracks
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_protocol import SourceNames, Sources, TrackOptions, evaluate_tracking
from huepose.evaluation.track_rows import TrackResult
from huepose.profiles import profile
from huepose.support.errors import InputError
from huepose_services.cli.evaluate_scenes import open_fast_ycb
from huepose_services.cli.pose_tables import PoseSources, warm_tracker
from huepose_services.cli.table_images import left_out


@dataclass(frozen=True)
class TrackSource:
    """path: in Fast-YCB's layout; key: of its files in OUT/runs; expected: names of the objects that the
    whole set has sequences of; start: first poses, None for DOPE's where the set has them."""

    path: Path
    key: str
    expected: tuple[str, ...]
    start: str | None = None


def tracks(
    arguments: argparse.Namespace, source: TrackSource, bundles: Path
) -> tuple[dict[tuple[str, int], list[Entry]], list[str]]:
    """Entries by method and step, notes on what is not in them."""
    import cv2

    cv2.setNumThreads(1)  # as the tracker's worker does
    found, notes = labelled_sequences(source.path)
    broken: list[str] = []
    scenes, models = open_fast_ycb([source.path], bundles, broken)
    absent = [name for name in source.expected if name not in {object_of(p) for p in found}]
    if absent:
        notes.append(f"missing sequences: {', '.join(absent)}")
    if arguments.quick is not None:
        scenes = [SomeImages(scene, scene.image_ids[: arguments.quick]) for scene in scenes]
        notes.append(f"the first {arguments.quick} frames of each sequence")
    notes += [f"a sequence cannot be read, and is not measured: {reason}" for reason in broken]
    by_name = {files.folder_name(path): path for path in found}
    paths = {scene.name: by_name[scene.name] for scene in scenes}
    asked = arguments.start or source.start
    starts = {name: asked or _usual_start(path) for name, path in paths.items()}
    kinds = sorted(set(starts.values()))
    for kind in kinds:
        own = ", ".join(name for name, start in starts.items() if start == kind)
        notes.append(f"first pose {kind}: {own if len(kinds) > 1 else 'all'}")
    notes.append(f"protocol {arguments.protocol}, profile {arguments.profile}")
    common = {key: getattr(arguments, key) for key in ("profile", "protocol", "seed")} | {"start": asked}
    named, roft = PoseSources(models, profile(arguments.profile).estimator), arguments.protocol == "roft"
    ours = partial(warm_tracker, config=profile(arguments.profile).tracker)

    def track(scene: Scene, method: str, every: int) -> TrackResult:
        start = starts[scene.name]
        name = str(paths[scene.name].parent) if start == "dope" else start
        first = named.of(name, scene.name, arguments.seed)
        delayed = named.of("estimate", scene.name, arguments.seed) if roft else None
        return evaluate_tracking(
            [scene],
            Targets(models),
            PaperTracker if method == "paper" else ours,
            lambda scene, seed: Sources(first, delayed),
            TrackOptions(arguments.protocol, every, (arguments.seed,)),
            SourceNames(start, "estimate" if roft else None),
            judge=LoopJudge(models) if roft else None,
        )

    entries = {}
    for method in arguments.methods:
        if method == "colorpair":
            continue
        journal = Journal(
            arguments.out / "runs" / f"{source.key}-{method}.jsonl", {**common, "method": method}
        )
        for every in arguments.every:
            entries[method, every] = run_tracks(
                journal, scenes, every, partial(track, method=method, every=every)
            )
    notes += left_out(next(iter(entries.values()), []))
    return entries, notes


def ablation(arguments: argparse.Namespace, source: TrackSource, bundles: Path) -> AblationResult | None:
    """The paper's ablation by our closed form (`robust`) and a network as the paper's (`direct`); None where
    no frames lie far enough apart."""
    scenes, models = open_fast_ycb([source.path], bundles, [])
    if arguments.quick is not None:
        scenes = [SomeImages(scene, scene.image_ids[: arguments.quick]) for scene in scenes]
    journal = Journal(arguments.out / "runs" / f"{source.key}-ablation.jsonl", {"gap": GAP})
    estimators = {name: with_networks()[name] for name in ("robust", "direct")}
    rows: list[AblationRow] = []
    pairs = left_out = 0
    for scene in scenes:
        key = f"{scene.name}/{len(scene.image_ids)} frames"
        if not journal.done(key):
            try:
                found = evaluate_ablation([scene], Targets(models), estimators)
            except InputError as error:
                journal.add(key, {"error": str(error)})
                continue
            of_scene = {"pairs": found.pairs, "left_out": found.left_out, **found.as_json()}
            journal.add(key, of_scene)
        entry = journal.entries[key]
        rows += [AblationRow(**row) for row in entry["rows"]]
        pairs, left_out = pairs + entry["pairs"], left_out + entry["left_out"]
    return AblationResult(rows, pairs, left_out) if rows else None


def _usual_start(path: Path) -> str:
    there = any((path / "dope" / name).exists() for name in ("poses_ycb.txt", "poses.txt"))
    return "dope" if there else "gt"
