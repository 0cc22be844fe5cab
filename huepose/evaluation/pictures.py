"""Plots of results (`--plots`): every frame with the poses drawn over it, and errors over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from huepose.datasets.types import Sample
from huepose.drawing.canvas import FONT, INK, Colour
from huepose.drawing.overlay import draw_label, draw_mask_outline, silhouette
from huepose.drawing.plots import line_plot
from huepose.evaluation.estimate_rows import EstimateRow
from huepose.evaluation.perception_rows import FrameFigures
from huepose.evaluation.summary import grouped
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_rows import TrackResult, TrackRow
from huepose.geometry.arrays import UInt8
from huepose.geometry.box import Box
from huepose.support.files import write_picture

RIGHT, WRONG, TRUTH = (60, 200, 80), (235, 60, 50), (255, 255, 255)
MISSED = (250, 200, 40)


def draw_rows(sample: Sample, rows: Sequence[EstimateRow | TrackRow], targets: Targets) -> UInt8:
    """The frame (H + h, W, 3) uint8 RGB with the outline of each label in white, and of each pose in green if
    right, in red if wrong. The rows are numbered, and listed below with ADD, quality and state."""
    picture, notes = sample.frame.color, []
    truths = {truth.instance: truth for truth in sample.truths}
    for number, row in enumerate(rows, 1):
        model = targets.named(row.object)
        assert model is not None  # a row is of one of the targets
        instance = row.instance if isinstance(row, EstimateRow) else row.gt_instance
        truth = truths.get(instance) if instance is not None else None
        outline = np.zeros(picture.shape[:2], bool)
        if truth is not None and truth.T_cam_obj is not None:
            outline = silhouette(model.mesh, truth.T_cam_obj, sample.frame.camera)
            picture = draw_mask_outline(picture, outline, TRUTH, 1)
        color = RIGHT if row.T_cam_obj is not None and row.error is not None and row.error.right else WRONG
        if row.T_cam_obj is not None:
            outline = silhouette(model.mesh, row.T_cam_obj, sample.frame.camera)
            picture = draw_mask_outline(picture, outline, color, 1)
        box = Box.of_mask(outline)
        if box is not None:
            picture = draw_label(picture, str(number), (box.x, box.y), color, 0.4)
        notes.append((f"{number} {model.name}  {_words(row)}", color))
    return np.vstack([picture, _list(notes, picture.shape[1])])


def _words(row: EstimateRow | TrackRow) -> str:
    state = row.state or "nothing published"
    if row.T_cam_obj is None:
        return f"no pose, {state}"
    add = "no label" if row.error is None else f"{1000 * row.error.add_m:.1f} mm"
    return f"{add}, quality {row.quality:.2f}, {state}"


def _list(notes: Sequence[tuple[str, Colour]], width: int) -> UInt8:
    """Lines of text in two columns, each with a bar in its colour."""
    lines = (len(notes) + 1) // 2
    page: UInt8 = np.full((18 * lines + 8, width, 3), 250, np.uint8)
    for k, (text, color) in enumerate(notes):
        x, y = (k // lines) * (width // 2) + 6, 18 * (k % lines) + 13
        cv2.line(page, (x, y), (x + 12, y), color, 5)
        cv2.putText(page, text, (x + 18, y + 4), FONT, 0.36, INK, 1, cv2.LINE_AA)
    return page


class PictureFolder:
    """Writes pictures into a folder; the folder is made if needed."""

    def __init__(self, folder: Path, targets: Targets) -> None:
        self._folder, self._targets = folder, targets

    def frame(self, sample: Sample, rows: Sequence[EstimateRow] | Sequence[TrackRow]) -> None:
        """`frames/SCENE_IMAGE_sSEED.png`."""
        if rows:
            name = f"frames/{sample.scene}_{sample.image:06d}_s{rows[0].seed}.png"
            self._write(name, draw_rows(sample, rows, self._targets))

    def tracks(self, result: TrackResult) -> None:
        """`errors_SEQUENCE.png`: errors over time."""
        scored = [row for row in result.rows if row.scored]
        for name, own in grouped(scored, lambda row: row.sequence).items():
            seeds = len({row.seed for row in own})
            lines = {
                f"{number}/{ordinal}" + (f", seed {seed}" if seeds > 1 else ""): (
                    np.array([float(row.frame) for row in part]),
                    np.array([_millimetres(row) for row in part]),
                )
                for (number, ordinal, seed), part in grouped(own, _line).items()
            }
            picture = line_plot(lines, name, "frame", "ADD in mm (a gap: no pose)", marks=True)
            self._write(f"errors_{name}.png", picture)

    def _write(self, name: str, picture: UInt8) -> None:
        write_picture(self._folder / name, picture)


def _line(row: TrackRow) -> tuple[int | str, int, int]:
    """The line of a plot to which a row belongs."""
    return row.object, row.ordinal, row.seed


def _millimetres(row: TrackRow) -> float:
    return 1000 * row.error.add_m if row.error is not None and row.T_cam_obj is not None else np.nan


def write_perception(folder: Path, sample: Sample, figures: FrameFigures) -> None:
    """Write SCENE_IMAGE.png of one frame: found labels green, missed ones yellow, false boxes red."""
    write_picture(folder / f"{sample.scene}_{sample.image:06d}.png", draw_perception(sample, figures))


def draw_perception(sample: Sample, figures: FrameFigures) -> UInt8:
    """The frame (H, W, 3) uint8 RGB with boxes and names."""
    picture = sample.frame.color.copy()
    for row in figures.rows:
        note = row.name if row.quality is None else f"{row.name} {row.quality:.2f}"
        picture = _named_box(picture, row.box, note, RIGHT if row.found else MISSED)
    for wrong in figures.false:
        picture = _named_box(picture, wrong.box, f"{wrong.name} {wrong.quality:.2f}", WRONG)
    return picture


def _named_box(picture: UInt8, box: Box, note: str, color: tuple[int, int, int]) -> UInt8:
    cv2.rectangle(picture, (round(box.x), round(box.y)), (round(box.x1) - 1, round(box.y1) - 1), color, 2)
    return draw_label(picture, note, (box.x, box.y), color, 0.4)
