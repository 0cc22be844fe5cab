"""The paper's tables in short: what this code gives on average."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from huepose.evaluation.tables.table import Table

_UNSEEN = {
    "Average of unseen, textured": "unseen objects, textured",
    "Average of unseen, little texture": "unseen objects, little texture",
}
_ROWS: Mapping[str, Mapping[str, str]] = {
    "table1": {"All labels": "YCB-Video", **_UNSEEN},
    "table2": {"Average": "Fast-YCB, or like it", **_UNSEEN},
}
"""Of the paper's tables: the rows that are kept, and how they are called in short."""


def in_short(tables: Sequence[Table]) -> list[Table]:
    """Of each of the paper's tables the columns of this code and the rows of averages."""
    return [_short(table, _ROWS[table.key]) for table in tables if table.key in _ROWS]


def _short(table: Table, names: Mapping[str, str]) -> Table:
    ours = [k for k, head in enumerate(table.heads) if head.measured]
    rows = [(names[name], tuple(cells[k] for k in ours)) for name, cells in table.rows if name in names]
    heads = tuple(table.heads[k] for k in ours)
    return Table(f"{table.key}_short", table.title, heads, tuple(rows), digits=table.digits)
