"""Another print, or the same in part out of date? What tells them apart, at the poses that are answered.

    .venv/bin/python benchmarks/other_print.py --bundles DIR --ids 2 3 5 6 --json OUT.json

The picture is a rendered view of the object, of whose print a share was replaced by labels or turned to other
hues (`changed_print`), in drawn light, with noise and blur; the reference model knows the print as it was. A
print that was changed all over is another one, and the answer is the pose at which it still agrees best.
Columns: median and 90 % of a figure, and how often it is lower than that of a wholly changed print of the
same kind (area under the ROC curve).
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from changed_print import changed

from huepose.colorpair.extract import bounds
from huepose.drawing.contact_sheet import contact_sheet
from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.evaluation.colorpairs.similarity_fit import disturbed_color
from huepose.evaluation.colorpairs.views import StudyView, object_views
from huepose.evaluation.result_files import write_json
from huepose.evaluation.summary import table
from huepose.geometry import Box, RgbdFrame, se3
from huepose.geometry.arrays import Bool, Float64, UInt8
from huepose.judge.contrast_disagreement import contrasts, otherwise_many
from huepose.judge.pair_agreement import agreement_many
from huepose.judge.pair_terms import pair_arrays, pair_picture, pair_score_many
from huepose.judge.region import prepare_region
from huepose.model import ReferenceModel, load_models
from huepose.support.progress import progress

FIGURES = ("contrasts elsewhere", "colour missing", "agreement of pairs", "correlation of pairs", "quality")
"""The last three are high where the print is the right one: they are taken with the other sign."""

KINDS = ("recoloured", "replaced")
PIXELS = 130.0
"""The object's diameter in the picture."""

SHOWN = (("recoloured", 0.0), ("recoloured", 0.3), ("replaced", 0.3), ("recoloured", 1.0), ("replaced", 1.0))
ROWS, CELL_PX, MARGIN_PX, LARGE_PIXELS = 2, 260, 6, 260.0
DRAWN, CLEAR = 1500, 0.3
"""Of the page: objects, sides of a cell, what is left round the object, and its diameter; most pairs, and how
clear those are that are drawn."""


def main() -> None:
    """Render, measure, print a table, write JSON."""
    arguments = _arguments()
    models = {
        name: model
        for name, model in load_models(arguments.bundles).items()
        if not arguments.ids or model.object_id in arguments.ids
    }
    shares = sorted({0.0, *arguments.shares, 1.0})
    values: dict[tuple[str, float], list[Float64]] = {}
    for number, model in enumerate(progress(list(models.values()), "objects")):
        for kind in KINDS:
            for share in shares:
                seen = measured(model, kind, share, arguments.views, arguments.seed + number)
                values.setdefault((kind, share), []).extend(seen)
    figures = {key: np.array(rows) for key, rows in values.items()}
    write_json(
        arguments.json, {"figures": FIGURES, "values": {f"{k} {s:g}": v for (k, s), v in figures.items()}}
    )
    print(lines(figures))
    if arguments.picture is not None:
        cv2.imwrite(str(arguments.picture), page(models, arguments.seed)[..., ::-1])


def page(models: Mapping[str, ReferenceModel], seed: int) -> UInt8:
    """One view of each of the first objects as it is, with part of its print changed, and with all of it:
    contrasts that point the model's way in green, elsewhere in red."""
    cells, labels = [], []
    for number, model in enumerate(list(models.values())[:ROWS]):
        for kind, share in SHOWN:
            mesh = changed(model.mesh, kind, share, seed + number) if share > 0.0 else model.mesh
            (view,) = object_views({model.name: replace(model, mesh=mesh)}, 1, LARGE_PIXELS, seed + number)
            region = prepare_region(view.frame, view.mask, Box.of_mask(view.mask), model.diameter_m)
            if region is None:
                continue
            picture = pair_picture(model, region.crop, region.median_depth_m)
            voices, elsewhere = contrasts(model, region, picture, view.T_cam_obj, DRAWN)
            share_elsewhere = otherwise_many(model, region, picture, view.T_cam_obj[None], DRAWN)[0]
            cells.append(_dotted(model, view, voices, elsewhere))
            print_is = f"{100 * share:.0f} % {kind}" if share > 0.0 else "as it is"
            labels.append(f"{print_is}: {100 * share_elsewhere:.0f} % elsewhere")
    return contact_sheet(cells, len(SHOWN), labels, (CELL_PX, CELL_PX))


def _dotted(model: ReferenceModel, view: StudyView, voices: Float64, elsewhere: Bool) -> UInt8:
    """The view with a dot at every clear contrast."""
    seen = voices > CLEAR
    points = pair_arrays(model.pairs, DRAWN).points[seen].astype(np.float64)
    left, top, right, bottom = bounds(view.mask, MARGIN_PX)
    pixels = view.frame.camera.project(se3.apply(view.T_cam_obj, points)) - [left, top]
    factor = CELL_PX / max(right - left, bottom - top)
    size = (round((right - left) * factor), round((bottom - top) * factor))
    out = cv2.resize(view.frame.color[top:bottom, left:right], size, interpolation=cv2.INTER_CUBIC)
    for (u, v), other in zip((pixels + 0.5) * factor, elsewhere[seen], strict=True):
        cv2.circle(out, (round(u), round(v)), 3, (230, 40, 40) if other else (30, 190, 60), -1, cv2.LINE_AA)
    return np.asarray(out, np.uint8)


def measured(model: ReferenceModel, kind: str, share: float, views: int, seed: int) -> list[Float64]:
    """FIGURES (5,) in each of some views of the object with a share of its print changed."""
    mesh = changed(model.mesh, kind, share, seed) if share > 0.0 else model.mesh
    rng = np.random.default_rng([seed, 92])
    estimator = Estimator({model.name: model}, EstimatorConfig(found_level=0.0))
    out = []
    for view in object_views({model.name: replace(model, mesh=mesh)}, views, PIXELS, seed):
        frame = RgbdFrame(disturbed_color(view, rng), view.frame.depth, view.frame.camera)
        answer, explanation = estimator.explain(frame, ObjectQuery(model.name, masks=(view.mask,)))
        if answer.T_cam_obj is None or explanation.evidence is None or answer.terms is None:
            continue
        region, T = explanation.evidence.region, answer.T_cam_obj[None]
        picture = pair_picture(model, region.crop, region.median_depth_m)
        pairs = pair_score_many(model, region, picture, T, 1500)[0]
        elsewhere = otherwise_many(model, region, picture, T)[0]
        agreed = agreement_many(model, region, picture, T)[0]
        signs = [elsewhere, answer.terms.missing, -agreed, -pairs[2] - pairs[3], -answer.quality]
        out.append(np.array(signs))
    return out


def lines(values: Mapping[tuple[str, float], Float64]) -> str:
    """The table."""
    rows = []
    for (kind, share), seen in values.items():
        other = values[kind, 1.0]
        cells: list[object] = []
        for k in range(len(FIGURES)):
            own, all_over = seen[:, k], other[:, k]
            lower = (own[:, None] < all_over).mean() + 0.5 * (own[:, None] == all_over).mean()
            middle, most = np.percentile(own, [50, 90])
            area = "" if share == 1.0 else f", {lower:.3f}"
            cells.append(f"{middle:.2f}, {most:.2f}{area}")
        rows.append([kind, f"{100 * share:.0f} %", len(seen), *cells])
    return table(["print", "changed", "n", *FIGURES], rows)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bundles", type=Path, required=True, metavar="DIR")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    parser.add_argument(
        "--ids", type=int, nargs="+", default=[], metavar="ID", help="all objects unless given"
    )
    parser.add_argument("--shares", type=float, nargs="+", default=[0.1, 0.3, 0.5], metavar="F")
    parser.add_argument("--views", type=int, default=6, metavar="N", help="of each object")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of views, light and patches")
    return parser.parse_args()


if __name__ == "__main__":
    main()
