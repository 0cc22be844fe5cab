"""Compares two result files of the same instances, row by row: wins, losses, and their significance.

Rows are paired because some instances are harder than others, before and after. The intervals and the sign
test count units instead of rows: several boxes of one instance are mostly all right or all wrong, and so are
neighbouring frames of a track. Instances of one frame are separate units: their changes are not correlated
(-0.03 to 0.05 in clutter and piles, from `colorpair` to `full`).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from huepose.evaluation.bootstrap import Interval, Share, difference_intervals, sign_test
from huepose.evaluation.measured import FALSE_PER_FRAME, Figure, Kind, Measured
from huepose.evaluation.summary import Row, grouped
from huepose.geometry.arrays import Float64, Int64
from huepose.support.errors import InputError

MARGIN = 0.1
"""Percentage points, or poses per 100 frames: a change within the margin counts as no change. A tenth of a
point of AUC is a tenth of a millimetre of mean error, which is less than the noise of depth."""

SAME_MM, SAME_DEG = 0.1, 0.1
"""Poses within these distances count as the same: a hundredth of the error at which the pose of an object of
10 cm counts as wrong."""


@dataclass(frozen=True)
class Change:
    """A figure before and after, over the rows that both files have. Percent; `quality` and `brier` 0..1.

    interval95: of the change, None if there are too few units. wins, losses: numbers of rows that became
    better and worse (for `false_per_100_frames`: of frames), None for a figure without steps. sign_test_p:
    over units, each of which counts once, as won or as lost. verdict: `worse` or `better` if the interval
    is outside the margin, `same` if it is inside, else `open`; `-` if the figure is not judged."""

    figure: Figure
    before: float | None
    after: float | None
    change: float | None
    interval95: Interval | None
    wins: int | None
    losses: int | None
    sign_test_p: float | None
    verdict: str


@dataclass(frozen=True)
class Moved:
    """Differences between the poses before and after. both: rows with a pose before and after; same: of
    these, those within 0.1 mm and 0.1 degrees; median and largest distance and rotation; found, states: of
    all paired rows, those that differ in whether there is a pose, and in the state."""

    both: int
    same: int
    median_mm: float | None
    largest_mm: float | None
    median_deg: float | None
    largest_deg: float | None
    found: int
    states: int


@dataclass(frozen=True, eq=False)
class Comparison:
    """The comparison of two files. unit: the unit of the bootstrap, in words; units: their number; paired:
    rows that both files have; only_before, only_after: keys of the rows that only one file has; settings:
    those that differ, before and after; groups: changes by scene or sequence; moved: None if rows have no
    poses; won, lost: keys of the rows that became right and wrong by the kind's first figure."""

    name: str
    before: Measured
    after: Measured
    unit: str
    units: int
    paired: int
    only_before: Sequence[tuple[Hashable, ...]]
    only_after: Sequence[tuple[Hashable, ...]]
    settings: Mapping[str, tuple[Any, Any]]
    changes: Sequence[Change]
    groups: Mapping[str, Sequence[Change]]
    moved: Moved | None
    won: Sequence[tuple[Hashable, ...]]
    lost: Sequence[tuple[Hashable, ...]]

    @property
    def kind(self) -> Kind:
        """The kind of the files."""
        return self.before.kind

    @property
    def worse(self) -> list[Change]:
        """Figures with the verdict `worse`."""
        return [change for change in self.changes if change.verdict == "worse"]

    @property
    def doubtful(self) -> list[Change]:
        """Figures that became worse, with the verdict `open`."""
        return [c for c in self.changes if c.verdict == "open" and c.figure.better * (c.change or 0.0) < 0.0]

    def as_json(self) -> dict[str, Any]:
        """The comparison in its file form."""
        return {
            "set": self.name,
            "kind": self.kind.verb,
            "before": str(self.before.path),
            "after": str(self.after.path),
            "settings": self.settings,
            "unit": self.unit,
            "units": self.units,
            "paired": self.paired,
            "only_before": [self._named(key) for key in self.only_before],
            "only_after": [self._named(key) for key in self.only_after],
            "figures": _figures_json(self.changes),
            "groups": {name: _figures_json(changes) for name, changes in self.groups.items()},
            "moved": None if self.moved is None else vars(self.moved),
            "won": [self._named(key) for key in self.won],
            "lost": [self._named(key) for key in self.lost],
            "worse": [change.figure.key for change in self.worse],
        }

    def _named(self, key: tuple[Hashable, ...]) -> dict[str, Hashable]:
        return dict(zip(self.before.names, key, strict=True))


def _figures_json(changes: Sequence[Change]) -> dict[str, Any]:
    return {
        change.figure.key: {key: value for key, value in vars(change).items() if key != "figure"}
        for change in changes
    }


def compare(before: Measured, after: Measured, name: str, margin: float = MARGIN) -> Comparison:
    """Compare two files, with rows paired by their keys. Raises InputError for files of two kinds, or
    without a row in common."""
    if before.kind is not after.kind:
        raise InputError(
            f"{before.path} and {after.path}",
            found=f"results of `huepose eval {before.kind.verb}` and of `huepose eval {after.kind.verb}`",
            expected="two of the same kind",
        )
    place_before = {key: i for i, key in enumerate(before.keys)}
    place_after = {key: i for i, key in enumerate(after.keys)}
    common = [key for key in before.keys if key in place_after]
    if not common:
        raise InputError(
            f"{before.path} and {after.path}",
            found="no row in common",
            expected=f"the same {', '.join(before.names)} in some rows",
            fix="Measure both on the same scenes, objects and seeds.",
        )
    old = np.array([place_before[key] for key in common])
    new = np.array([place_after[key] for key in common])
    units = [before.units[i] for i in old]
    groups = [before.groups[i] for i in old]
    steps = before.kind.figures[0].key
    improved = _improved(before.shares[steps].only(old), after.shares[steps].only(new), 1)
    changes = _changes(before, after, old, new, units, margin)
    if before.false or after.false:
        changes.append(_false_change(before, after, margin))
    return Comparison(
        name=name,
        before=before,
        after=after,
        unit=before.unit,
        units=len(set(units)),
        paired=len(common),
        only_before=[key for key in before.keys if key not in place_after],
        only_after=[key for key in after.keys if key not in place_before],
        settings={
            key: (before.settings.get(key), after.settings.get(key))
            for key in before.kind.settings
            if before.settings.get(key) != after.settings.get(key)
        },
        changes=changes,
        groups={
            group: _changes(before, after, old[chosen], new[chosen], [units[i] for i in chosen], margin)
            for group, chosen in grouped(range(len(common)), lambda i: groups[i]).items()
        },
        moved=_moved([before.rows[i] for i in old], [after.rows[i] for i in new]),
        won=[common[i] for i in np.flatnonzero(improved > 0)],
        lost=[common[i] for i in np.flatnonzero(improved < 0)],
    )


def _changes(
    before: Measured, after: Measured, old: Int64, new: Int64, units: Sequence[Hashable], margin: float
) -> list[Change]:
    pairs = {
        figure.key: (before.shares[figure.key].only(old), after.shares[figure.key].only(new))
        for figure in before.kind.figures
        if figure.key in before.shares
    }
    intervals = difference_intervals(pairs, units)
    return [
        _change(figure, *pairs[figure.key], intervals[figure.key], units, margin)
        for figure in before.kind.figures
        if figure.key in pairs
    ]


def _false_change(before: Measured, after: Measured, margin: float) -> Change:
    """Change of the number of false positives, by frame. Frames with rows in only one of the files are left
    out. Of the same frames those without rows and false positives count, too: a file has their number."""
    one_sided = before.frames ^ after.frames
    frames = sorted((before.frames | after.frames | {*before.false, *after.false}) - one_sided)
    same = before.searched == after.searched and not one_sided
    empty = range((before.searched or 0) - len(frames) if same else 0)
    old, new = (
        Share.of(np.array([*(100.0 * m.false.get(f, 0.0) for f in frames), *(0.0 for _ in empty)]))
        for m in (before, after)
    )
    units: list[Hashable] = [*frames, *empty]
    interval = difference_intervals({"false": (old, new)}, units)["false"]
    return _change(FALSE_PER_FRAME, old, new, interval, units, margin)


def _change(
    figure: Figure,
    before: Share,
    after: Share,
    interval: Interval | None,
    units: Sequence[Hashable],
    margin: float,
) -> Change:
    old, new = before.value, after.value
    change = None if old is None or new is None else new - old
    wins = losses = p = None
    if figure.steps:
        improved = _improved(before, after, figure.better)
        wins, losses = int((improved > 0).sum()), int((improved < 0).sum())
        net = [
            np.sign(improved[own].sum()) for own in grouped(range(len(units)), lambda i: units[i]).values()
        ]
        p = sign_test(net.count(1), net.count(-1))
    result = Change(figure, old, new, change, interval, wins, losses, p, "-")
    return replace(result, verdict=_verdict(result, margin)) if figure.judged else result


def _improved(before: Share, after: Share, better: int) -> Float64:
    """1 for each row (N,) that became better, -1 for worse, else 0; only rows that count before and after."""
    both = (before.whole > 0) & (after.whole > 0)
    return np.asarray(np.where(both, better * np.sign(after.part - before.part), 0.0))


def _verdict(change: Change, margin: float) -> str:
    if change.change is None:
        return "-"
    if change.interval95 is None:
        return "same" if change.change == 0.0 and not change.wins and not change.losses else "open"
    low, high = sorted(change.figure.better * end for end in change.interval95)
    if high < -margin:
        return "worse"
    if low > margin:
        return "better"
    return "same" if -margin <= low and high <= margin else "open"


def _moved(before: Sequence[Row], after: Sequence[Row]) -> Moved | None:
    if "T_cam_obj" not in before[0]:
        return None
    poses = [(a["T_cam_obj"], b["T_cam_obj"]) for a, b in zip(before, after, strict=True)]
    both = [(a, b) for a, b in poses if a is not None and b is not None]
    old = np.array([a for a, _ in both], np.float64).reshape(-1, 4, 4)
    new = np.array([b for _, b in both], np.float64).reshape(-1, 4, 4)
    mm = 1000.0 * np.linalg.norm(new[:, :3, 3] - old[:, :3, 3], axis=1)
    # The angle comes from the chord, which is exact for small rotations, where the trace is not.
    chord = np.linalg.norm(new[:, :3, :3] - old[:, :3, :3], axis=(1, 2))
    deg = np.degrees(2.0 * np.arcsin(np.minimum(1.0, chord / np.sqrt(8.0))))
    return Moved(
        both=len(both),
        same=int(((mm <= SAME_MM) & (deg <= SAME_DEG)).sum()),
        median_mm=float(np.median(mm)) if both else None,
        largest_mm=float(mm.max()) if both else None,
        median_deg=float(np.median(deg)) if both else None,
        largest_deg=float(deg.max()) if both else None,
        found=sum((a is None) != (b is None) for a, b in poses),
        states=sum(a["state"] != b["state"] for a, b in zip(before, after, strict=True)),
    )
