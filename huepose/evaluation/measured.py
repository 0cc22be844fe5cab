"""Reads result files of `huepose eval`, with everything that a comparison of two of them needs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets import files
from huepose.evaluation.bootstrap import Share
from huepose.evaluation.states import Moment, coverable, false_tracking
from huepose.evaluation.summary import Row, grouped, pose_scores
from huepose.geometry.arrays import Float64
from huepose.support.errors import InputError

BLOCK_NS = 500_000_000
"""Frames of a sequence within half a second are one unit: three times the time within which a tracker must
report LOST (5 frames at 30 Hz). A lost track often stays lost for longer, so these intervals tend to be too
narrow."""

ENOUGH_SEQUENCES = 10
"""With this number of sequences or more, whole sequences are the units instead."""


@dataclass(frozen=True, eq=False)
class Units:
    """Units of the bootstrap over tracks. one, many: their name in singular and plural; of: the unit of
    each row (N,)."""

    one: str
    many: str
    of: Sequence[Hashable]


def unit_of(rows: Sequence[Row]) -> Units:
    """The units of rows of tracks, with all their seeds: sequences if there are enough, else half seconds
    from the first row of a sequence."""
    first_ns: dict[str, int] = {}
    for row in rows:
        first_ns[row["sequence"]] = min(row["stamp_ns"], first_ns.get(row["sequence"], row["stamp_ns"]))
    if len(first_ns) >= ENOUGH_SEQUENCES:
        return Units("a sequence with all its seeds", "sequences", [row["sequence"] for row in rows])
    blocks = [(r["sequence"], (r["stamp_ns"] - first_ns[r["sequence"]]) // BLOCK_NS) for r in rows]
    return Units("half a second of a sequence, with all its seeds", "half seconds", blocks)


_EXPECTED = "a result of `huepose eval estimate`, `track`, `poses` or `perception`"


@dataclass(frozen=True)
class Figure:
    """A figure of a result. better: 1 if more is better, -1 if less is, 0 if neither; steps: rows are right
    or wrong, so wins and losses can be counted; judged: it decides whether a result is worse, and is in
    percent or per 100 frames; digits: after the decimal point."""

    key: str
    label: str
    better: int = 1
    steps: bool = False
    judged: bool = True
    digits: int = 1


_POSES = (
    Figure("recall_add", "recall ADD", steps=True),
    Figure("recall_adds", "recall ADD-S", steps=True),
    Figure("auc_add", "AUC ADD"),
    Figure("auc_adds", "AUC ADD-S"),
)
_QUALITY = (
    Figure("quality", "mean quality", better=0, judged=False, digits=3),
    Figure("brier", "squared error of quality", better=-1, judged=False, digits=3),
)
FALSE_PER_FRAME = Figure("false_per_100_frames", "false poses, per 100 frames", better=-1, steps=True)


@dataclass(frozen=True)
class Kind:
    """What a command of `huepose eval` writes. unit: the unit of the bootstrap in words, empty if it
    depends on the rows; settings: keys of the summary with the settings of the run."""

    verb: str
    unit: str
    figures: tuple[Figure, ...]
    settings: tuple[str, ...]


ESTIMATE = Kind(
    "estimate",
    "an instance with all its boxes",
    _POSES + _QUALITY,
    ("method", "profile", "boxes", "masks", "seed"),
)
TRACK = Kind(
    "track",
    "",
    (
        *_POSES,
        Figure("coverage_tracking", "coverage"),
        Figure("false_tracking_rate", "false TRACKING", better=-1, steps=True),
        Figure("phantoms", "TRACKING of no instance", better=-1),
        *_QUALITY,
    ),
    ("method", "profile", "protocol", "every", "init", "delayed", "seed"),
)
PERCEPTION = Kind(
    "perception",
    "an instance",
    (
        Figure("recall_iou50", "found", steps=True),
        Figure("proposed", "proposed", steps=True),
        Figure("mask_iou", "IoU of first mask"),
        Figure("final_mask_iou", "IoU of final mask"),
    ),
    ("profile", "asked_for"),
)


@dataclass(frozen=True, eq=False)
class Measured:
    """A result file. keys: unique keys of the N rows; names: names of the parts of a key; unit: the unit of
    the bootstrap in words; units: the unit of each row; groups: the scene or sequence of each row; shares:
    by the keys of the kind's figures; frames: those with rows; false: number of false poses or boxes by
    frame, mean over seeds; searched: number of all frames, also of those without rows, None if the file does
    not have it."""

    path: Path
    kind: Kind
    settings: Mapping[str, Any]
    names: tuple[str, ...]
    rows: Sequence[Row]
    keys: Sequence[tuple[Hashable, ...]]
    unit: str
    units: Sequence[Hashable]
    groups: Sequence[str]
    shares: Mapping[str, Share]
    frames: frozenset[tuple[str, int]]
    false: Mapping[tuple[str, int], float]
    searched: int | None = None


def read_measured(path: Path) -> Measured:
    """A result of `huepose eval estimate`, `track`, `poses` or `perception`.

    Raises InputError for another file, for no rows, and for two rows with the same key."""
    record = files.read_json(path, "Make it with `huepose eval ... --json`.")
    rows = record.get("rows")
    if not isinstance(rows, list) or not rows or not isinstance(rows[0], dict):
        raise InputError(path, found="no rows", expected=_EXPECTED)
    keys = rows[0].keys()
    reader = next((read for mark, read in _READERS.items() if set(mark) <= keys), None)
    if reader is None:
        raise InputError(path, found=f"rows with {', '.join(sorted(keys))}", expected=_EXPECTED)
    try:
        measured = reader(path, rows, record)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            path,
            found=f"an incomplete row ({type(error).__name__}: {error})",
            fix="Measure it again with `huepose eval`.",
        ) from None
    twice = [key for key, n in Counter(measured.keys).items() if n > 1]
    if twice:
        named = ", ".join(f"{name} {part}" for name, part in zip(measured.names, twice[0], strict=True))
        raise InputError(
            path,
            found=f"two rows of {named}",
            fix="Write the results of folders with the same name to different files.",
        )
    return measured


def _read(
    path: Path,
    kind: Kind,
    record: Row,
    names: tuple[str, ...],
    shares: Mapping[str, Share],
    units: Units | None = None,
    false: Mapping[tuple[str, int], float] | None = None,
) -> Measured:
    """names: the parts of a key; the first two are the scene or sequence and the frame, the last may be the
    seed; units: by default, rows that differ only in the seed are one unit."""
    rows = record["rows"]
    keys = [tuple(row[name] for name in names) for row in rows]
    one = [name for name in names if name != "seed"]
    summary = record.get("summary", {})
    return Measured(
        path,
        kind,
        {key: value for key, value in summary.items() if key in kind.settings},
        names,
        rows,
        keys,
        kind.unit if units is None else units.one,
        [key[: len(one)] for key in keys] if units is None else units.of,
        [str(key[0]) for key in keys],
        shares,
        frozenset((key[0], key[1]) for key in keys),
        false or {},
        summary.get("frames"),
    )


def _estimate(path: Path, rows: Sequence[Row], record: Row) -> Measured:
    names = ("scene", "image", "instance", "object", "seed")
    right = np.array([bool(row["right"]) for row in rows])
    every = np.ones(len(rows), bool)
    shares = {**_pose_shares(rows, every), **_quality_shares(rows, right, every)}
    return _read(path, ESTIMATE, record, names, shares, false=_false(record, _seeds(rows)))


def _track(path: Path, rows: Sequence[Row], record: Row) -> Measured:
    labelled = np.array([row["right"] is not None for row in rows])
    moments = [_moment(row) for row in rows]
    gone = np.array([moment.gone for moment in moments])
    tracking = np.array([moment.state == "TRACKING" for moment in moments])
    false, counts = np.zeros(len(rows)), np.zeros(len(rows), bool)
    one_track = ("sequence", "object", "ordinal", "seed")
    tracks = grouped(range(len(rows)), lambda i: tuple(rows[i][name] for name in one_track))
    for track in tracks.values():
        in_order = sorted(track, key=lambda i: moments[i].stamp_ns)
        own = [moments[i] for i in in_order]
        false[in_order] = false_tracking(own)
        counts[in_order] = coverable(own)
        if not counts[in_order].any():
            # As in a summary: an object that is visible but never confirmed has coverage 0.
            counts[in_order] = [moment.visible for moment in own]
            tracking[in_order] = False
    shares = {
        **_pose_shares(rows, labelled & ~gone),
        "coverage_tracking": Share.of(100.0 * tracking, counts),
        "false_tracking_rate": Share.of(100.0 * false),
        "phantoms": Share.of(_phantoms(record)),
        **_quality_shares(rows, np.array([m.right for m in moments]), labelled),
    }
    names = ("sequence", "frame", "object", "ordinal", "seed")
    return _read(path, TRACK, record, names, shares, unit_of(rows))


def _perception(path: Path, rows: Sequence[Row], record: Row) -> Measured:
    shares = {
        "recall_iou50": Share.of(np.array([100.0 * bool(row["found"]) for row in rows])),
        "proposed": Share.of(np.array([100.0 * (row["rank"] is not None) for row in rows])),
    }
    for name in ("mask_iou", "final_mask_iou"):
        known = np.array([row[name] is not None for row in rows])
        shares[name] = Share.of(np.array([100.0 * (row[name] or 0.0) for row in rows]), known)
    names = ("scene", "image", "instance", "object")
    return _read(path, PERCEPTION, record, names, shares, false=_false(record, 1))


_READERS: Mapping[tuple[str, ...], Callable[[Path, Sequence[Row], Row], Measured]] = {
    ("sequence", "add_m"): _track,
    ("scene", "add_m"): _estimate,
    ("scene", "rank"): _perception,
}


def _pose_shares(rows: Sequence[Row], scored: np.ndarray) -> dict[str, Share]:
    return {name: Share.of(each, scored) for name, each in pose_scores(rows).items()}


def _quality_shares(rows: Sequence[Row], right: np.ndarray, known: np.ndarray) -> dict[str, Share]:
    """Mean quality, and the Brier score: the squared error, which is least if quality is the true
    probability."""
    quality: Float64 = np.array([float(row["quality"]) for row in rows])
    return {"quality": Share.of(quality), "brier": Share.of((quality - right) ** 2, known)}


def _seeds(rows: Sequence[Row]) -> int:
    return len({row["seed"] for row in rows})


def _phantoms(record: Row) -> Float64:
    """TRACKING poses of no instance, per 100 rows, of each row (N,): a file has only their number in each
    sequence, so its rows get equal parts."""
    of = [(row["sequence"], row["seed"]) for row in record["rows"]]
    rows, poses = Counter(of), Counter[tuple[str, int]]()
    for entry in record.get("phantoms", []):
        poses[entry["sequence"], entry["seed"]] += entry["frames"]
    return np.array([100.0 * poses[one] / rows[one] for one in of])


def _false(record: Row, seeds: int) -> dict[tuple[str, int], float]:
    counts = Counter((pose["scene"], int(pose["image"])) for pose in record.get("false", []))
    return {frame: count / seeds for frame, count in counts.items()}


def _moment(row: Row) -> Moment:
    return Moment(row["stamp_ns"], row["visible"], row["gone"], row["state"], row["right"] in (None, True))
