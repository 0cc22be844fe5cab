"""One self-contained HTML page: the tables, and the same results as plots."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from huepose.drawing.canvas import Colour
from huepose.drawing.plots import bar_chart, line_plot, reliability_plot
from huepose.evaluation import metrics
from huepose.evaluation.ablation_rows import AblationResult
from huepose.evaluation.summary import Row, errors
from huepose.evaluation.tables.figures import Unseen, by_name_of, figures, rows_of, scored
from huepose.evaluation.tables.published import published
from huepose.evaluation.tables.table import Table, in_short
from huepose.geometry.arrays import UInt8

_STATES: Mapping[str, Colour] = {
    "TRACKING": (226, 243, 232),
    "SUSPECT": (255, 243, 214),
    "LOST": (250, 224, 220),
}
_FLOW = (
    "As in the paper's figure: the motion between frames five apart, from all flow, from the flow that the "
    "filter by colour pairs keeps, and from the correspondences of the tracker. Errors as shares of the true "
    "motion; end-point error of the flow. robust: closed form, direct: a network. {0.pairs} pairs."
)
_SHARES = np.linspace(0.0, 0.3, 121)
_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1500px;margin:2em auto;padding:0 1.2em}
h1{font-size:1.6em;margin-bottom:.2em} h2{font-size:1.15em;margin:2.2em 0 .6em;border-bottom:1px solid #ddd}
.wide{overflow-x:auto} table{border-collapse:collapse;font-size:12px;font-variant-numeric:tabular-nums}
th,td{padding:2px 5px;text-align:right;white-space:nowrap} tbody th{text-align:left;font-weight:500}
thead th{border-bottom:1px solid #999;text-align:center} td.published,th.published{color:#777}
td.measured{background:#eef5fb} tbody tr:hover td,tbody tr:hover th{background:#fdf6e3}
tr.whole{font-weight:600} tr.whole th{font-weight:600} tr:not(.whole)+tr.whole>*{border-top:1px solid #999}
tr.whole+tr:not(.whole)>*{border-top:1px solid #999}
ul{color:#555;font-size:13px;padding-left:1.2em} .figures{display:flex;flex-wrap:wrap;gap:12px}
figure{margin:0;max-width:100%} figure img{max-width:100%;height:auto;border:1px solid #eee}
figcaption{font-size:13px;color:#555;max-width:720px}
dl{display:grid;grid-template-columns:max-content auto;gap:0 1em;font-size:13px} dt{color:#777} dd{margin:0}
"""


def page(
    tables: Sequence[Table],
    origin: Mapping[str, str],
    coverage: Sequence[str],
    images: Mapping[str, Sequence[Row]],
    tracks: Mapping[tuple[str, int], Sequence[Row]],
    names: Mapping[str, str],
    unseen: Unseen | None = None,
    flow: AblationResult | None = None,
) -> str:
    """The page as HTML. images: rows of single frames by method; tracks: rows by (method, N), for every
    N-th frame; names: of objects, by their id in rows; unseen: results of the unseen objects, with their
    own plots; flow: the ablation."""
    facts = "".join(f"<dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd>" for k, v in origin.items())
    seen = "".join(f"<li>{html.escape(line)}</li>" for line in coverage)
    parts = [replace(table, title=f"In short: {table.title}").html() for table in in_short(tables)]
    parts += [table.html() for table in tables if table.key.startswith("table1")]
    parts += _figures("Single frames", _image_pictures(images, names)) if any(images.values()) else []
    if unseen is not None:
        rows = {method: rows_of(entries) for method, entries in unseen.images.items()}
        parts += _figures("Unseen objects", _image_pictures(rows, unseen.names)) if any(rows.values()) else []
    parts += [table.html() for table in tables if table.key.startswith("table2")]
    for every in sorted({every for _, every in tracks}):
        runs = {method: rows for (method, n), rows in tracks.items() if n == every and rows}
        title = "Tracks, every frame" if every == 1 else f"Tracks, every {every}th frame"
        parts += _figures(title, _track_pictures(runs)) if runs else []
    if flow is not None:
        picture = flow.picture({k: _short(name) for k, name in names.items()})
        parts += _figures(
            "Ablation: flow, and what colour pairs leave of it", [(picture, _FLOW.format(flow))]
        )
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>HuePose: the tables of the paper</title>'
        f"<style>{_STYLE}</style><body><h1>The tables of the paper, and what this code gives</h1>"
        f"<dl>{facts}</dl><ul>{seen}</ul>{''.join(parts)}</body></html>\n"
    )


def _figures(title: str, pictures: Sequence[tuple[UInt8, str]]) -> list[str]:
    shown = "".join(_figure(picture, text) for picture, text in pictures)
    return [f'<h2>{title}, as plots</h2><div class="figures">{shown}</div>']


def _figure(picture: UInt8, text: str) -> str:
    data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].tobytes()
    source = "data:image/png;base64," + base64.b64encode(data).decode()
    words = html.escape(text)
    return f'<figure><img alt="{words}" src="{source}"><figcaption>{words}</figcaption></figure>'


def _image_pictures(
    by_method: Mapping[str, Sequence[Row]], names: Mapping[str, str]
) -> list[tuple[UInt8, str]]:
    known = {method: list(rows) for method, rows in by_method.items() if rows}
    pictures = []
    for key, name in (("add_official_m", "ADD"), ("adds_m", "ADD-S")):
        series = {}
        for method, rows in known.items():
            shares = errors(rows, key) / np.array([row["diameter_m"] for row in rows])
            series[method] = (100.0 * _SHARES, metrics.accuracy_curve(shares, _SHARES))
        title = f"recall by {name}"
        picture = line_plot(series, title, "threshold, % of the diameter", "% of labels", (0, 30), (0, 103))
        pictures.append((picture, f"Recall of {name} over the threshold; the tables take 10 %."))
    beside = published("table1").rows
    paper = "; published: the paper's own column" if set(names.values()) & set(beside) else ""
    pictures.append((_objects(known, names), f"Recall of ADD by object{paper}; no bar is 0."))
    for method, rows in known.items():
        found = [row for row in rows if row["found"]]
        if found and method in ("full", "colorpair"):
            quality = np.array([row["quality"] for row in found])
            right = np.array([row["right"] for row in found], bool)
            picture = reliability_plot(quality, right, title=method)
            pictures.append((picture, f"{method}: stated quality against the share that is right."))
    return pictures


def _objects(by_method: Mapping[str, Sequence[Row]], names: Mapping[str, str]) -> UInt8:
    paper = published("table1")
    ours = next(
        values
        for head, values, _ in paper.columns
        if (head.method, head.figure) == ("Ours (published)", "ADD")
    )
    blocks = by_name_of(by_method, names)
    shown = sorted({name for block in blocks.values() for name in block})
    series = {"published": [ours.get(name, np.nan) for name in shown]} if ours.keys() & set(shown) else {}
    for method, block in blocks.items():
        series[method] = [figures(block.get(name, []))["recall_add"] or 0.0 for name in shown]
    short = [_short(name) for name in shown]
    size = (max(720, 30 * len(shown) * len(series)), 460)
    return bar_chart(short, series, "recall of ADD by object", "%", (0.0, 118.0), size, notes=False)


def _short(name: str) -> str:
    return name.split("_")[0] if name[:3].isdigit() else name[:12]


def _track_pictures(by_method: Mapping[str, Sequence[Row]]) -> list[tuple[UInt8, str]]:
    limits = np.linspace(0.0, metrics.AUC_LIMIT_M, 201)
    curves = {
        f"{method}, AUC {metrics.auc_voc(errors(scored(rows), 'add_m')):.1f}": (
            1000.0 * limits,
            metrics.accuracy_curve(errors(scored(rows), "add_m"), limits),
        )
        for method, rows in by_method.items()
        if scored(rows)
    }
    picture = line_plot(curves, "all frames", "ADD threshold, mm", "% of frames", (0, 100), (0, 103))
    pictures = [(picture, "Share of frames under each threshold of ADD.")]
    sequences = sorted({row["sequence"] for rows in by_method.values() for row in rows})
    for sequence in sequences:
        lines, bands = {}, []
        for method, rows in by_method.items():
            own = sorted(
                (row for row in rows if row["sequence"] == sequence), key=lambda row: row["stamp_ns"]
            )
            if not own:
                continue
            seconds = np.array([(row["stamp_ns"] - own[0]["stamp_ns"]) * 1e-9 for row in own])
            millimetres = np.array([np.nan if row["add_m"] is None else 1000.0 * row["add_m"] for row in own])
            lines[method] = (seconds, millimetres)
            if method == "full":
                bands = _bands(seconds, [row["state"] for row in own])
        text = "ADD over time; behind it the state of `full`: green TRACKING, yellow SUSPECT, red LOST."
        picture = line_plot(lines, sequence, "seconds", "ADD in mm", bands=bands, size=(720, 320))
        pictures.append((picture, text))
    return pictures


def _bands(seconds: np.ndarray, states: Sequence[str | None]) -> list[tuple[float, float, Colour]]:
    """Intervals with the same state: begin, end, colour."""
    bands: list[tuple[float, float, Colour]] = []
    step = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1.0
    for at, state in zip(seconds.tolist(), states, strict=True):
        color = _STATES.get(state or "", (255, 255, 255))
        if bands and bands[-1][2] == color:
            bands[-1] = (bands[-1][0], at + step, color)
        else:
            bands.append((at, at + step, color))
    return bands
