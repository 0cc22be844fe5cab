"""A mesh whose texture is out of date: accuracy with a share of the texture replaced, blurred or recoloured.

    .venv/bin/python -m studies.changed_print --models DIR --ids 2 4 5 9 --bop SCENE... --json OUT.json

The images show the true texture; the reference model is learned from a changed one. Round patches of the
surface, of a sixth of the diameter, are changed until they make up the share.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.datasets.bop import BopScene
from huepose.datasets.types import SomeImages
from huepose.estimation import Estimator, EstimatorConfig
from huepose.evaluation import metrics
from huepose.evaluation.bootstrap import frame_intervals
from huepose.evaluation.equivalents import read_equivalents
from huepose.evaluation.estimate_protocol import EstimateOptions, evaluate_estimates
from huepose.evaluation.result_files import plain, write_json
from huepose.evaluation.summary import table
from huepose.evaluation.targets import Targets
from huepose.geometry import Mesh
from huepose.geometry.arrays import Bool, UInt8
from huepose.model import ReferenceModel, load_model, save_model
from huepose.onboarding import onboard_mesh
from huepose.onboarding.bop_folder import BopModel, bop_models
from huepose.onboarding.meshes import read_mesh
from huepose.scenes import textures
from huepose.support.errors import InputError
from huepose.support.progress import progress

KINDS = ("replaced", "blurred", "recoloured")
AS_IT_IS = "as it is"

COMMON = ("ids", "bop", "images", "method", "seed")
"""Options that all results of a file have in common."""


def changed(mesh: Mesh, kind: str, share: float, seed: int) -> Mesh:
    """The mesh with `share` of its surface in another texture."""
    where = patches(mesh, share, seed)
    texture = mesh.texture.copy()
    texture[where] = _other(mesh.texture, kind, seed)[where]
    return replace(mesh, texture=texture)


def patches(mesh: Mesh, share: float, seed: int) -> Bool:
    """Texels (H, W) of round patches of the surface that make up `share` of its area."""
    rng = np.random.default_rng([seed, 90])
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    middles = corners.mean(1)
    _, areas = mesh.face_normals()
    radius = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))) / 6.0
    chosen = np.zeros(len(areas), bool)
    while areas[chosen].sum() < share * areas.sum():
        seed_face = rng.choice(len(areas), p=areas / areas.sum())
        distance = np.linalg.norm(middles - middles[seed_face], axis=1)
        # The last patch is as large as is still missing.
        near = np.flatnonzero((distance < radius) & ~chosen)
        near = near[np.argsort(distance[near])]
        missing = share * areas.sum() - areas[chosen].sum()
        chosen[near[: int(np.searchsorted(np.cumsum(areas[near]), missing)) + 1]] = True
    height, width = mesh.texture.shape[:2]
    mask = np.zeros((height, width), np.uint8)
    outlines = np.rint(mesh.uv[chosen] * [width, height] - 0.5).astype(np.int32)
    for outline in outlines:
        cv2.fillConvexPoly(mask, outline, 1)
    return np.asarray(cv2.dilate(mask, np.ones((3, 3), np.uint8)) > 0)


def _other(texture: UInt8, kind: str, seed: int) -> UInt8:
    """The whole texture in another texture."""
    height, width = texture.shape[:2]
    rng = np.random.default_rng([seed, 91])
    if kind == "blurred":
        return np.asarray(cv2.GaussianBlur(texture, (0, 0), width / 40.0), np.uint8)
    if kind == "recoloured":
        hsv = cv2.cvtColor(texture, cv2.COLOR_RGB2HSV).astype(np.int32)
        hsv[..., 0] = (hsv[..., 0] + 60 + int(rng.integers(60))) % 180
        hsv[..., 1] = np.clip(hsv[..., 1] + 60, 0, 255)
        return np.asarray(cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2RGB), np.uint8)
    tiles = [
        textures.front("NEW", "recipe", "OFFER")(
            rng, height // 4, width // 4, textures.palette(rng.uniform(), rng)
        )
        for _ in range(16)
    ]
    picture = np.vstack([np.hstack(tiles[4 * k : 4 * k + 4]) for k in range(4)])
    return np.asarray(cv2.resize(picture, (width, height)), np.uint8)


def main() -> None:
    """Learn every changed object, estimate in the images of the true one, print a table."""
    arguments = _arguments()
    scenes = [thinned(BopScene(path), arguments.images) for path in arguments.bop]
    equivalents = read_equivalents(arguments.equivalent) if arguments.equivalent else {}
    objects = bop_models(arguments.models, arguments.ids)
    variants = [(AS_IT_IS, 0.0), *((kind, share) for kind in arguments.kinds for share in arguments.shares)]
    record: dict[str, Any] = {"options": {k: str(v) for k, v in vars(arguments).items()}, "variants": []}
    if arguments.json.exists():
        held = json.loads(arguments.json.read_text())
        if any(held["options"][name] != record["options"][name] for name in COMMON):
            raise InputError(
                arguments.json, found="results with other options", expected="the same " + ", ".join(COMMON)
            )
        record["variants"] = held["variants"]
    done = {(v["kind"], v["share"]) for v in record["variants"]}
    for kind, share in progress([v for v in variants if v not in done], "textures"):
        models = {o.name: _learned(o, kind, share, arguments) for o in objects}
        estimator = Estimator(models, EstimatorConfig(method=arguments.method))
        options = EstimateOptions(min_visib=0.3, seeds=(0,))
        result = evaluate_estimates(scenes, Targets(models), estimator, options, equivalents=equivalents)
        rows = [row.as_json() for row in result.rows]
        entry = {"kind": kind, "share": share, **result.summary(), "rows": rows}
        record["variants"].append(plain(entry))  # as it would come back from the file
        write_json(arguments.json, record)
    print(lines(record["variants"]))


def thinned(scene: BopScene, most: int) -> SomeImages:
    """At most so many images of a scene, evenly spread."""
    return SomeImages(scene, scene.image_ids[:: -(-len(scene.image_ids) // most)])


def lines(variants: Sequence[Mapping[str, Any]]) -> str:
    """The table: figures of each texture, and what ADD recall and its AUC are above those of the right
    texture, with the interval that holds 95 % of draws of frames; then ADD recall by object."""
    base = _values(variants[0]["rows"])
    rows = []
    for variant in variants:
        values = _values(variant["rows"])
        frames = [(r["scene"], r["image"]) for r in variant["rows"]]
        more = {name: values[name] - base[name] for name in ("ADD", "AUC")}
        spans = frame_intervals(more, frames)
        shown = [
            f"{more[name].mean():+.1f} ({spans[name][0]:+.1f} to {spans[name][1]:+.1f})" for name in more
        ]
        found = 100.0 * np.mean([r["found"] for r in variant["rows"]])
        figures = [variant[key] for key in ("recall_add", "recall_adds", "auc_add", "auc_adds")]
        rows.append([variant["kind"], 100.0 * variant["share"], len(frames), *figures, found, *shown])
    header = ["texture", "changed %", "n", "ADD", "ADD-S", "AUC", "AUC-S", "found", "more ADD", "more AUC"]
    names = list(variants[0]["per_object"])
    by_object = [
        [f"{v['kind']} {100.0 * v['share']:.0f}", *(v["per_object"][n]["recall_add"] for n in names)]
        for v in variants
    ]
    return table(header, rows) + "\n" + table(["recall ADD by object", *map(str, names)], by_object)


def _values(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """By row, in percent: whether ADD is right (N,), and its share of the AUC (N,)."""
    add = np.array([np.inf if r["add_m"] is None else r["add_m"] for r in rows])
    limits = metrics.RECALL_FRACTION * np.array([r["diameter_m"] for r in rows])
    area = 100.0 * np.maximum(0.0, 1.0 - add / metrics.AUC_LIMIT_M)
    return {"ADD": np.where(add < limits, 100.0, 0.0), "AUC": area}


def _learned(entry: BopModel, kind: str, share: float, arguments: argparse.Namespace) -> ReferenceModel:
    """The reference model of a changed mesh: learned, or as it was kept when it was learned before."""
    path = arguments.work / f"{kind}_{100 * share:.0f}_{arguments.seed}".replace(" ", "_")
    path = path / f"{entry.name}.huepose"
    if path.exists():
        kept = load_model(path)
        if kept.tables is not None or arguments.method == "full":
            return kept
    mesh = read_mesh(entry.mesh_path, "mm")
    if share > 0:
        mesh = changed(mesh, kind, share, arguments.seed + entry.object_id)
    paper = arguments.method != "full"
    model = onboard_mesh(mesh, entry.name, object_id=entry.object_id, info=entry.info, paper=paper)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_model(model, path)
    return model


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Accuracy with reference models of an out-of-date texture.")
    parser.add_argument("--models", type=Path, required=True, metavar="DIR", help="BOP models folder")
    parser.add_argument("--ids", type=int, nargs="+", required=True, metavar="ID")
    parser.add_argument("--bop", type=Path, nargs="+", required=True, metavar="SCENE_DIR")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE",
                        help="results; what it holds already is not measured again")  # fmt: skip
    parser.add_argument("--work", type=Path, default=Path("build/changed_texture"), metavar="DIR",
                        help="where the changed reference models are kept")  # fmt: skip
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--shares", type=float, nargs="+", default=[0.1, 0.2, 0.3], metavar="F")
    parser.add_argument("--images", type=int, default=1000, metavar="N", help="most of a scene, evenly")
    parser.add_argument("--equivalent", type=Path, default=None, metavar="FILE")
    parser.add_argument("--method", choices=("full", "colorpair"), default="full")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the patches")
    return parser.parse_args()


if __name__ == "__main__":
    main()
