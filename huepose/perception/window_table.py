"""A model's view templates as the detector compares them with windows: fewer views, larger cells, rims."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Float32
from huepose.model.types import ReferenceModel, ViewTemplates
from huepose.propose.template_table import COARSE_SIDE, TemplateTable, build_table

VIEWS, ROLL_STRIDE = 42, 2
"""The first 42 directions are the icosphere of level 1, 32 degrees apart; every second roll, 30 degrees."""

MIN_COVERAGE = 0.25

_GRID = np.indices((COARSE_SIDE, COARSE_SIDE)) - (COARSE_SIDE - 1) / 2.0
_MIDDLE = (np.hypot(*_GRID) <= COARSE_SIDE / 4.0).ravel().astype(np.float32)


@dataclass(frozen=True, eq=False)
class WindowTable:
    """views: the table of the quick look at a part of a model's views; rim (N, 64) float32: cells beside what
    each view covers, their sum 1 (0 where the view fills its window); hues (V, 2) float32: what the two
    colour opponents are in the middle of each direction's views."""

    views: TemplateTable
    rim: Float32
    hues: Float32


def window_table(model: ReferenceModel) -> WindowTable:
    """The table of a model (about 3 MB)."""
    t = model.templates
    some = ViewTemplates(t.directions[:VIEWS], t.planes[:VIEWS, ::ROLL_STRIDE], t.origins[:VIEWS], t.span)
    table = build_table(some, model.diameter_m, min_coverage=MIN_COVERAGE)
    return WindowTable(table, _rims(_in_all_cells(table, table.coverage)), _hues(table, some.planes.shape[1]))


def middle_hues(weight: Float32, weighted: Float32) -> Float32:
    """Means (N, 2) of two channels over the middle cells: weight (N, P), weighted (2, N, P)."""
    total = np.maximum(weight @ _MIDDLE, np.float32(1e-3))
    return np.asarray((weighted @ _MIDDLE / total).T, dtype=np.float32)


def _hues(table: TemplateTable, rolls: int) -> Float32:
    means = middle_hues(_in_all_cells(table, table.coverage), _in_all_cells(table, table.first[1:3]))
    return np.asarray(means.reshape(-1, rolls, 2).mean(1), dtype=np.float32)


def _in_all_cells(table: TemplateTable, values: Float32) -> Float32:
    """Values (..., P) of the cells that a table uses, in all cells of a window."""
    out = np.zeros((*values.shape[:-1], COARSE_SIDE**2), np.float32)
    out[..., table.used] = values
    return out


def _rims(coverage: Float32) -> Float32:
    rims = np.zeros_like(coverage)
    for rim, covered in zip(rims, coverage.reshape(-1, COARSE_SIDE, COARSE_SIDE), strict=True):
        inside = (covered > 0).astype(np.uint8)
        rim[:] = (cv2.dilate(inside, np.ones((3, 3), np.uint8)) - inside).ravel()
    return np.asarray(rims / np.maximum(rims.sum(1, keepdims=True), np.float32(1)), dtype=np.float32)
