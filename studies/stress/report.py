"""How often the states of many runs were right, by mode and cause."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from huepose.evaluation.bootstrap import frame_intervals
from huepose.evaluation.states import Moment, false_tracking, find_losses
from huepose.evaluation.summary import span, table
from studies.stress.causes import WRONG_STARTS
from studies.stress.playing import Row


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Figures by mode and cause, in percent of frames and in seconds, with 95 % intervals over films."""
    out: dict[str, Any] = {}
    for mode in dict.fromkeys(row["mode"] for row in rows):
        own = [row for row in rows if row["mode"] == mode]
        causes = dict.fromkeys(row["cause"] for row in own)
        out[mode] = {cause: figures([row for row in own if row["cause"] == cause]) for cause in causes}
        moving = [row for row in own if row["cause"] not in WRONG_STARTS]
        out[mode]["all but wrong starts"] = figures(moving)
        out[mode]["all"] = figures(own)
    return out


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """Figures of some runs."""
    count: dict[str, list[float]] = defaultdict(list)
    frame_films, visible_films, suspect, back, never, twice, believed = [], [], [], [], 0, 0, 0
    for row in rows:
        moments = [Moment(*frame) for frame in row["frames"]]
        wrong = false_tracking(moments)
        twice += sum(a and b for a, b in pairwise(wrong))
        believed += any(wrong)
        count["false"] += [100.0 * w for w in wrong]
        frame_films += [row["film"]] * len(wrong)
        shown = [m for m in moments if m.visible]
        count["coverage"] += [100.0 * (m.state == "TRACKING" and m.right) for m in shown]
        visible_films += [row["film"]] * len(shown)
        for loss in find_losses(moments):
            end = len(moments) if loss.end is None else loss.end
            after = next((i for i in range(loss.start, end) if moments[i].state != "TRACKING"), end)
            suspect.append(after - loss.start)
            again = next((i for i in range(loss.start, len(moments)) if moments[i].visible), None)
            if again is not None:
                right = (
                    i
                    for i in range(again, len(moments))
                    if moments[i].supported and moments[i].state == "TRACKING"
                )
                at = next(right, None)
                never += at is None
                back.append(np.inf if at is None else (moments[at].stamp_ns - moments[again].stamp_ns) * 1e-9)
    result: dict[str, Any] = {"runs": len(rows), "frames": len(frame_films), "visible": len(visible_films)}
    for name, films in (("coverage", visible_films), ("false", frame_films)):
        values = np.array(count[name])
        result[name] = float(values.mean()) if len(values) else None
        result[f"{name}_interval"] = frame_intervals({name: values}, films)[name]
    result |= {
        "false_frames": int(round(sum(count["false"]) / 100.0)),
        "false_twice_in_a_row": twice,
        "runs_with_false": believed,
        "losses": len(suspect),
        "suspect_after_frames_median": float(np.median(suspect)) if suspect else None,
        "suspect_after_frames_most": max(suspect, default=None),
        "back_after_s_median": _finite(float(np.median(back))) if back else None,
        "never_back": never,
    }
    return result


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def text(result: Mapping[str, Any]) -> str:
    """A summary as tables."""
    parts = []
    for mode, causes in result.items():
        lines = []
        for cause, f in causes.items():
            shares = [_with_interval(f[name], f[f"{name}_interval"]) for name in ("coverage", "false")]
            lines.append([cause, *shares, *(f[key] for key in COLUMNS)])
        header = [mode, "TRACKING and right %", "false TRACKING %", *COLUMNS.values()]
        parts.append(table(header, lines))
    return "\n\n".join(parts)


COLUMNS = {
    "runs": "runs",
    "frames": "frames",
    "false_frames": "false",
    "false_twice_in_a_row": "twice",
    "runs_with_false": "runs with",
    "losses": "losses",
    "suspect_after_frames_median": "SUSPECT after",
    "suspect_after_frames_most": "at most",
    "back_after_s_median": "back after s",
    "never_back": "never",
}


def _with_interval(value: float | None, interval: tuple[float, float] | None) -> str | None:
    return None if value is None else f"{value:.2f} ({span(interval, 2)})"
