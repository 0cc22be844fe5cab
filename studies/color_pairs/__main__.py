"""What colour pairs are worth, step by step, on rendered views, where the answer is known.

    .venv/bin/python -m studies.color_pairs [STUDY] --bundles DIR --json OUT.json

How many pairs are found again after a change (repeatability), how well their similarity tells places apart
(similarity), which triangles vote right (triangles), from how far semantic ICP comes home (icp), and the
picture of their classes on real frames (figure, with --bop and --plots).
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from huepose.evaluation.pictures import write_picture
from huepose.evaluation.result_files import write_json
from huepose.evaluation.targets import Targets
from huepose.geometry.arrays import UInt8
from huepose.model import ReferenceModel, load_models
from huepose.support.errors import InputError
from huepose_services.cli.evaluate_scenes import open_bop

STUDIES = ("repeatability", "similarity", "triangles", "icp", "figure")


def main(words: Sequence[str] | None = None) -> None:
    """Run the studies, print their tables, write the record and the pictures."""
    arguments = _arguments(words)
    models = load_models(arguments.bundles)
    chosen = {m.name: m for m in Targets(models, arguments.objects).models if len(m.pairs.points)}
    every = [s for s in STUDIES if s != "figure" or arguments.bop]
    wanted = [arguments.study] if arguments.study else every
    record: dict[str, Any] = {"objects": sorted(chosen), "views": arguments.views, "seed": arguments.seed}
    for study in wanted:
        print(f"-- {study}")
        record[study] = globals()[f"_{study}"](arguments, chosen)
    write_json(arguments.json, record)


def _repeatability(arguments: argparse.Namespace, models: Mapping[str, ReferenceModel]) -> Any:
    from studies.color_pairs.repeatability import repeatability
    from studies.color_pairs.report import repeatability_lines, repeatability_picture

    rows = repeatability(models, arguments.views, arguments.seed)
    print("\n".join(repeatability_lines(rows)))
    _save(arguments, "repeatability.png", repeatability_picture(rows))
    return [asdict(r) for r in rows]


def _similarity(arguments: argparse.Namespace, models: Mapping[str, ReferenceModel]) -> Any:
    from huepose.colorpair.similarity import SimilarityConfig
    from studies.color_pairs.similarity_fit import fitted_similarity, labelled_pairs, quality_of

    fit, held_out = (labelled_pairs(models, arguments.views, arguments.seed + k) for k in (0, 1))
    now = SimilarityConfig()
    best, tried = fitted_similarity(fit, now)
    out: dict[str, Any] = {"tried": [{"name": n, "value": v, "area": a} for n, v, a in tried]}
    for name, config in (("in use", now), ("fitted", best)):
        on_fit, on_others = quality_of(fit, config), quality_of(held_out, config)
        out[name] = {"parameters": asdict(config), "fit": asdict(on_fit), "held out": asdict(on_others)}
        print(f"{name}: " + ", ".join(f"{k} {v:.3g}" for k, v in asdict(config).items()))
        print(f"   area under ROC {on_fit.area:.4f}, on other views {on_others.area:.4f}")
        print(f"   recall at 1 % false {on_fit.recall:.3f}, on other views {on_others.recall:.3f}")
    return out


def _triangles(arguments: argparse.Namespace, models: Mapping[str, ReferenceModel]) -> Any:
    from studies.color_pairs.triangle_fit import triangle_scenes, triangle_shares

    rows = triangle_shares(triangle_scenes(models, arguments.views, arguments.seed))
    print("weight of area  of eccentricity  % of the vote right")
    for row in rows:
        print(f"{row.area:14g} {row.eccentricity:16g} {100 * row.right:20.1f}")
    return [asdict(r) for r in rows]


def _icp(arguments: argparse.Namespace, models: Mapping[str, ReferenceModel]) -> Any:
    from studies.color_pairs.icp_basin import METHODS, basins
    from studies.color_pairs.report import basin_lines, basin_picture
    from studies.color_pairs.triangle_fit import triangle_scenes

    rows = basins(triangle_scenes(models, arguments.views, arguments.seed), METHODS, seed=arguments.seed)
    print("\n".join(basin_lines(rows)))
    _save(arguments, "icp_basin.png", basin_picture(rows))
    return [asdict(r) for r in rows]


def _figure(arguments: argparse.Namespace, models: Mapping[str, ReferenceModel]) -> Any:
    from studies.color_pairs.figure import class_figure, class_row

    if not arguments.bop or arguments.plots is None:
        raise InputError("the figure", found="no scenes, or no folder for it", fix="Give --bop and --plots.")
    by_id = {m.object_id: m for m in models.values()}
    rows: dict[str, list[UInt8]] = {}
    for scene in open_bop(arguments.bop):
        for image in scene.image_ids:
            for truth in scene.truths(image):
                model, mask = by_id.get(truth.object_id), truth.mask()
                if model is None or model.name in rows or mask is None or truth.T_cam_obj is None:
                    continue
                if (truth.visib_fract or 1.0) > 0.8:
                    rows[model.name] = class_row(model, scene.frame(image), mask, truth.T_cam_obj)
    if not rows:
        raise InputError("the figure", found="no label of these objects that is 80 % visible")
    _save(arguments, "classes.png", class_figure(list(rows.items())))
    return sorted(rows)


def _save(arguments: argparse.Namespace, name: str, picture: UInt8) -> None:
    if arguments.plots is None:
        return
    path: Path = arguments.plots / name
    write_picture(path, picture)
    print(path)


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("study", nargs="?", choices=STUDIES, help="only this one (default: all)")
    parser.add_argument("--bundles", type=Path, required=True, metavar="DIR", help="reference models")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE", help="result file")
    parser.add_argument("--objects", nargs="+", default=None, metavar="ID", help="only these (default: all)")
    parser.add_argument("--views", type=int, default=3, metavar="N", help="rendered views of each object (3)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of views and disturbances (0)")
    parser.add_argument("--bop", type=Path, nargs="+", metavar="SCENE_DIR", help="frames for the figure")
    parser.add_argument("--plots", type=Path, default=None, metavar="DIR", help="curves and pictures")
    return parser.parse_args(words)


if __name__ == "__main__":
    main()
