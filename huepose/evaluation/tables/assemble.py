"""Table I: single frames, with the paper's rows and columns in its order, and our columns beside them.

Images that could not be read, and labels without a reference model, are counted in the notes and in `n of N`.
The unseen objects have their own rows below.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from huepose.evaluation.estimate_rows import frame_of
from huepose.evaluation.summary import Row, mean_figures
from huepose.evaluation.tables.figures import (
    BOP_COLUMNS,
    COLUMNS,
    RECALL,
    Unseen,
    by_name_of,
    figures,
    quarter_visible,
    rows_of,
    spans,
)
from huepose.evaluation.tables.journal import Entry
from huepose.evaluation.tables.published import others, published
from huepose.evaluation.tables.table import Cell, Head, Table
from huepose.support.words import counted


def single_frame_tables(
    by_method: Mapping[str, Sequence[Entry]],
    names: Mapping[str, str],
    expected: Mapping[str, int],
    notes: Sequence[str],
    unseen: Unseen | None = None,
) -> list[Table]:
    """Table I, and the same results in all figures.

    by_method: entries of the same images; names: of the objects, by their id in rows (as text); expected:
    number of labels of the whole set by name, where known."""
    rows = {method: rows_of(entries) for method, entries in by_method.items()}
    by_name = by_name_of(rows, names)
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
    apart = _unseen_images(unseen, tuple(by_method)) if unseen else {}
    empty = (None,) * len(paper.columns)
    for label, (n, own, _) in apart.items():
        ours = [own[m].get(key) for m in by_method for key in ("recall_add", "recall_adds")]
        lines.append((label, (*empty, n, *ours)))
    notes = (*notes, *unseen.notes, *unseen.image_notes) if unseen else tuple(notes)
    note = f"Measured: {counted(seen, 'object')}; the average is over these. {RECALL[0].upper()}{RECALL[1:]}."
    scale = "The published columns but the last are of another scale than recall (hover, or see the CSV)."
    return [
        Table(
            "table1",
            "Table I: single frames",
            tuple(heads),
            tuple(lines),
            (*paper.notes, scale, note, *notes),
        ),
        _all_figures(rows, means, whole, apart, notes),
    ]


_Block = tuple[int, Mapping[str, Mapping[str, float | None]], Mapping[str, Sequence[Row]]]
"""Number of labels, figures by method, and the rows for the intervals (none for averages of objects)."""


def _unseen_images(unseen: Unseen, methods: Sequence[str]) -> dict[str, _Block]:
    """Figures of single objects, averages over objects, and figures of all labels, by the name of the row."""
    rows = {method: rows_of(unseen.images.get(method, ())) for method in methods}
    by_name = by_name_of(rows, unseen.names)
    found = sorted({name for own in by_name.values() for name in own})
    measured = {name: {m: figures(by_name[m].get(name, [])) for m in methods} for name in found}
    counts = {name: max(len(by_name[m].get(name, [])) for m in methods) for name in found}
    out: dict[str, _Block] = {name: (counts[name], measured[name], {}) for name in found}
    for label, part in unseen.parts(found).items():
        means = {m: mean_figures(measured[name][m] for name in part) for m in methods}
        out[f"Average of {label}"] = sum(counts[name] for name in part), means, {}
    textured = {
        m: [row for row in own if unseen.names.get(str(row["object"])) not in unseen.plain]
        for m, own in rows.items()
    }
    for label, chosen in (("unseen, textured", textured), ("unseen objects", rows)):
        n = max(map(len, chosen.values()), default=0)
        out[f"All labels of {label}"] = n, {m: figures(own) for m, own in chosen.items()}, chosen
    return out


def _all_figures(
    rows: Mapping[str, Sequence[Row]],
    means: Mapping[str, Mapping[str, float | None]],
    whole: Mapping[str, Mapping[str, float | None]],
    unseen: Mapping[str, _Block],
    notes: Sequence[str],
) -> Table:
    columns = {**COLUMNS, **BOP_COLUMNS}
    lines: list[tuple[str, tuple[Cell, ...]]] = []

    def quarter(label: str, rows: Sequence[Row]) -> None:
        shown = quarter_visible(rows)
        seen = figures(shown)
        lines.append((f"{label}, a quarter visible", (len(shown), *(seen.get(key) for key in columns))))

    for method in rows:
        for label, block in (("average of objects", means[method]), ("all labels", whole[method])):
            lines.append((f"{method}, {label}", (len(rows[method]), *(block.get(key) for key in columns))))
        quarter(f"{method}, all labels", rows[method])
        lines.append((f"{method}, 95 % of draws", ("", *_spans(rows[method], columns))))
        if any(row["add_m"] != row["add_official_m"] for row in rows[method]):
            declared = figures(rows[method], "add_m") | dict.fromkeys(BOP_COLUMNS)
            cells = tuple(declared[key] for key in columns)
            lines.append((f"{method}, equivalent poses count", (len(rows[method]), *cells)))
        for label, (n, blocks, drawn_from) in unseen.items():
            if drawn_from:
                quarter(f"{method}, {label[0].lower()}{label[1:]}", drawn_from[method])
            if label.startswith(("Average", "All")):
                first = (n, *(blocks[method].get(key) for key in columns))
                lines.append((f"{method}, {label[0].lower()}{label[1:]}", first))
            if drawn_from:
                cells = ("", *_spans(drawn_from[method], columns))
                lines.append((f"{method}, {label.removeprefix('All labels of ')}, 95 % of draws", cells))
    for other in others():
        cells = tuple(other["figures"].get(key) for key in columns)
        lines.append((f"{other['method']} (published)", ("", *cells)))
    sources = tuple(f"{o['method']}: {o['source']}." for o in others())
    drawn = "95 % of draws: where the figure over all labels lies when frames are drawn with replacement."
    heads = (Head("", "n", "labels measured"), *columns.values())
    return Table(
        "table1_figures", "Single frames, in all figures", heads, tuple(lines), (drawn, *sources, *notes)
    )


def _spans(rows: Sequence[Row], columns: Mapping[str, Head]) -> list[Cell]:
    return spans(rows, columns, [frame_of(row) for row in rows])


def _n(count: int, expected: int | None) -> Cell:
    return f"{count} of {expected}" if expected is not None and expected != count else count
