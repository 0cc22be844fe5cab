"""What the sub-verbs of `huepose eval` share: scenes, models, tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from huepose.datasets.bop import BopScene
from huepose.datasets.fast_ycb import FastYcbSequence, object_of
from huepose.datasets.types import Scene
from huepose.evaluation.instances import instance_counts
from huepose.evaluation.summary import table
from huepose.evaluation.targets import Targets
from huepose.model import ReferenceModel, load_models
from huepose.support.errors import InputError

FIGURES = {"recall_add": "ADD", "recall_adds": "ADD-S", "auc_add": "AUC ADD", "auc_adds": "AUC ADD-S"}


def open_bop(paths: Sequence[Path]) -> list[Scene]:
    """BOP scenes; each must have labels. Raises InputError."""
    scenes: list[Scene] = []
    for path in paths:
        scene = BopScene(path)
        if not scene.labelled:
            raise InputError(
                path / "scene_gt.json", found="no labels", expected="ground truth to measure against"
            )
        scenes.append(scene)
    return scenes


def open_fast_ycb(paths: Sequence[Path], bundles: Path) -> tuple[list[Scene], dict[str, ReferenceModel]]:
    """Fast-YCB sequences with the reference models of their objects. Raises InputError."""
    models = load_models(bundles, sorted({object_of(path) for path in paths}))
    scenes: list[Scene] = []
    for path in paths:
        model = models[object_of(path)]
        if model.frame_offset_m is None:
            raise InputError(
                f"reference model '{model.name}'",
                found="no frame offset, so the labels cannot be brought to its frame",
                fix="Onboard it with `huepose onboard-bop` from a folder with frame_offsets.json.",
            )
        sequence = FastYcbSequence(path, model.frame_offset_m)
        if not sequence.labelled:
            raise InputError(
                path / "gt" / "poses_ycb.txt",
                found="no such file",
                expected="ground truth to measure against",
            )
        scenes.append(sequence)
    return scenes, models


def open_scenes(
    fast_ycb: Sequence[Path] | None, bop: Sequence[Path] | None, bundles: Path
) -> tuple[list[Scene], dict[str, ReferenceModel]]:
    """Either kind of scenes, with reference models. Raises InputError."""
    if fast_ycb:
        return open_fast_ycb(fast_ycb, bundles)
    return open_bop(bop or []), load_models(bundles)


def shown(scenes: Sequence[Scene], targets: Targets) -> list[str]:
    """Names of the reference models that the scenes have labels of, of those that are wanted."""
    return sorted({name for scene in scenes for name in instance_counts(scene, scene.image_ids, targets)})


def figure_table(
    first: str, blocks: Mapping[Any, Mapping[str, Any]], more: Mapping[str, str] | None = None
) -> str:
    """A row for each block with the four figures, and the columns of `more` (key to heading)."""
    columns = {**(more or {}), **FIGURES}
    rows = [[str(name), *(block.get(key) for key in columns)] for name, block in blocks.items()]
    return table([first, *columns.values()], rows)


def states_line(summary: Mapping[str, Any]) -> str:
    """What the states were worth, in words."""

    def shown_as(key: str, unit: str = "", form: str = ".1f") -> str:
        value = summary[key]
        return "-" if value is None else f"{value:{form}}{unit}"

    return (
        f"TRACKING in {shown_as('coverage_tracking', ' %')} of visible frames, "
        f"false in {shown_as('false_tracking_frames', form='g')} "
        f"({shown_as('false_tracking_rate', ' %', '.2f')}), LOST in {shown_as('lost_frames', form='g')}; "
        f"confirmed after {shown_as('confirmed_after_s', ' s', '.2f')}, "
        f"declared lost after {shown_as('declared_lost_after_frames', ' frames', 'g')}, "
        f"reacquired after {shown_as('reacquired_after_s', ' s', '.2f')}"
    )
