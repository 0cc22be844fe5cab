"""`huepose eval tables`: the paper's tables from the official data by one command."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import huepose.evaluation.tables.assemble as assemble
from huepose.datasets.fast_ycb import labelled_sequences, object_of
from huepose.datasets.types import Scene, SomeImages
from huepose.datasets.ycb_objects import ycb_named, ycb_objects
from huepose.datasets.ycbv_folder import YcbvFolder, open_ycbv, spread
from huepose.estimation import Estimator
from huepose.evaluation.bop_csv import BopResult, write_bop_csv
from huepose.evaluation.equivalents import read_equivalents
from huepose.evaluation.estimate_protocol import EstimateOptions, EstimateSetup
from huepose.evaluation.origin import origin
from huepose.evaluation.paper_tracker import PaperTracker
from huepose.evaluation.result_files import write_json
from huepose.evaluation.sources import EstimatorSource, FileSource, LoopJudge, PoseSource, TruthSource
from huepose.evaluation.tables.journal import Entry, Journal
from huepose.evaluation.tables.published import published
from huepose.evaluation.tables.report import page
from huepose.evaluation.tables.runs import run_images, run_tracks
from huepose.evaluation.tables.submission import AsGiven, read_submission
from huepose.evaluation.tables.table import Table
from huepose.evaluation.targets import Targets, posecnn_offset_m
from huepose.evaluation.track_protocol import SourceNames, Sources, TrackOptions, evaluate_tracking
from huepose.evaluation.track_rows import TrackResult
from huepose.model import ReferenceModel, load_models
from huepose.model.io import model_path
from huepose.profiles import profile
from huepose.support.errors import InputError
from huepose.support.files import write_text
from huepose.tracking import Tracker
from huepose_services.cli.evaluate_estimate import box_source
from huepose_services.cli.evaluate_scenes import bop_objects, open_fast_ycb, say
from huepose_services.cli.pose_tables import PoseTables


def call(arguments: argparse.Namespace) -> int:
    """Measure what is missing, then write the tables and the page."""
    if arguments.ycbv is None and arguments.fast_ycb is None:
        raise InputError(
            "huepose eval tables", found="no data", expected="--ycbv DIR, --fast-ycb DIR or both"
        )
    if arguments.boxes == "detect":
        raise InputError(
            "--boxes detect", found="boxes without labels", expected="paper, perturbed, gt, FILE"
        )
    folder = open_ycbv(arguments.ycbv) if arguments.ycbv else None
    bundles = arguments.bundles or _onboarded(arguments, folder)
    models = load_models(bundles)
    tables: list[Table] = []
    coverage: list[str] = [arguments.note] if arguments.note else []
    images: dict[str, list[Entry]] = {}
    tracks: dict[tuple[str, int], list[Entry]] = {}
    names = {str(m.object_id): name for name, m in models.items() if m.object_id is not None}
    if folder is not None:
        images, notes, expected = _images(arguments, models)
        tables += assemble.single_frame_tables(images, names, expected, notes)
        coverage += [f"YCB-Video: {note}" for note in notes]
    if arguments.fast_ycb:
        tracks, notes = _tracks(arguments, bundles)
        tables += assemble.tracking_tables(tracks, notes)
        coverage += [f"Fast-YCB: {note}" for note in notes]
    _write(arguments.out, tables, coverage, images, tracks, names)
    return 0


def _wanted(arguments: argparse.Namespace, models: Mapping[str, ReferenceModel]) -> list[str] | None:
    """Of the single frames: what is asked for, else the paper's objects, else all."""
    if arguments.objects:
        return list(arguments.objects)
    return [name for name in published("table1").rows if name in models] or None


def _onboarded(arguments: argparse.Namespace, folder: YcbvFolder | None) -> Path:
    """Reference models in OUT/bundles; those that are there already are kept. Raises InputError."""
    from huepose.onboarding.bop_folder import bop_models, ycb_video_models
    from huepose_services.cli.onboard import onboard_models

    meshes = arguments.models or (folder.models if folder is not None else None)
    if meshes is None:
        raise InputError(
            "huepose eval tables",
            found="no reference models, and no meshes to make them from",
            expected="--bundles DIR or --models DIR",
            fix="BOP's ycbv_models.zip has the meshes of both data sets.",
        )
    out: Path = arguments.out / "bundles"
    models = ycb_video_models(meshes) or bop_models(meshes)
    asked = set(arguments.objects or published("table1").rows)
    chosen = [m for m in models if {m.name, str(m.object_id)} & asked]
    if not chosen:  # other objects than the paper's: all of them
        chosen = list(models)
    elif arguments.fast_ycb:
        shown = {object_of(path) for path in labelled_sequences(arguments.fast_ycb)[0]}
        chosen += [m for m in models if m.name in shown and m not in chosen]
    missing = [m for m in chosen if not model_path(out, m.name).exists()]
    failed = onboard_models(missing, out, paper=True, processes=2) if missing else []
    if failed:
        raise InputError(
            meshes, found=f"no reference model of {', '.join(failed)}", fix="See the lines above."
        )
    return out


def _images(
    arguments: argparse.Namespace, models: Mapping[str, ReferenceModel]
) -> tuple[dict[str, list[Entry]], list[str], dict[str, int]]:
    """Entries by method, notes on what is not in them, labels of the whole set by object name."""
    offsets = {m.object_id: posecnn_offset_m(m) for m in models.values() if m.object_id is not None}
    folder = open_ycbv(arguments.ycbv, {i: o for i, o in offsets.items() if o is not None})
    say([f"{arguments.ycbv}: {folder.layout} layout", *folder.coverage.lines()])
    scenes = folder.scenes if arguments.quick is None else spread(folder.scenes, arguments.quick)
    targets = Targets(models, _wanted(arguments, models))
    ids = [m.object_id for m in models.values() if m.object_id is not None]
    boxes, given = box_source(arguments.boxes)
    listed = bool(folder.coverage.targets)
    options = EstimateOptions(boxes, "auto", 0.0 if listed else 0.1, (arguments.seed,))
    equivalents = read_equivalents(arguments.equivalent) if arguments.equivalent else {}
    # BOP's symmetries are in the frame of BOP's meshes.
    in_bops_frame = {
        name: m
        for name, m in models.items()
        if m.frame_offset_m is None or m.frame_offset_m.any() or ycb_named(name) is None
    }
    measured_on = bop_objects(folder.info, in_bops_frame) if folder.info is not None else {}
    settings = _settings(arguments, boxes=arguments.boxes, seed=arguments.seed, objects=arguments.objects)
    entries = {}
    for method in arguments.methods:
        config = replace(profile(arguments.profile).estimator, method=method, threads=arguments.threads)
        estimator = Estimator({m.name: m for m in targets.models}, config)
        estimator.warm_up()
        setup = EstimateSetup(targets, estimator, options, equivalents, bop_objects=measured_on, given=given)
        journal = Journal(arguments.out / "runs" / f"ycbv-{method}.jsonl", {**settings, "method": method})
        entries[method] = run_images(journal, scenes, setup, f"YCB-Video, {method}")
    submissions = [read_submission(named, set(ids)) for named in arguments.submission]
    for submission in submissions:
        setup = EstimateSetup(
            targets,
            AsGiven(),
            replace(options, boxes="file"),
            equivalents,
            bop_objects=measured_on,
            given=submission.poses,
        )
        file = arguments.out / "runs" / f"ycbv-submission-{submission.name}.jsonl"
        file.unlink(missing_ok=True)  # nothing is estimated, and the file may be another one
        entries[submission.name] = run_images(Journal(file, settings), scenes, setup, submission.name)
    n = sum(len(scene.image_ids) for scene in scenes)
    notes = [*folder.coverage.lines()]
    if n < sum(len(scene.image_ids) for scene in folder.scenes):
        notes.append(f"a sample of {n} images, spread evenly over the scenes")
    notes.append(f"boxes {arguments.boxes}, own masks, seed {arguments.seed}, profile {arguments.profile}")
    notes += [note for submission in submissions for note in submission.notes]
    notes += _left_out(next(iter(entries.values())))
    all_names = {i: o.name for i, o in ycb_objects().items()} | {
        m.object_id: m.name for m in models.values() if m.object_id is not None
    }
    expected = {all_names.get(i, f"obj_{i:06d}"): n for i, n in folder.coverage.targets.items()}
    wanted = {m.name for m in targets.models}
    return entries, notes, {name: n for name, n in expected.items() if name in wanted}


def _left_out(entries: Sequence[Entry]) -> list[str]:
    """Of the first method; the others see the same files."""
    broken = [entry for entry in entries if "error" in entry]
    without = sum(entry.get("without_model", 0) for entry in entries)
    lines = [f"{without} labels of objects without a reference model are not measured"] if without else []
    if broken:
        reasons = "; ".join(str(entry["error"]) for entry in broken[:3])
        lines.append(f"{len(broken)} images or sequences could not be read: {reasons}")
    return lines


def _tracks(
    arguments: argparse.Namespace, bundles: Path
) -> tuple[dict[tuple[str, int], list[Entry]], list[str]]:
    """Entries by method and step, notes on what is not in them."""
    import cv2

    cv2.setNumThreads(1)  # as the tracker's worker does
    found, notes = labelled_sequences(arguments.fast_ycb)
    scenes, models = open_fast_ycb([arguments.fast_ycb], bundles)
    absent = [name for name in published("table2").rows if name not in {object_of(p) for p in found}]
    if absent:
        notes.append(f"missing sequences: {', '.join(absent)}")
    if arguments.quick is not None:
        scenes = [SomeImages(scene, scene.image_ids[: arguments.quick]) for scene in scenes]
        notes.append(f"the first {arguments.quick} frames of each sequence")
    starts = {scene.name: _start(arguments, path) for scene, path in zip(scenes, found, strict=True)}
    for kind in sorted(set(starts.values())):
        notes.append(f"first pose {kind}: {', '.join(n for n, start in starts.items() if start == kind)}")
    notes.append(f"protocol {arguments.protocol}, profile {arguments.profile}")
    settings = _settings(arguments, protocol=arguments.protocol, start=arguments.start, seed=arguments.seed)
    paths = {scene.name: path for scene, path in zip(scenes, found, strict=True)}
    track = _Tracking(arguments, models, starts, paths)
    entries = {}
    for method in arguments.methods:
        if method == "colorpair":
            continue
        journal = Journal(arguments.out / "runs" / f"fast-{method}.jsonl", {**settings, "method": method})
        for every in arguments.every:
            entries[method, every] = run_tracks(
                journal,
                scenes,
                every,
                lambda scene, m=method, k=every: track(scene, m, k),  # type: ignore[misc]
            )
    notes += _left_out(next(iter(entries.values()), []))
    return entries, notes


def _start(arguments: argparse.Namespace, path: Path) -> str:
    there = any((path / "dope" / name).exists() for name in ("poses_ycb.txt", "poses.txt"))
    return arguments.start or ("dope" if there else "gt")


class _Tracking:
    """One sequence by one method."""

    def __init__(
        self,
        arguments: argparse.Namespace,
        models: Mapping[str, ReferenceModel],
        starts: Mapping[str, str],
        paths: Mapping[str, Path],
    ) -> None:
        self.arguments, self.models, self.starts, self.paths = arguments, models, starts, paths
        self.estimator: Estimator | None = None

    def __call__(self, scene: Scene, method: str, every: int) -> TrackResult:
        """Track it."""
        arguments, settings = self.arguments, profile(self.arguments.profile)
        roft = arguments.protocol == "roft"
        first = self._source(self.starts[scene.name], scene)
        delayed = self._source("estimate", scene) if roft else None

        def ours(models: Mapping[str, ReferenceModel]) -> Tracker:
            tracker = Tracker(models, settings.tracker)
            tracker.warm_up()
            return tracker

        return evaluate_tracking(
            [scene],
            Targets(self.models),
            PaperTracker if method == "paper" else ours,
            lambda scene, seed: Sources(first, delayed),
            TrackOptions(arguments.protocol, every, (arguments.seed,)),
            SourceNames(self.starts[scene.name], "estimate" if roft else None),
            judge=LoopJudge(self.models) if roft else None,
        )

    def _source(self, kind: str, scene: Scene) -> PoseSource:
        if kind == "gt":
            return TruthSource()
        if kind == "dope":
            tables = PoseTables(None, None, {object_of(scene.name): self.models[object_of(scene.name)]})
            return FileSource(tables.of(str(self.paths[scene.name].parent), scene.name))
        if self.estimator is None:
            self.estimator = Estimator(self.models, profile(self.arguments.profile).estimator)
            self.estimator.warm_up()
        return EstimatorSource(self.estimator, self.arguments.seed)


def _settings(arguments: argparse.Namespace, **more: Any) -> dict[str, Any]:
    return {"profile": arguments.profile, **more}


def _poses(entries: Sequence[Entry]) -> list[BopResult]:
    """What bop_toolkit evaluates: the poses of objects with a BOP id."""
    return [
        BopResult(
            row["scene"],
            row["image"],
            row["object"],
            row["quality"],
            np.array(row["T_cam_obj"]),
            row["seconds"],
        )
        for row in assemble.rows_of(entries)
        if row["T_cam_obj"] is not None and isinstance(row["object"], int)
    ]


def _write(
    out: Path,
    tables: Sequence[Table],
    coverage: Sequence[str],
    images: Mapping[str, Sequence[Entry]],
    tracks: Mapping[tuple[str, int], Sequence[Entry]],
    names: Mapping[str, str],
) -> None:
    facts = origin()
    record = {"origin": facts, "coverage": list(coverage), "tables": [table.as_json() for table in tables]}
    write_json(out / "results.json", record)
    heading = "\n".join(f"{key}: {value}" for key, value in facts.items())
    text = "\n\n\n".join(table.text() for table in tables)
    write_text(out / "tables.txt", f"{heading}\n\n{text}\n")
    write_text(out / "tables.md", "\n".join(table.markdown() for table in tables))
    write_text(out / "tables.tex", "\n".join(table.latex() for table in tables))
    for table in tables:
        write_text(out / f"{table.key}.csv", table.csv())
    for method, entries in images.items():
        write_bop_csv(out / f"huepose-{method}_ycbv-test.csv", _poses(entries))
    image_rows = {method: assemble.rows_of(entries) for method, entries in images.items()}
    track_rows = {run: assemble.rows_of(entries) for run, entries in tracks.items()}
    write_text(out / "report.html", page(tables, facts, coverage, image_rows, track_rows, names))
    print(text)
    print(f"\n{out}/report.html, tables.txt, .md, .tex, results.json, CSV of the tables and for BOP")
