"""Sequences for `huepose eval tables`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from huepose import __version__
from huepose.datasets import files
from huepose.datasets.fast_ycb import labelled_sequences, object_of
from huepose.datasets.types import Scene, SomeImages
from huepose.datasets.ycb_objects import ycb_named
from huepose.evaluation.ablation import evaluate_ablation, with_networks
from huepose.evaluation.ablation_rows import GAP, AblationResult, AblationRow
from huepose.evaluation.paper_tracker import PaperTracker
from huepose.evaluation.sources import LoopJudge
from huepose.evaluation.tables.journal import Entry, Journal, models_digest, run_tracks
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_protocol import Sources, TrackOptions, evaluate_tracking
from huepose.evaluation.track_rows import TrackResult
from huepose.model import ReferenceModel
from huepose.perception.sessions import digest
from huepose.profiles import profile
from huepose.support.errors import InputError
from huepose_services.cli.evaluate_scenes import open_fast_ycb
from huepose_services.cli.pose_tables import PoseSources, warm_tracker
from huepose_services.cli.table_images import left_out


@dataclass(frozen=True)
class TrackSource:
    """A set of sequences. path: in Fast-YCB's layout; key: prefix of its files in OUT/runs; expected: names
    of the objects in the whole set; start: first poses, None for DOPE's where the set has them, else
    labels; objects: names or ids that are asked for, empty for all."""

    path: Path
    key: str
    expected: tuple[str, ...]
    start: str | None = None
    objects: Sequence[str] = ()

    def asks(self, name: str) -> bool:
        """Whether sequences of an object of that name are asked for."""
        known = ycb_named(name)
        names = {name} if known is None else {name, str(known.object_id)}
        return not self.objects or not names.isdisjoint(self.objects)

    def opened(self, bundles: Path, broken: list[str]) -> tuple[list[Scene], dict[str, ReferenceModel]]:
        """The sequences that are asked for, with the reference models of their objects. Errors of sequences
        that cannot be opened are added to `broken`. Raises InputError if none is left."""
        found = [path for path in labelled_sequences(self.path)[0] if self.asks(object_of(path))]
        if not found:
            raise InputError(
                "--objects",
                found=f"{', '.join(self.objects)}, of which {self.path} has no sequence",
                fix="Leave --fast-ycb out, or ask for other objects.",
            )
        return open_fast_ycb(found, bundles, broken)


def tracks(
    arguments: argparse.Namespace, source: TrackSource, bundles: Path
) -> tuple[dict[tuple[str, int], list[Entry]], list[str]]:
    """Entries by method and frame step, and notes on what they lack."""
    import cv2

    cv2.setNumThreads(1)  # as the tracker's worker does
    found, notes = labelled_sequences(source.path)
    broken: list[str] = []
    scenes, models = source.opened(bundles, broken)
    there = {object_of(path) for path in found}
    absent = [name for name in source.expected if source.asks(name) and name not in there]
    if absent:
        notes.append(f"missing sequences: {', '.join(absent)}")
    if arguments.quick is not None:
        scenes = [SomeImages(scene, scene.image_ids[: arguments.quick]) for scene in scenes]
        notes.append(f"the first {arguments.quick} frames of each sequence")
    notes += [f"a sequence cannot be read, and is not measured: {reason}" for reason in broken]
    by_name = {files.folder_name(path): path for path in found}
    paths = {scene.name: by_name[scene.name] for scene in scenes}
    asked = arguments.start or source.start
    starts = {name: asked or ("dope" if _dope_poses(path) else "gt") for name, path in paths.items()}
    kinds = sorted(set(starts.values()))
    for kind in kinds:
        own = ", ".join(name for name, start in starts.items() if start == kind)
        notes.append(f"first pose {kind}: {own if len(kinds) > 1 else 'all'}")
    notes.append(f"protocol {arguments.protocol}, profile {arguments.profile}")
    common = {key: getattr(arguments, key) for key in ("profile", "protocol", "seed")}
    common |= {"start": asked, "version": __version__}
    inputs = {name: _inputs(path, starts[name], models) for name, path in paths.items()}
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
            TrackOptions(arguments.protocol, every, (arguments.seed,), start, "estimate" if roft else None),
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
                journal, scenes, every, partial(track, method=method, every=every), inputs
            )
    notes += left_out(next(iter(entries.values()), []))
    return entries, notes


def ablation(arguments: argparse.Namespace, source: TrackSource, bundles: Path) -> AblationResult | None:
    """The paper's ablation with our closed form (`robust`) and a network like the paper's (`direct`); None
    if no frames are far enough apart."""
    scenes, models = source.opened(bundles, [])
    if arguments.quick is not None:
        scenes = [SomeImages(scene, scene.image_ids[: arguments.quick]) for scene in scenes]
    journal = Journal(
        arguments.out / "runs" / f"{source.key}-ablation.jsonl", {"gap": GAP, "version": __version__}
    )
    estimators = {name: with_networks()[name] for name in ("robust", "direct")}
    rows: list[AblationRow] = []
    pairs = left_out = 0
    for scene in scenes:
        used = models_digest([models[object_of(scene.name)]])
        key = f"{scene.name}/{len(scene.image_ids)} frames/{used}"
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


def _dope_poses(path: Path) -> list[Path]:
    """The files of DOPE's poses of a sequence."""
    places = (path / "dope" / name for name in ("poses_ycb.txt", "poses.txt"))
    return [place for place in places if place.exists()]


def _inputs(path: Path, start: str, models: Mapping[str, ReferenceModel]) -> str:
    """A digest of a sequence's inputs: its object's reference model, and DOPE's poses if they are used."""
    poses = _dope_poses(path) if start == "dope" else []
    return "-".join([models_digest([models[object_of(path)]]), *(digest(file)[:16] for file in poses)])
