"""Rows, summary and plot of the ablation of flow correspondences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from huepose.drawing.plots import bar_chart, beside
from huepose.evaluation.bootstrap import Interval, Share, difference_intervals
from huepose.evaluation.summary import Figures, grouped
from huepose.geometry.arrays import UInt8

GAP = 5
"""Difference of the frame numbers of a pair, as in the paper."""

NO_ANSWER = 1.0
"""Relative error of a pair without an estimated motion: the same as if the object were static."""

BLOCK = 15
"""Frames of a sequence that are one unit of the bootstrap, half a second: the errors of neighbouring pairs
are correlated."""

FILTERED = {"flow": "flow filtered", "consistent": "consistent filtered"}
"""Choices of correspondences, and the same after the filter alone."""

PICTURED = ("flow", "flow filtered", "colorpair")

RELATIVE = {
    "rotation_error_rel": "rotation error / true rotation",
    "translation_error_rel": "translation error / true translation",
}


@dataclass(frozen=True)
class AblationRow:
    """One variant on one object in the pair of frames that begins with `frame`. object: BOP id or name. The
    relative errors are None if no motion was found; matches: correspondences with depth at both ends."""

    sequence: str
    frame: int
    object: int | str
    variant: str
    rotation_error_rel: float | None
    translation_error_rel: float | None
    epe_px: float | None
    matches: int


@dataclass(frozen=True, eq=False)
class AblationResult:
    """All rows. pairs: number of pairs of frames, counted for each object; left_out: how many of these were
    left out because the object hardly moved."""

    rows: list[AblationRow]
    pairs: int
    left_out: int

    def as_json(self) -> dict[str, Any]:
        """The result file."""
        return {"summary": self.summary(), "rows": [asdict(row) for row in self.rows]}

    def summary(self) -> dict[str, Any]:
        """Mean and median errors of each variant over all pairs, and the same per object."""
        by_object = grouped(self.rows, lambda row: row.object)
        return {
            "pairs": self.pairs,
            "pairs_left_out": self.left_out,
            "gap": GAP,
            "variants": _by_variant(self.rows),
            "per_object": {str(number): _by_variant(rows) for number, rows in by_object.items()},
            "filter_alone": _filter_alone(self.rows),
        }

    def picture(self, names: Mapping[str, str] | None = None) -> UInt8:
        """The paper's figure: mean errors per object and over all, of all flow, of filtered flow, and of the
        correspondences of the tracker. One panel for each estimator, two side by side. Below them is the
        end-point error, which does not depend on the estimator.

        names: labels of the bars of an object, by its number or name in the rows."""
        summary, known = self.summary(), names or {}
        groups = {known.get(k, k): block for k, block in summary["per_object"].items()}
        groups["all"] = summary["variants"]
        variants = [name.split("/") for name in summary["variants"]]
        every, estimators = (list(dict.fromkeys(part)) for part in zip(*variants, strict=True))
        choices = [choice for choice in every if choice in PICTURED]
        panels = []
        for key, title in RELATIVE.items():
            values = {
                name: [_or_nan(block[name][f"{key}_mean"]) for block in groups.values()]
                for name in summary["variants"]
            }
            # One scale for all, with room for the legend.
            span = (0.0, 1.35 * float(np.nanmax(list(values.values()), initial=1e-9)))
            row = [
                bar_chart(
                    list(groups),
                    {choice: values[f"{choice}/{estimator}"] for choice in choices},
                    f"mean {title}: {estimator}",
                    "",
                    span,
                    (_width(groups), 320),
                )
                for estimator in estimators
            ]
            # Two side by side: with more, the text on a page would be too small to read.
            blank = [np.full_like(row[0], 255)] * (len(row) % 2)
            panels += [beside([*row, *blank][k : k + 2]) for k in range(0, len(row), 2)]
        epe = {
            choice: [_or_nan(block[f"{choice}/{estimators[0]}"]["epe_px_mean"]) for block in groups.values()]
            for choice in choices
        }
        title, size = "mean end-point error in px", (panels[0].shape[1], 320)
        panels.append(bar_chart(list(groups), epe, title, "", None, size))
        return np.vstack(panels)


def _width(groups: Mapping[str, Any]) -> int:
    """Width of a panel in pixels, so that the numbers over its bars do not overlap."""
    return max(560, 170 * len(groups))


def _by_variant(rows: Sequence[AblationRow]) -> dict[str, Figures]:
    return {name: _figures(own) for name, own in grouped(rows, lambda row: row.variant).items()}


def _filter_alone(rows: Sequence[AblationRow]) -> dict[str, dict[str, tuple[float, Interval | None]]]:
    """By choice and estimator: the change of each mean by the filter, and its 95 % interval."""
    by_variant = grouped(rows, lambda row: row.variant)
    out: dict[str, dict[str, tuple[float, Interval | None]]] = {}
    for name, without in by_variant.items():
        choice, estimator = name.split("/")
        if choice not in FILTERED or f"{FILTERED[choice]}/{estimator}" not in by_variant:
            continue
        pairs = {}
        for key in RELATIVE:
            first, second = (
                Share.of(np.array([_relative(row, key) for row in part]))
                for part in (without, by_variant[f"{FILTERED[choice]}/{estimator}"])
            )
            pairs[key] = (first, second)
        units = [(row.sequence, row.object, row.frame // BLOCK) for row in without]
        intervals = difference_intervals(pairs, units)
        out[name] = {
            key: ((second.value or 0.0) - (first.value or 0.0), intervals[key])
            for key, (first, second) in pairs.items()
        }
    return out


def _relative(row: AblationRow, key: str) -> float:
    value = getattr(row, key)
    return NO_ANSWER if value is None else float(value)


def _figures(rows: Sequence[AblationRow]) -> Figures:
    out: Figures = {"pairs": float(len(rows))}
    out["no_motion"] = float(sum(row.rotation_error_rel is None for row in rows))
    out["matches_median"] = float(np.median([row.matches for row in rows]))
    for key in RELATIVE:
        known = [_relative(row, key) for row in rows]
        out[f"{key}_mean"], out[f"{key}_median"] = float(np.mean(known)), float(np.median(known))
    epe = [row.epe_px for row in rows if row.epe_px is not None]
    out["epe_px_mean"] = float(np.mean(epe)) if epe else None
    out["epe_px_median"] = float(np.median(epe)) if epe else None
    return out


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value
