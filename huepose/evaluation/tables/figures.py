"""Figures of measured rows, and the columns for them."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass

from huepose.evaluation.bop_errors import average_recalls
from huepose.evaluation.summary import Row, grouped, pose_figures, pose_intervals, span
from huepose.evaluation.tables.journal import Entry
from huepose.evaluation.tables.table import Cell, Head

OFFICIAL = "add_official_m"
"""Key of ADD against the original labels, where rows have it."""

RECALL = "recall: error under a tenth of the diameter, against the labels as they are, percent"
_AUC = "area under the accuracy curve from 0 to 0.1 m: mean of max(0, 1 - error / 0.1 m), percent"
VOC = "the same area as the toolboxes of YCB-Video and ROFT sum it (VOCap), percent"
_BOP = "average recall of the BOP challenge, percent"
COLUMNS = {
    "recall_add": Head("recall", "ADD", RECALL),
    "recall_adds": Head("recall", "ADD-S", RECALL),
    "auc_add": Head("AUC", "ADD", _AUC),
    "auc_adds": Head("AUC", "ADD-S", _AUC),
    "auc_voc_add": Head("AUC, VOCap", "ADD", VOC),
    "auc_voc_adds": Head("AUC, VOCap", "ADD-S", VOC),
}
BOP_COLUMNS = {
    "ar": Head("BOP", "AR", _BOP),
    "ar_vsd": Head("BOP", "VSD", _BOP),
    "ar_mssd": Head("BOP", "MSSD", _BOP),
    "ar_mspd": Head("BOP", "MSPD", _BOP),
}


@dataclass(frozen=True, eq=False)
class Unseen:
    """Results of the unseen objects, to which nothing was fitted. images: entries by method; tracks: by
    (method, N), for every N-th frame; names: by the objects' ids in rows; plain: names of objects with
    little texture; notes: on the objects; image_notes, track_notes: on what was measured."""

    images: Mapping[str, Sequence[Entry]]
    tracks: Mapping[tuple[str, int], Sequence[Entry]]
    names: Mapping[str, str]
    plain: Collection[str]
    notes: Sequence[str] = ()
    image_notes: Sequence[str] = ()
    track_notes: Sequence[str] = ()

    def parts(self, found: Collection[str]) -> dict[str, list[str]]:
        """The groups over which averages are taken, limited to the names in `found`."""
        return {
            "unseen objects": list(found),
            "unseen, textured": [name for name in found if name not in self.plain],
            "unseen, little texture": [name for name in found if name in self.plain],
        }


def rows_of(entries: Sequence[Entry]) -> list[Row]:
    """All rows of the entries that could be read."""
    return [row for entry in entries for row in entry.get("rows", [])]


def quarter_visible(rows: Sequence[Row]) -> list[Row]:
    """Rows of labels of which a quarter or more is visible, or of unknown visibility."""
    return [row for row in rows if row["visib_fract"] is None or row["visib_fract"] >= 0.25]


def scored(rows: Sequence[Row]) -> list[Row]:
    """Rows of tracks that count: labelled and not gone."""
    return [row for row in rows if row["right"] is not None and not row["gone"]]


def figures(rows: Sequence[Row], add_key: str = OFFICIAL) -> dict[str, float | None]:
    """Recall and AUC (in both forms) of N rows, by default against the original labels; AR if it was
    measured."""
    if not rows:
        return dict.fromkeys((*COLUMNS, *BOP_COLUMNS))
    bop = [row["bop"] for row in rows if "bop" in row]
    return {
        **pose_figures(rows, _known(rows, add_key)),
        **average_recalls(bop if len(bop) == len(rows) else []),
    }


def spans(rows: Sequence[Row], columns: Mapping[str, Head], units: Sequence[Hashable]) -> list[Cell]:
    """`low to high` for figures that are means over rows, empty for the others."""
    if not rows:
        return [None] * len(columns)
    found = pose_intervals(rows, units, _known(rows, OFFICIAL))
    return [span(found[k], 0) if k in found else "" for k in columns]


def _known(rows: Sequence[Row], add_key: str) -> str:
    """`add_key`, or `add_m` for rows of tracks, which have only this ADD."""
    return add_key if add_key in rows[0] else "add_m"


def by_name_of(
    rows: Mapping[str, Sequence[Row]], names: Mapping[str, str]
) -> dict[str, dict[str, list[Row]]]:
    """Rows by method, then by the object's name."""
    return {
        method: grouped(own, lambda row: names.get(str(row["object"]), str(row["object"])))
        for method, own in rows.items()
    }
