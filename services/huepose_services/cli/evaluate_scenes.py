"""What the subcommands of `huepose eval` share: scenes, models, tables."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from huepose.datasets import files
from huepose.datasets.bop import BopScene
from huepose.datasets.fast_ycb import FastYcbSequence, labelled_sequences, object_of
from huepose.datasets.types import Scene, SomeImages
from huepose.datasets.ycbv_folder import YcbvFolder, open_ycbv
from huepose.evaluation.bop_errors import BopObject
from huepose.evaluation.instances import instance_counts
from huepose.evaluation.summary import span, table
from huepose.evaluation.targets import Targets, posecnn_offset_m
from huepose.model import ReferenceModel, load_models
from huepose.onboarding.meshes import read_geometry
from huepose.support.errors import InputError
from huepose.support.words import known
from huepose_services.cli.options import say

FIGURES = {"recall_add": "ADD", "recall_adds": "ADD-S", "auc_add": "AUC ADD", "auc_adds": "AUC ADD-S"}


def open_bop(paths: Sequence[Path]) -> list[Scene]:
    """BOP scenes, named by their folders; each must have labels. Raises InputError."""
    scenes: list[Scene] = []
    for path, name in zip(paths, scene_names(paths), strict=True):
        scene = BopScene(path)
        scene.name = name
        if not scene.labelled:
            raise InputError(
                path / "scene_gt.json", found="no labels", expected="ground truth to measure against"
            )
        scenes.append(scene)
    return scenes


def scene_names(paths: Sequence[Path]) -> list[str]:
    """The names of scenes: their folders' names. Where these are the same, as many parent folders are added
    as make them distinct. Raises InputError for a folder that is given twice.

    >>> scene_names([Path("a/000001"), Path("b/000001"), Path("b/000002")])
    ['a-000001', 'b-000001', '000002']
    """
    parts = [Path(os.path.abspath(path)).parts for path in paths]
    if twice := [path for path, part in zip(paths, parts, strict=True) if parts.count(part) > 1]:
        raise InputError(f"scene {twice[0]}", found="the same folder twice", expected="each folder once")
    names = [part[-1] for part in parts]
    for length in range(2, max(map(len, parts), default=0)):
        alike = {name for name, count in Counter(names).items() if count > 1}
        names = [
            "-".join(part[-length:]) if name in alike else name
            for part, name in zip(parts, names, strict=True)
        ]
    return names


def open_ycbv_folder(path: Path) -> YcbvFolder:
    """A download of YCB-Video; prints which test images are missing. Raises InputError."""
    folder = open_ycbv(path)
    for line in folder.coverage.lines():
        say(f"{path}: {line}")
    return folder


def open_fast_ycb(
    given: Sequence[Path], bundles: Path, broken: list[str] | None = None
) -> tuple[list[Scene], dict[str, ReferenceModel]]:
    """Fast-YCB sequences, or all sequences of a download, with the reference models of their objects; prints
    what is missing. Raises InputError. If `broken` is given, errors of single sequences are added to it
    instead, as long as one sequence can be opened."""
    paths: list[Path] = []
    for folder in given:
        found, notes = labelled_sequences(folder)
        paths += found
        for note in notes:
            say(note)
    models = load_models(bundles, sorted({object_of(path) for path in paths}))
    scenes: list[Scene] = []
    for path in paths:
        model = models[object_of(path)]
        offset_m = posecnn_offset_m(model)
        if offset_m is None:
            raise InputError(
                f"reference model '{model.name}'",
                found="no frame offset, so the labels cannot be brought to its frame",
                fix="Name it as YCB-Video does, or onboard it with `huepose onboard-bop` from a folder with "
                "frame_offsets.json.",
            )
        try:
            sequence = FastYcbSequence(path, offset_m)
        except InputError as error:
            if broken is None:
                raise
            broken.append(str(error))
            continue
        # Frames without depth, as in a partial download, are left out; the notes say how many.
        scenes.append(SomeImages(sequence, sequence.with_depth or sequence.image_ids))
    if not scenes:
        raise InputError("Fast-YCB", found=f"no sequence that can be read: {'; '.join(broken or [])}")
    return scenes, models


def open_scenes(
    fast_ycb: Sequence[Path] | None, bop: Sequence[Path] | None, bundles: Path
) -> tuple[list[Scene], dict[str, ReferenceModel]]:
    """Either kind of scenes, with reference models. Raises InputError."""
    if fast_ycb:
        return open_fast_ycb(fast_ycb, bundles)
    return open_bop(bop or []), load_models(bundles)


def shown(scenes: Sequence[Scene], targets: Targets) -> list[str]:
    """Names of the reference models among `targets` that have labels in the scenes."""
    return sorted({name for scene in scenes for name in instance_counts(scene, scene.image_ids, targets)})


def bop_objects(info: Path, models: Mapping[str, ReferenceModel]) -> dict[int, BopObject]:
    """The objects for BOP's errors, by id: diameter and symmetries from models_info.json, and the mesh beside
    it (BOP's `obj_NNNNNN.ply`, millimetres), or else the reference model's. Raises InputError."""
    infos = files.read_json(info)
    measured = {}
    for model in models.values():
        number = model.object_id
        if number is not None and "diameter" in infos.get(str(number), {}):
            file = info.parent / f"obj_{number:06d}.ply"
            mesh = read_geometry(file, "mm") if file.exists() else model.mesh
            measured[number] = BopObject.of(mesh, infos[str(number)])
    return measured


def intervals_line(summary: Mapping[str, Any], drawn: str) -> str:
    """The 95 % intervals of the four figures, in words. drawn: which rows, and what they are sampled over."""
    return f"95 % intervals {drawn}: " + ", ".join(span(summary["interval95"][key]) for key in FIGURES)


def roft_line(summary: Mapping[str, Any]) -> str:
    """ROFT's errors, in words."""
    units = {"rmse_cm": "cm", "rmse_deg": "degrees", "rmse_cm_s": "cm/s", "rmse_deg_s": "degrees/s"}
    return "RMSE " + ", ".join(f"{known(summary.get(key), '.2f')} {unit}" for key, unit in units.items())


def figure_table(first: str, blocks: Mapping[Any, Mapping[str, Any]], more: Mapping[str, str]) -> str:
    """A table with a row for each block: the columns `more` (key to heading) and the four figures."""
    columns = {**more, **FIGURES}
    rows = [[str(name), *(block.get(key) for key in columns)] for name, block in blocks.items()]
    return table([first, *columns.values()], rows)


def states_line(summary: Mapping[str, Any]) -> str:
    """The figures about the states, in words."""
    s = summary
    never = f" (never: {s['never_confirmed']:g})" if s["never_confirmed"] else ""
    return (
        f"TRACKING in {known(s['coverage_tracking'], unit=' %')} of visible frames from confirmation on, "
        f"false in {known(s['false_tracking_frames'], 'g')} "
        f"({known(s['false_tracking_rate'], '.2f', ' %')}), LOST in {known(s['lost_frames'], 'g')}; "
        f"confirmed after {known(s['confirmed_after_s'], '.2f', ' s')}{never}, "
        f"declared lost after {known(s['declared_lost_after_frames'], 'g', ' frames')}, "
        f"reacquired after {known(s['reacquired_after_s'], '.2f', ' s')}"
    )
