"""A table as data, and its output as text, Markdown, CSV and HTML."""

from __future__ import annotations

import csv
import html
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from huepose.evaluation.summary import table

Cell = float | int | str | None


@dataclass(frozen=True)
class Head:
    """The head of a column. method: that the figures are of; figure: its name; metric: its definition;
    measured: by this code, not published."""

    method: str
    figure: str
    metric: str = ""
    measured: bool = True


@dataclass(frozen=True)
class Table:
    """rows: name and cells, one for each head; notes: needed to understand the figures."""

    key: str
    title: str
    heads: tuple[Head, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    notes: tuple[str, ...] = ()
    digits: int = 1

    def as_json(self) -> dict[str, Any]:
        """The table in its file form."""
        return asdict(self)

    @staticmethod
    def of_json(record: dict[str, Any]) -> Table:
        """The table from its file form."""
        heads = tuple(Head(**head) for head in record["heads"])
        rows = tuple((name, tuple(cells)) for name, cells in record["rows"])
        return Table(record["key"], record["title"], heads, rows, tuple(record["notes"]), record["digits"])

    def cell(self, value: Cell) -> str:
        """A cell as it is shown."""
        if value is None:
            return "-"
        return f"{value:.{self.digits}f}" if isinstance(value, float) else str(value)

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Methods of neighbouring columns, with their number of columns."""
        out: list[tuple[str, int]] = []
        for head in self.heads:
            if out and out[-1][0] == head.method:
                out[-1] = (head.method, out[-1][1] + 1)
            else:
                out.append((head.method, 1))
        return out

    def text(self) -> str:
        """For a terminal; methods are above their columns."""
        cells = [[name, *map(self.cell, values)] for name, values in self.rows]
        heads = ["", *(head.figure for head in self.heads)]
        widths = [max(len(row[i]) for row in [heads, *cells]) for i in range(len(heads))]
        over, column = [" " * widths[0]], 1
        for method, count in self.groups:
            wide = sum(widths[column : column + count]) + 2 * (count - 1)
            heads[column] = heads[column].rjust(widths[column] + max(0, len(method) - wide))
            over.append(method.rjust(wide))
            column += count
        lines = ["  ".join(over).rstrip(), table(heads, cells)]
        return "\n".join([self.title, "", *lines, "", *(f"- {note}" for note in self.notes)])

    def markdown(self) -> str:
        """For a document."""
        notes = [f"- {note}" for note in self.notes]
        return "\n".join([f"### {self.title}", "", *self.piped(), "", *notes, ""])

    def piped(self, corner: str = "") -> list[str]:
        """Its lines in Markdown; method and figure are in one head."""
        heads = [corner, *(f"{head.method} {head.figure}".strip() for head in self.heads)]
        lines = [heads, ["---"] * len(heads)]
        lines += [[name, *map(self.cell, values)] for name, values in self.rows]
        return [f"| {' | '.join(cells)} |" for cells in lines]

    def csv(self) -> str:
        """Values with all digits; three lines of heads: method, figure, and definition of the figure."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        for part in ("method", "figure", "metric"):
            writer.writerow([part, *(getattr(head, part) for head in self.heads)])
        for name, values in self.rows:
            writer.writerow([name, *("" if v is None else v for v in values)])
        return out.getvalue()

    def html(self) -> str:
        """A table element with its title and notes; heads have the definition of their figure as tooltip."""
        over = "".join(f'<th colspan="{n}">{html.escape(m)}</th>' for m, n in self.groups)
        under = "".join(
            f'<th class="{_kind(head)}" title="{html.escape(head.metric)}">{html.escape(head.figure)}</th>'
            for head in self.heads
        )
        body = "".join(
            f"<tr{_weight(name)}><th>{html.escape(name)}</th>"
            + "".join(
                f'<td class="{_kind(head)}">{html.escape(self.cell(v) if _shown(head, v) else "")}</td>'
                for head, v in zip(self.heads, values, strict=True)
            )
            + "</tr>"
            for name, values in self.rows
        )
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in self.notes)
        return (
            f'<h2 id="{self.key}">{html.escape(self.title)}</h2><div class="wide"><table><thead><tr><th></th>'
            f"{over}</tr><tr><th></th>{under}</tr></thead><tbody>{body}</tbody></table></div><ul>{notes}</ul>"
        )


def _shown(head: Head, value: Cell) -> bool:
    """Whether a cell is shown: not if it is published and empty."""
    return head.measured or value is not None


def _weight(name: str) -> str:
    return ' class="whole"' if name.startswith(("Average", "All ")) else ""


def _kind(head: Head) -> str:
    return "measured" if head.measured else "published"


_UNSEEN = {
    "Average of unseen, textured": "unseen objects, textured",
    "Average of unseen, little texture": "unseen objects, little texture",
}
_ROWS: Mapping[str, Mapping[str, str]] = {
    "table1": {"All labels": "YCB-Video", **_UNSEEN},
    "table2": {"Average": "Fast-YCB, or like it", **_UNSEEN},
}
"""By the paper's tables: the rows of the short form, and their names in it."""


def in_short(tables: Sequence[Table]) -> list[Table]:
    """The short form of each of the paper's tables: the columns of this code and the rows of averages."""
    return [_short(table, _ROWS[table.key]) for table in tables if table.key in _ROWS]


def _short(table: Table, names: Mapping[str, str]) -> Table:
    ours = [k for k, head in enumerate(table.heads) if head.measured]
    rows = [(names[name], tuple(cells[k] for k in ours)) for name, cells in table.rows if name in names]
    heads = tuple(table.heads[k] for k in ours)
    return Table(f"{table.key}_short", table.title, heads, tuple(rows), digits=table.digits)
