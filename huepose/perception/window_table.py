"""A model's view templates as the detector compares them with windows: fewer views, larger cells, codes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int64
from huepose.model.types import ReferenceModel, ViewTemplates
from huepose.propose.template_table import COARSE_SIDE, TemplateTable, build_table
from huepose.propose.view_codes import codes_of_views
from huepose.support.kept import kept

VIEWS, ROLL_STRIDE = 42, 2
"""The first 42 directions are the icosphere of level 1, 32 degrees apart; every second roll, 30 degrees."""

MIN_COVERAGE = 0.25
"""Least coverage (0..1) of a cell that counts."""

_GRID = np.indices((COARSE_SIDE, COARSE_SIDE)) - (COARSE_SIDE - 1) / 2.0
_MIDDLE = (np.hypot(*_GRID) <= COARSE_SIDE / 4.0).ravel().astype(np.float32)


@dataclass(frozen=True, eq=False)
class WindowTable:
    """Of N views: codes (N, D) float32; rotations (N, 3, 3), origins (N, 3): as of a `TemplateTable`; used
    (P,): the cells that any of them covers; coverage (N, P) float32 of these, relief (N, P) float32:
    millimetres from a view's own median depth, times coverage. hues (V, 2) float32: what the two colour
    opponents are in the middle of the views from each direction."""

    codes: Float32
    rotations: Float64
    origins: Float64
    used: Int64
    coverage: Float32
    relief: Float32
    hues: Float32


def window_table(model: ReferenceModel) -> WindowTable:
    """The table of a model (about 2 MB, 0.3 s where it has to be made)."""
    return kept(WindowTable, model.digest, lambda: _made(model))


def _made(model: ReferenceModel) -> WindowTable:
    t = model.templates
    some = ViewTemplates(t.directions[:VIEWS], t.planes[:VIEWS, ::ROLL_STRIDE], t.origins[:VIEWS], t.span)
    table = build_table(some, model.diameter_m, min_coverage=MIN_COVERAGE)
    return WindowTable(
        codes_of_views(model.mesh, model.diameter_m), table.rotations, table.origins,
        table.used, table.coverage, table.first[3], _hues(table, some.planes.shape[1]),
    )  # fmt: skip


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
