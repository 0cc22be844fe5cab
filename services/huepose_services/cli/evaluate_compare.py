"""`huepose eval compare`: two versions of the program on the same data, row by row."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Hashable, Sequence
from pathlib import Path

from huepose.evaluation.comparison import SAME_DEG, SAME_MM, Change, Comparison, compare
from huepose.evaluation.measured import read_measured
from huepose.evaluation.result_files import write_json
from huepose.evaluation.summary import table
from huepose.support.errors import InputError
from huepose.support.words import known

_WORSE = 1
# Most rows and scenes that are printed for a data set; the result file has all.
_LISTED, _UNPAIRED_LISTED = 8, 3


def call(arguments: argparse.Namespace) -> int:
    """Compare, print, write; exit code 1 if a data set became significantly worse."""
    pairs, left_out = _pairs(arguments.before, arguments.after)
    comparisons = [
        compare(read_measured(before), read_measured(after), name, arguments.margin)
        for name, before, after in pairs
    ]
    worse = [c.name for c in comparisons if c.worse]
    if arguments.json is not None:
        sets = [c.as_json() for c in comparisons]
        record = {"margin": arguments.margin, "worse": worse, "sets": sets, "not_compared": left_out}
        write_json(arguments.json, record)
    for comparison in comparisons:
        print(set_text(comparison, arguments.margin), end="\n\n")
    print(closing_text(comparisons, left_out, arguments.margin))
    return _WORSE if worse else 0


def _pairs(before: Path, after: Path) -> tuple[list[tuple[str, Path, Path]], list[str]]:
    """(name, file before, file after) of two files, or of the files with the same names in two folders; also
    the files that only one folder has. Raises InputError."""
    if before.is_dir() != after.is_dir():
        folder, other = (before, after) if before.is_dir() else (after, before)
        raise InputError(
            f"{before} and {after}",
            found=f"a folder, {folder}, and {other}, which is not a folder",
            expected="two result files, or two folders of them",
        )
    if not before.is_dir():
        name = before.stem if before.stem == after.stem else f"{before.stem} to {after.stem}"
        return [(name, before, after)], []
    old, new = ({path.name for path in folder.glob("*.json")} for folder in (before, after))
    common = sorted(old & new)
    if not common:
        raise InputError(
            f"{before} and {after}", found="no result file of the same name", expected="NAME.json in both"
        )
    left_out = [
        str(folder / name) for folder, one in ((before, old - new), (after, new - old)) for name in one
    ]
    return [(Path(name).stem, before / name, after / name) for name in common], sorted(left_out)


def set_text(comparison: Comparison, margin: float) -> str:
    """Text about one data set: how many rows were paired, a table of figures, and which rows changed."""
    lines = [
        f"{comparison.name}: {comparison.paired} pairs, {len(comparison.only_before)} rows only before, "
        f"{len(comparison.only_after)} only after; unit: {comparison.unit} ({comparison.units})"
    ]
    lines += _listed(comparison, "only before", comparison.only_before, _UNPAIRED_LISTED)
    lines += _listed(comparison, "only after", comparison.only_after, _UNPAIRED_LISTED)
    for key, (old, new) in comparison.settings.items():
        lines.append(f"  measured differently: {key} {old} before, {new} after")
    heading = ("figure", "before", "after", "change", "95 % interval", "wins", "losses", "p", "verdict")
    lines.append(table(heading, [_cells(change) for change in comparison.changes]))
    lines += _moved_lines(comparison)
    if len(comparison.groups) > 1:
        lines += _group_lines(comparison, margin)
    lines += _listed(comparison, "won", comparison.won, _LISTED)
    lines += _listed(comparison, "lost", comparison.lost, _LISTED)
    return "\n".join(lines)


def closing_text(comparisons: Sequence[Comparison], left_out: Sequence[str], margin: float) -> str:
    """How to read the output, and the overall result."""
    lines = [
        "wins, losses: rows that became right and wrong; p: sign test over units",
        f"worse, better: the interval lies beyond {margin:g} points; same: within; open: it reaches beyond, "
        "so these data cannot decide",
    ]
    judged = [change for c in comparisons for change in c.changes if change.verdict != "-"]
    moved = sum(change.verdict != "same" for change in judged)
    if moved:
        lines.append(
            f"{moved} of {len(judged)} figures are not the same; without any true change, one in 40 figures "
            "would be called worse by chance"
        )
    if left_out:
        lines.append("not compared, no file of this name on the other side: " + ", ".join(left_out))
    lines += _named("lost less than the interval allows", [(c.name, c.doubtful) for c in comparisons])
    worse = _named("worse", [(c.name, c.worse) for c in comparisons])
    return "\n".join([*lines, *(worse or [f"worse: none of {len(comparisons)}"])])


def _named(what: str, sets: Sequence[tuple[str, Sequence[Change]]]) -> list[str]:
    """A line with the given figures of each data set and their changes; no line if there are none."""
    told = [
        f"{name} ({', '.join(_changed(change) for change in changes)})" for name, changes in sets if changes
    ]
    return [f"{what}: " + "; ".join(told)] if told else []


def _changed(change: Change) -> str:
    return f"{change.figure.label} {known(change.change, f'+.{change.figure.digits}f')}"


def _cells(change: Change) -> list[object]:
    digits, interval = f".{change.figure.digits}f", change.interval95
    return [
        change.figure.label,
        known(change.before, digits),
        known(change.after, digits),
        known(change.change, f"+{digits}"),
        "-" if interval is None else f"{interval[0]:+{digits}} to {interval[1]:+{digits}}",
        change.wins,
        change.losses,
        known(change.sign_test_p, ".3f"),
        change.verdict,
    ]


def _moved_lines(comparison: Comparison) -> list[str]:
    moved = comparison.moved
    if moved is None or not moved.both:
        return []
    return [
        f"  poses: {moved.same} of {moved.both} the same within {SAME_MM:g} mm and {SAME_DEG:g} degrees; "
        f"moved by {moved.median_mm:.3g} mm and {moved.median_deg:.3g} degrees in the median, by "
        f"{moved.largest_mm:.3g} and {moved.largest_deg:.3g} at most",
        f"  rows that differ in whether there is a pose: {moved.found}, in the state: {moved.states}",
    ]


def _group_lines(comparison: Comparison, margin: float) -> list[str]:
    """Scenes or sequences in which rows were won or lost, or a figure changed by more than the margin."""
    lines = []
    for name, changes in comparison.groups.items():
        told = [
            _changed(c) + (f" ({c.wins} won, {c.losses} lost)" if c.figure.steps else "")
            for c in changes
            if c.figure.judged and (c.wins or c.losses or abs(c.change or 0.0) > margin)
        ]
        if told:
            lines.append(f"  in {name}: " + ", ".join(told))
    hidden = len(lines) - _LISTED
    return lines if hidden <= 0 else [*lines[:_LISTED], f"  and in {hidden} more"]


def _listed(comparison: Comparison, what: str, keys: Sequence[tuple[Hashable, ...]], most: int) -> list[str]:
    """A line that names the first of these rows, the seeds of a row together; no line if there are none."""
    if not keys:
        return []
    names = comparison.before.names
    seeded = names[-1] == "seed"
    places = Counter(key[:-1] if seeded else key for key in keys)
    shown = []
    for place, count in list(places.items())[:most]:
        text = " ".join(f"{name} {part}" for name, part in zip(names, place, strict=False))
        shown.append(text if count == 1 else f"{text} ({count} seeds)")
    if len(places) > most:
        shown.append(f"and {len(places) - most} more")
    return [f"  {what}: " + "; ".join(shown)]
