"""`huepose eval tables`: the paper's tables from the official data, in one command."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from huepose.datasets.fast_ycb import labelled_sequences, object_of
from huepose.datasets.ycbv_folder import open_ycbv
from huepose.evaluation.ablation_rows import AblationResult
from huepose.evaluation.pose_files import write_bop_csv
from huepose.evaluation.result_files import origin, write_json
from huepose.evaluation.tables.assemble import single_frame_tables
from huepose.evaluation.tables.assemble_tracks import tracking_tables
from huepose.evaluation.tables.figures import Unseen, rows_of
from huepose.evaluation.tables.journal import Entry
from huepose.evaluation.tables.published import published
from huepose.evaluation.tables.report import page
from huepose.evaluation.tables.table import Table
from huepose.model import ReferenceModel, load_models
from huepose.model.io import model_path
from huepose.onboarding.bop_folder import BopModel, bop_models
from huepose.support.errors import InputError
from huepose.support.files import write_text
from huepose_services.cli.evaluate_estimate import bop_results
from huepose_services.cli.onboard import onboard_models
from huepose_services.cli.table_images import METHODS, images
from huepose_services.cli.table_tracks import TrackSource, ablation, tracks


def call(arguments: argparse.Namespace) -> int:
    """Measure what is missing, then write the tables and the page."""
    if not (arguments.ycbv or arguments.fast_ycb or arguments.unseen):
        raise InputError(
            "huepose eval tables",
            found="no data",
            expected="one of --ycbv DIR, --fast-ycb DIR and --unseen DIR, or several",
        )
    if arguments.boxes == "detect":
        raise InputError(
            "--boxes detect", found="boxes without labels", expected="paper, perturbed, gt, FILE"
        )
    tables: list[Table] = []
    coverage: list[str] = [arguments.note] if arguments.note else []
    of_images: dict[str, list[Entry]] = {method: [] for method in arguments.methods}
    of_tracks: dict[tuple[str, int], list[Entry]] = {
        (method, every): []
        for method in arguments.methods
        if method != "colorpair"
        for every in arguments.every
    }
    names: dict[str, str] = {}
    notes: list[str] = []
    expected: dict[str, int] = {}
    flow: AblationResult | None = None
    unseen = _unseen(arguments) if arguments.unseen else None
    if arguments.ycbv or arguments.fast_ycb:
        bundles = arguments.bundles or _onboarded(arguments)
        models = load_models(bundles)
        names = _names(models)
    if arguments.ycbv:
        of_images, notes, expected = images(
            arguments,
            models,
            arguments.ycbv,
            "ycbv",
            "YCB-Video",
            _wanted(arguments, models),
            arguments.submission,
            arguments.equivalent,
        )
        coverage += [f"YCB-Video: {note}" for note in notes]
    if arguments.ycbv or unseen:
        tables += single_frame_tables(of_images, names, expected, notes, unseen)
    if arguments.fast_ycb:
        of_sequences = TrackSource(
            arguments.fast_ycb, "fast", published("table2").rows, objects=arguments.objects or ()
        )
        of_tracks, notes = tracks(arguments, of_sequences, bundles)
        flow = ablation(arguments, of_sequences, bundles)
        coverage += [f"Fast-YCB: {note}" for note in notes]
    if arguments.fast_ycb or unseen:
        tables += tracking_tables(of_tracks, notes if arguments.fast_ycb else [], unseen)
    coverage += [*unseen.notes, *unseen.image_notes, *unseen.track_notes] if unseen else []
    _write(arguments.out, tables, coverage, of_images, of_tracks, names, unseen, flow)
    return 0


def _names(models: Mapping[str, ReferenceModel]) -> dict[str, str]:
    return {str(m.object_id): name for name, m in models.items() if m.object_id is not None}


def _wanted(arguments: argparse.Namespace, models: Mapping[str, ReferenceModel]) -> list[str] | None:
    """The objects for single frames: those of --objects, else the paper's, else None for all."""
    if arguments.objects:
        return list(arguments.objects)
    return [name for name in published("table1").rows if name in models] or None


def _unseen(arguments: argparse.Namespace) -> Unseen:
    """Procedurally generated objects: render and onboard them if that was not done yet, then measure."""
    from huepose.scenes.official_sets import write_unseen

    if arguments.boxes not in ("paper", "perturbed", "gt"):
        raise InputError(
            "--boxes FILE", found="boxes of other images than those of --unseen", fix="Leave --unseen out."
        )
    folder: Path = arguments.unseen
    write_unseen(folder)
    listed = bop_models(folder / "ycbv" / "models")
    bundles = folder / "bundles"
    _onboard(listed, bundles, folder)
    models = load_models(bundles)
    plain = {m.name for m in listed if m.info.get("texture") == "little"}
    of_images, image_notes, _ = images(arguments, models, folder / "ycbv", "unseen", "unseen objects")
    sequences = TrackSource(folder / "fast", "unseen-fast", tuple(models), "gt")
    of_tracks, track_notes = tracks(arguments, sequences, bundles)
    family = f"{len(models)} by code, {len(plain)} with little texture; nothing was fitted to them"
    said, of_image_set, of_track_set = (
        [f"unseen objects: {note}" for note in notes] for notes in ([family], image_notes, track_notes)
    )
    return Unseen(of_images, of_tracks, _names(models), plain, said, of_image_set, of_track_set)


def _onboarded(arguments: argparse.Namespace) -> Path:
    """The folder OUT/bundles, with the missing reference models added. Raises InputError."""
    meshes = arguments.models or (open_ycbv(arguments.ycbv).models if arguments.ycbv else None)
    if meshes is None:
        raise InputError(
            "huepose eval tables",
            found="no reference models, and no meshes to make them from",
            expected="--bundles DIR or --models DIR",
            fix="BOP's ycbv_models.zip has the meshes of both data sets.",
        )
    out: Path = arguments.out / "bundles"
    models = bop_models(meshes)
    asked = set(arguments.objects or published("table1").rows)
    chosen = [m for m in models if {m.name, str(m.object_id)} & asked]
    if not chosen:  # other objects than the paper's: all of them
        chosen = list(models)
    elif arguments.fast_ycb and not arguments.objects:
        shown = {object_of(path) for path in labelled_sequences(arguments.fast_ycb)[0]}
        chosen += [m for m in models if m.name in shown and m not in chosen]
    _onboard(chosen, out, meshes)
    return out


def _onboard(models: Sequence[BopModel], out: Path, meshes: Path) -> None:
    """Onboard the models that are missing in `out`. Raises InputError."""
    missing = [m for m in models if not model_path(out, m.name).exists()]
    failed = onboard_models(missing, out, paper=True, processes=2) if missing else []
    if failed:
        raise InputError(
            meshes, found=f"no reference model of {', '.join(failed)}", fix="See the lines above."
        )


def _write(
    out: Path,
    tables: Sequence[Table],
    coverage: Sequence[str],
    images: Mapping[str, Sequence[Entry]],
    tracks: Mapping[tuple[str, int], Sequence[Entry]],
    names: Mapping[str, str],
    unseen: Unseen | None,
    flow: AblationResult | None,
) -> None:
    facts = origin()
    record: dict[str, Any] = {
        "origin": facts,
        "coverage": list(coverage),
        "tables": [table.as_json() for table in tables],
    }
    if flow is not None:
        record["ablation"] = flow.summary()
    write_json(out / "results.json", record)
    heading = "\n".join(f"{key}: {value}" for key, value in facts.items())
    text = "\n\n\n".join(table.text() for table in tables)
    write_text(out / "tables.txt", f"{heading}\n\n{text}\n")
    write_text(out / "tables.md", "\n".join(table.markdown() for table in tables))
    for table in tables:
        write_text(out / f"{table.key}.csv", table.csv())
    image_rows = {method: rows_of(entries) for method, entries in images.items()}
    for method in METHODS:
        if method in image_rows:
            write_bop_csv(out / f"huepose-{method}_ycbv-test.csv", bop_results(image_rows[method]))
    track_rows = {run: rows_of(entries) for run, entries in tracks.items()}
    write_text(
        out / "report.html", page(tables, facts, coverage, image_rows, track_rows, names, unseen, flow)
    )
    print(text)
    print(f"\n{out}/report.html, tables.txt, .md, results.json, CSV of the tables and for BOP")
