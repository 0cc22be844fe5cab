"""From what was measured to the paper's tables: its rows and columns in its order, ours beside them.

A label or frame without a pose is wrong in every figure. What could not be read, or has no model, is counted
in the notes and in `n of N`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from huepose.datasets.fast_ycb import object_of
from huepose.evaluation import metrics
from huepose.evaluation.bootstrap import frame_intervals
from huepose.evaluation.bop_errors import average_recalls
from huepose.evaluation.measured import BLOCK_NS
from huepose.evaluation.summary import grouped, mean_figures, mean_of
from huepose.evaluation.tables.journal import Entry
from huepose.evaluation.tables.published import others, published
from huepose.evaluation.tables.table import Cell, Head, Table
from huepose.geometry.arrays import Float64

Row = Mapping[str, Any]
RECALL = "recall: error under a tenth of the diameter, against the labels as they are, percent"
_AUC = "area under the accuracy curve from 0 to 0.1 m: mean of max(0, 1 - error / 0.1 m), percent"
_VOC = "the same area as the toolboxes of YCB-Video and ROFT sum it (VOCap), percent"
_BOP = "average recall of the BOP challenge, percent"
_COLUMNS = {
    "recall_add": Head("recall", "ADD", RECALL),
    "recall_adds": Head("recall", "ADD-S", RECALL),
    "auc_add": Head("AUC", "ADD", _AUC),
    "auc_adds": Head("AUC", "ADD-S", _AUC),
    "auc_voc_add": Head("AUC, VOCap", "ADD", _VOC),
    "auc_voc_adds": Head("AUC, VOCap", "ADD-S", _VOC),
}
_BOP_COLUMNS = {
    "ar": Head("BOP", "AR", _BOP),
    "ar_vsd": Head("BOP", "VSD", _BOP),
    "ar_mssd": Head("BOP", "MSSD", _BOP),
    "ar_mspd": Head("BOP", "MSPD", _BOP),
}
_TRACK_COLUMNS = {
    "rmse_cm": Head("RMSE", "cm", "ROFT's error of position"),
    "rmse_deg": Head("RMSE", "deg", "ROFT's error of orientation"),
    "rmse_cm_s": Head("RMSE", "cm/s", "ROFT's error of the origin's velocity"),
    "rmse_deg_s": Head("RMSE", "deg/s", "ROFT's error of the turn's velocity"),
    "coverage_tracking": Head("state", "TRACKING", "percent of visible frames from confirmation on"),
    "false_tracking_rate": Head("state", "false", "percent of frames that are TRACKING and wrong"),
}


def rows_of(entries: Sequence[Entry]) -> list[Row]:
    """All rows of the entries that could be read."""
    return [row for entry in entries for row in entry.get("rows", [])]


def scored(rows: Sequence[Row]) -> list[Row]:
    """Rows of a track that count: labelled and not gone."""
    return [row for row in rows if row["right"] is not None and not row["gone"]]


def errors(rows: Sequence[Row], key: str) -> Float64:
    """Errors (N,) in metres; inf where there is no pose."""
    return np.array([np.inf if row[key] is None else row[key] for row in rows], np.float64)


def figures(rows: Sequence[Row], add_key: str = "add_official_m") -> dict[str, float | None]:
    """Recall and AUC both ways of N rows, by default against the labels as they are; AR where it was
    measured."""
    if not rows:
        return dict.fromkeys((*_COLUMNS, *_BOP_COLUMNS))
    add = errors(rows, add_key if add_key in rows[0] else "add_m")
    adds, diameters = errors(rows, "adds_m"), np.array([row["diameter_m"] for row in rows])
    bop = [row["bop"] for row in rows if "bop" in row]
    return {
        **metrics.four_figures(add, adds, diameters),
        "auc_voc_add": metrics.auc_voc(add),
        "auc_voc_adds": metrics.auc_voc(adds),
        **average_recalls(bop if len(bop) == len(rows) else []),
    }


def single_frame_tables(
    by_method: Mapping[str, Sequence[Entry]],
    names: Mapping[str, str],
    expected: Mapping[str, int],
    notes: Sequence[str],
) -> list[Table]:
    """Table I, and the same results in all figures.

    by_method: entries of the same images; names: of the objects, by how rows call them (as text); expected:
    labels of the whole set by name, where known."""
    rows = {method: rows_of(entries) for method, entries in by_method.items()}
    by_name = {
        method: grouped(own, lambda row: names.get(str(row["object"]), str(row["object"])))
        for method, own in rows.items()
    }
    paper = published("table1")
    extra = sorted({name for own in by_name.values() for name in own} - set(paper.rows))
    measured = {
        name: {method: figures(own.get(name, [])) for method, own in by_name.items()}
        for name in (*paper.rows, *extra)
    }
    counts = {name: len(next(iter(by_name.values())).get(name, [])) for name in measured}
    heads = [*paper.heads, Head("", "n", "labels measured, of all")]
    for method in by_method:
        heads += [Head(method, figure, RECALL) for figure in ("ADD", "ADD-S")]

    def line(name: str) -> tuple[str, tuple[Cell, ...]]:
        ours = [measured[name][m][key] for m in by_method for key in ("recall_add", "recall_adds")]
        return name, (*paper.cells(name), _n(counts[name], expected.get(name)), *ours)

    lines = [line(name) for name in (*paper.rows, *extra)]
    means = {m: mean_figures(block[m] for block in measured.values()) for m in by_method}
    whole = {m: figures(rows[m]) for m in by_method}
    for label, first, blocks in (
        ("Average of objects", paper.average, means),
        ("All labels", (None,) * len(paper.columns), whole),
    ):
        ours = [blocks[m][key] for m in by_method for key in ("recall_add", "recall_adds")]
        lines.append((label, (*first, _n(sum(counts.values()), sum(expected.values()) or None), *ours)))
    seen = sum(bool(n) for n in counts.values())
    note = f"Measured: {seen} objects; the average is over these. {RECALL[0].upper()}{RECALL[1:]}."
    scale = "The published columns but the last are of another scale than recall (hover, or see the CSV)."
    return [
        Table(
            "table1",
            "Table I: single frames",
            tuple(heads),
            tuple(lines),
            (*paper.notes, scale, note, *notes),
        ),
        _all_figures(rows, means, whole, notes),
    ]


def _all_figures(
    rows: Mapping[str, Sequence[Row]],
    means: Mapping[str, Mapping[str, float | None]],
    whole: Mapping[str, Mapping[str, float | None]],
    notes: Sequence[str],
) -> Table:
    columns = {**_COLUMNS, **_BOP_COLUMNS}
    lines: list[tuple[str, tuple[Cell, ...]]] = []
    for method in rows:
        for label, block in (("average of objects", means[method]), ("all labels", whole[method])):
            lines.append((f"{method}, {label}", (len(rows[method]), *(block.get(key) for key in columns))))
        lines.append((f"{method}, 95 % of draws", ("", *_spans(rows[method], columns, _frame))))
        if any(row["add_m"] != row["add_official_m"] for row in rows[method]):
            declared = figures(rows[method], "add_m") | dict.fromkeys(_BOP_COLUMNS)
            cells = tuple(declared[key] for key in columns)
            lines.append((f"{method}, equivalent poses count", (len(rows[method]), *cells)))
    for other in others():
        cells = tuple(other["figures"].get(key) for key in columns)
        lines.append((f"{other['method']} (published)", ("", *cells)))
    sources = tuple(f"{o['method']}: {o['source']}." for o in others())
    drawn = "95 % of draws: where the figure over all labels lies when frames are drawn with replacement."
    heads = (Head("", "n", "labels measured"), *columns.values())
    return Table(
        "table1_figures", "Single frames, in all figures", heads, tuple(lines), (drawn, *sources, *notes)
    )


def tracking_tables(runs: Mapping[tuple[str, int], Sequence[Entry]], notes: Sequence[str]) -> list[Table]:
    """Table II, and the same tracks in all figures. runs: entries by (method, every N-th frame)."""
    paper = published("table2")
    by_name = {
        run: {object_of(entry["sequence"]): entry for entry in entries if "rows" in entry}
        for run, entries in runs.items()
    }
    extra = sorted({name for own in by_name.values() for name in own} - set(paper.rows))
    heads = (
        *paper.heads,
        Head("", "frames", "labelled frames that are scored, of every frame"),
        *(Head(_run(run), "AUC ADD", _VOC) for run in runs),
    )
    first = next(iter(by_name.values()), {})

    def line(name: str) -> tuple[str, tuple[Cell, ...]]:
        values = [own[name]["summary"]["auc_voc_add"] if name in own else None for own in by_name.values()]
        frames = len(scored(first[name]["rows"])) if name in first else 0
        return name, (*paper.cells(name), frames, *values)

    lines = [line(name) for name in (*paper.rows, *extra)]
    pooled = {run: scored(rows_of(list(own.values()))) for run, own in by_name.items()}
    average = [mean_of([e["summary"]["auc_voc_add"] for e in own.values()]) for own in by_name.values()]
    frames = len(next(iter(pooled.values()), []))
    lines.append(("Average", (*paper.average, frames, *average)))
    everything = [figures(own)["auc_voc_add"] for own in pooled.values()]
    lines.append(("All frames", (*(None for _ in paper.columns), frames, *everything)))
    columns = {**_COLUMNS, **_TRACK_COLUMNS}
    more: list[tuple[str, tuple[Cell, ...]]] = []
    for run, own in by_name.items():
        mean = mean_figures({key: entry["summary"].get(key) for key in columns} for entry in own.values())
        more.append((f"{_run(run)}, average", (len(own), *(mean.get(key) for key in columns))))
        everywhere: dict[str, float | None] = {**figures(pooled[run])}
        more.append(
            (f"{_run(run)}, all frames", (len(pooled[run]), *(everywhere.get(key) for key in columns)))
        )
        more.append((f"{_run(run)}, 95 % of draws", ("", *_spans(pooled[run], columns, _half_second))))
    drawn = (
        "95 % of draws: where the figure over all frames lies when half seconds are drawn with replacement."
    )
    return [
        Table("table2", "Table II: tracking, AUC of ADD", heads, tuple(lines), (*paper.notes, *notes), 2),
        Table(
            "table2_figures",
            "Tracking, in all figures",
            (Head("", "n", "sequences, or frames"), *columns.values()),
            tuple(more),
            (drawn, *notes),
            2,
        ),
    ]


def _run(run: tuple[str, int]) -> str:
    method, every = run
    return method if every == 1 else f"{method}, every {every}th"


def _n(count: int, expected: int | None) -> Cell:
    return f"{count} of {expected}" if expected is not None and expected != count else count


def _frame(row: Row) -> tuple[Any, ...]:
    return row["scene"], row["image"]


def _half_second(row: Row) -> tuple[Any, ...]:
    return row["sequence"], row["stamp_ns"] // BLOCK_NS


def _spans(rows: Sequence[Row], columns: Mapping[str, Head], unit: Any) -> list[Cell]:
    """`low to high` of the figures that are means over rows, nothing for the others."""
    if not rows:
        return [None] * len(columns)
    add = errors(rows, "add_official_m" if "add_official_m" in rows[0] else "add_m")
    diameters = np.array([row["diameter_m"] for row in rows])
    scores = metrics.pose_scores(add, errors(rows, "adds_m"), diameters)
    spans = frame_intervals(scores, [unit(row) for row in rows])
    return [f"{spans[k][0]:.0f} to {spans[k][1]:.0f}" if k in spans else "" for k in columns]
