"""Published figures as data: `published.json` has each value with its metric and source."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from huepose.evaluation.tables.table import Cell, Head


@dataclass(frozen=True, eq=False)
class Published:
    """One of the paper's tables. rows: names, in its order; columns: head, values by row name, average."""

    rows: tuple[str, ...]
    columns: tuple[tuple[Head, Mapping[str, float], float], ...]
    notes: tuple[str, ...]

    @property
    def heads(self) -> tuple[Head, ...]:
        """The heads of the columns."""
        return tuple(head for head, _, _ in self.columns)

    def cells(self, name: str) -> tuple[Cell, ...]:
        """The row of an object; its cells are None if the paper does not have it."""
        return tuple(values.get(name) for _, values, _ in self.columns)

    @property
    def average(self) -> tuple[Cell, ...]:
        """The row of averages as printed in the paper."""
        return tuple(average for _, _, average in self.columns)


@cache
def _record() -> dict[str, Any]:
    path = Path(__file__).with_name("published.json")
    record: dict[str, Any] = json.loads(path.read_text())
    return record


def published(table: str) -> Published:
    """`table1` (single frames) or `table2` (tracking)."""
    record = _record()[table]
    rows = tuple(record["rows"])
    columns = tuple(
        (
            Head(c["method"], c["figure"], c["metric"], measured=False),
            dict(zip(rows, c["values"], strict=True)),
            c["average"],
        )
        for c in record["columns"]
    )
    return Published(rows, columns, (f"Published: {_record()['source']}.", *record["notes"]))


def others() -> Sequence[Mapping[str, Any]]:
    """Figures of other publications: method, rows, figures, source."""
    found: Sequence[Mapping[str, Any]] = _record()["others"]
    return found
