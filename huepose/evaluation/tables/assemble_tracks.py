"""Table II: tracks, with the paper's rows and columns in its order, and our columns beside them.

Sequences of unseen objects have their own rows below.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from huepose.datasets.fast_ycb import object_of
from huepose.evaluation.measured import unit_of
from huepose.evaluation.summary import Row, mean_figures, mean_of
from huepose.evaluation.tables.figures import COLUMNS, VOC, Unseen, figures, rows_of, scored, spans
from huepose.evaluation.tables.journal import Entry
from huepose.evaluation.tables.published import published
from huepose.evaluation.tables.table import Cell, Head, Table

Run = tuple[str, int]
"""Method, and N: every N-th frame is used."""

Line = tuple[str, tuple[Cell, ...]]
_ALL = {
    **COLUMNS,
    "rmse_cm": Head("RMSE", "cm", "ROFT's error of position"),
    "rmse_deg": Head("RMSE", "deg", "ROFT's error of orientation"),
    "rmse_cm_s": Head("RMSE", "cm/s", "ROFT's error of the origin's velocity"),
    "rmse_deg_s": Head("RMSE", "deg/s", "ROFT's error of the angular velocity"),
    "coverage_tracking": Head("state", "TRACKING", "percent of visible frames from confirmation on"),
    "false_tracking_rate": Head("state", "false", "percent of frames that are TRACKING and wrong"),
}


@dataclass(frozen=True, eq=False)
class _Tracks:
    """by_run: the entries of each run that could be read, with the names of their objects."""

    by_run: Mapping[Run, Sequence[tuple[str, Entry]]]

    @staticmethod
    def of(runs: Mapping[Run, Sequence[Entry]]) -> _Tracks:
        return _Tracks(
            {
                run: [(object_of(entry["sequence"]), entry) for entry in entries if "rows" in entry]
                for run, entries in runs.items()
            }
        )

    @property
    def names(self) -> list[str]:
        return sorted({name for own in self.by_run.values() for name, _ in own})

    def rows(self, run: Run, names: Collection[str]) -> list[Row]:
        return scored(rows_of([entry for name, entry in self.by_run[run] if name in names]))

    def frames(self, names: Collection[str]) -> int:
        """Number of scored frames of these objects in the first run."""
        return len(self.rows(next(iter(self.by_run)), names)) if self.by_run else 0

    def averages(self, names: Collection[str]) -> list[float | None]:
        """AUC of each run: the mean over the sequences of these objects."""
        return [
            mean_of([e["summary"]["auc_voc_add"] for name, e in own if name in names])
            for own in self.by_run.values()
        ]

    def pooled(self, names: Collection[str]) -> list[float | None]:
        """AUC of each run over all frames of these objects."""
        return [figures(self.rows(run, names))["auc_voc_add"] for run in self.by_run]

    def lines(self, run: Run, of: str, parts: Mapping[str, Collection[str]]) -> list[Line]:
        """All figures of a run: averages over parts of the objects, and figures over all frames with
        intervals."""
        own, lines = self.by_run[run], list[Line]()
        for label, names in parts.items():
            chosen = [entry["summary"] for name, entry in own if name in names]
            mean = mean_figures({key: summary.get(key) for key in _ALL} for summary in chosen)
            lines.append((f"{_run(run)}, {label}", (len(chosen), *(mean.get(key) for key in _ALL))))
        rows = self.rows(run, self.names)
        everywhere: Mapping[str, float | None] = figures(rows)
        cells = tuple(everywhere.get(key) for key in _ALL)
        lines.append((f"{_run(run)}, all frames{of}", (len(rows), *cells)))
        units = unit_of(rows)
        label = f"{_run(run)}, all frames{of}, 95 % of draws of {units.many}"
        lines.append((label, ("", *spans(rows, _ALL, units.of))))
        return lines


def tracking_tables(
    runs: Mapping[Run, Sequence[Entry]], notes: Sequence[str], unseen: Unseen | None = None
) -> list[Table]:
    """Table II, and the same tracks in all figures. runs: entries by (method, N)."""
    paper, tracks = published("table2"), _Tracks.of(runs)
    heads = (
        *paper.heads,
        Head("", "frames", "labelled frames that are scored, of every frame"),
        *(Head(_run(run), "AUC ADD", VOC) for run in runs),
    )
    named = (*paper.rows, *(name for name in tracks.names if name not in paper.rows))
    empty = (None,) * len(paper.columns)
    lines: list[Line] = [
        (name, (*paper.cells(name), tracks.frames([name]), *tracks.averages([name]))) for name in named
    ]
    frames = tracks.frames(named)
    lines.append(("Average", (*paper.average, frames, *tracks.averages(named))))
    lines.append(("All frames", (*empty, frames, *tracks.pooled(named))))
    more = [line for run in runs for line in tracks.lines(run, "", {"average": named})]
    if unseen is not None:
        apart = _Tracks.of({run: unseen.tracks[run] for run in runs})
        parts = {f"Average of {label}": names for label, names in unseen.parts(apart.names).items()}
        shown = {name: [name] for name in apart.names} | parts
        lines += [(label, (*empty, apart.frames(own), *apart.averages(own))) for label, own in shown.items()]
        pooled = (apart.frames(apart.names), *apart.pooled(apart.names))
        lines.append(("All frames of unseen objects", (*empty, *pooled)))
        lower = {f"average of {label}": names for label, names in unseen.parts(apart.names).items()}
        more += [line for run in runs for line in apart.lines(run, " of unseen objects", lower)]
        notes = (*notes, *unseen.notes, *unseen.track_notes)
    drawn = "95 % of draws: where the figure over all frames lies when these are drawn with replacement."
    return [
        Table("table2", "Table II: tracking, AUC of ADD", heads, tuple(lines), (*paper.notes, *notes), 2),
        Table(
            "table2_figures",
            "Tracking, in all figures",
            (Head("", "n", "sequences, or frames"), *_ALL.values()),
            tuple(more),
            (drawn, *notes),
            2,
        ),
    ]


def _run(run: Run) -> str:
    method, every = run
    return method if every == 1 else f"{method}, every {every}th"
