"""Makes `docs/results.md`: all results on one page, from their files alone, each with its origin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from huepose.evaluation.summary import span
from huepose.evaluation.tables.table import Cell, Head, Table, in_short
from huepose.support.errors import InputError

_FIGURES = {
    "instances": Head("", "n"),
    "recall_add": Head("recall", "ADD"),
    "recall_adds": Head("recall", "ADD-S"),
    "auc_add": Head("AUC", "ADD"),
    "auc_adds": Head("AUC", "ADD-S"),
    "ar": Head("BOP", "AR"),
    "recall_iou50": Head("boxes", "recall"),
    "false_boxes_per_frame": Head("boxes", "false a frame"),
    "coverage_tracking": Head("state", "TRACKING"),
    "false_tracking_rate": Head("state", "false"),
}
_SETTINGS = ("method", "profile", "boxes", "masks", "protocol", "every", "init", "delayed", "seed")
_INTRODUCTION = """# Results

Made by `huepose eval results` from result files. Do not edit this page by hand: the next run overwrites it.

- ADD: mean distance between the model's points at the answered and at the true pose.
- ADD-S: the same, with each point compared with the nearest one. It forgives a turn that keeps the shape.
- Recall: share of instances with an error under a tenth of the object's diameter, in percent.
- AUC: area under the accuracy curve from 0 to 0.1 m, in percent. VOCap, and all of Table II: as the
  toolboxes of YCB-Video and ROFT sum it, which gives more if there are few poses.
- 95 % of draws: the 95 % interval of a bootstrap. n: number of instances.

[Tables](tables.md) says what is measured and why families of objects differ.
"""


def results_page(records: Mapping[str, Mapping[str, Any]]) -> str:
    """The page as Markdown, from result files of `huepose eval` by name. Raises InputError for other
    files."""
    return "\n".join([_INTRODUCTION, *(_section(name, record) for name, record in records.items())])


BEGIN, END = "<!-- cut from docs/results by `huepose eval results` -->", "<!-- end of the cut -->"


def with_cut(document: str, records: Mapping[str, Mapping[str, Any]]) -> str:
    """A document in which the lines between BEGIN and END are replaced by the averages of this code, from the
    first result with the paper's tables. Raises InputError if there are no such lines or tables."""
    before, begin, rest = document.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise InputError("--readme", found="no such lines", expected=f"{BEGIN} and {END}")
    whole = next((record for record in records.values() if "tables" in record), None)
    if whole is None:
        raise InputError("--readme", found="no result of `huepose eval tables`")
    parts: list[str] = []
    for table in in_short([Table.of_json(t) for t in whole["tables"]]):
        parts += [*table.piped(table.title), ""]
    return "\n".join([f"{before}{BEGIN}", *parts, f"{END}{after}"])


def _section(name: str, record: Mapping[str, Any]) -> str:
    facts = record.get("origin")
    if not isinstance(facts, Mapping):
        expected = "a result of `huepose eval tables`, `estimate`, `track`, `poses` or `perception`"
        raise InputError(name, found="no origin", expected=expected, fix="If it is one, measure again.")
    lines = [f"## {name}", "", f"`{facts['command']}`", ""]
    lines += [f"{facts['date']}; {facts['machine']}; {facts['versions']}.", ""]
    if "tables" in record:
        lines += [f"- {note}" for note in record["coverage"]]
        lines += ["", *(Table.of_json(table).markdown() for table in record["tables"])]
    else:
        lines += [_summary(name, record["summary"]).markdown()]
    return "\n".join(lines)


def _summary(name: str, summary: Mapping[str, Any]) -> Table:
    """The figures of one result with their intervals (of tracks: over all frames). Figures that it does not
    have are left out."""
    shown = {key: head for key, head in _FIGURES.items() if summary.get(key) is not None}
    spans = summary.get("interval95", {})
    rows: list[tuple[str, tuple[Cell, ...]]] = [("all", tuple(summary[key] for key in shown))]
    over = ""
    if (frames := summary.get("frame_weighted")) is not None:
        rows = [("mean over sequences", rows[0][1]), ("all frames", tuple(frames.get(key) for key in shown))]
        over = f" of {summary['interval95_over']}" if "interval95_over" in summary else ""
    if spans:
        cells = (span(spans[k]) if k in spans else "" for k in shown)
        rows.append((f"95 % of draws{over}", tuple(cells)))
    for part in ("per_object", "sequences"):
        blocks = summary.get(part, {}).items()
        rows += [(str(number), tuple(block.get(key) for key in shown)) for number, block in blocks]
    settings = ", ".join(f"{key} {summary[key]}" for key in _SETTINGS if summary.get(key) is not None)
    return Table(name, settings or name, tuple(shown.values()), tuple(rows))
