"""Fit quality completely, in one run: render scenes, estimate in them, fit both methods, write the fits.

    .venv/bin/python -m studies.quality --models MODELS_DIR --work build/quality

Scenes and reference models under `--work` are kept for the next run; estimates are made again in each run.
The data have heaps and piles, because in piles, with dim light and much occlusion, the same evidence is
weaker.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial, reduce
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from huepose.believe.logistic import fitted, write_fit
from huepose.datasets.bop import BopScene
from huepose.evaluation.calibration import Judged, Worth, read_judged, worth
from huepose.evaluation.summary import table
from huepose.geometry.arrays import Bool
from huepose.geometry.mesh import Mesh
from huepose.model.io import model_path
from huepose.onboarding.bop_folder import bop_models
from huepose.scenes.rendered import write_rendered_set
from huepose.scenes.shapes import demo_objects
from huepose.support.words import known
from huepose_services.cli.main import main as run_huepose
from studies.absent import read_absent
from studies.quality.estimates import Part, estimate
from studies.quality.fit import FEATURES, Fitted, as_json, fit

SIZES = (1.2, 1.0 / 1.2)
OWN = "cal_own"
"""The scene of the built-in objects, whose numbers are not those of the others."""

ALIKE = {"cal_alike": (1, 25, 103), "cal_alike_9": (9, 10, 409), "cal_alike_11": (11, 10, 411)}
"""Scenes of the built-in shapes in other textures: number of the textures, number of frames, seed. Their hues
are rotated by 291, 77 and 29 degrees against those of the reference models."""

MIRRORED = "cal_alike_mirrored"
"""The scene of the built-in objects with mirrored textures: the same hues, another layout everywhere."""

SHARE = {"full": 1, "colorpair": 3}
"""Every SHARE-th frame is used, because the second method takes longer."""

HEADING = ["held out", "n", "right", "error", "by chance", "found %", "over the level %", "right of them %"]


def main() -> None:
    """Prepare, estimate in processes, fit, write, print."""
    arguments = _arguments()
    work: Path = arguments.work
    own, builtin = work / "builtin", work / OWN
    ycb = rendered_scene(work / "cal_ycb", str(arguments.models), 100, 101)
    piles = rendered_scene(work / "cal_piles", str(arguments.models), 80, 106, "--kind", "piles")
    bundles = bundles_of(arguments.models, arguments.bundles, work)
    rendered_scene(builtin, "builtin", 30, 102)
    alike = [
        rendered_scene(work / name, "builtin", frames, seed, "--textures", str(textures))
        for name, (textures, frames, seed) in ALIKE.items()
    ]
    alike.append(_altered(work / MIRRORED, _mirrored, 421))
    sizes = [
        _altered(work / f"cal_size_{k}", partial(_resized, factor=factor), 104 + k)
        for k, factor in enumerate(SIZES)
    ]
    onboarded(builtin / "models", own)
    parts = []
    for method in arguments.methods:
        n = arguments.processes * SHARE[method]
        for first in range(0, n, SHARE[method]):
            parts += [
                Part("labels", method, ycb, bundles, first, n),
                Part("labels", method, piles, bundles, first, n),
                Part("others", method, ycb, bundles, first, n),
                Part("labels", method, builtin, own, first, n),
                *(Part("alike", method, scene, own, first, n) for scene in alike),
                *(Part("sizes", method, scene, own, first, n) for scene in sizes),
            ]
    with ProcessPoolExecutor(arguments.processes, mp_context=get_context("spawn")) as pool:
        list(pool.map(estimate, parts, [work] * len(parts)))
    fits = dict(fitted("quality"))
    for method in arguments.methods:
        files = {
            kind: [work / f"{p.name}.json" for p in parts if (p.method, p.kind) == (method, kind)]
            for kind in ("labels", "others", "alike", "sizes")
        }
        labels = _all([read_judged(path) for path in files["labels"]])
        wrong = [_all([read_absent(path) for path in files[kind]]) for kind in ("others", "alike", "sizes")]
        result = fit(labels, FEATURES[method], *wrong)
        fits[method] = as_json(result.fit)
        _print(method, result, labels, *wrong)
        apart = fit(by_object(labels, files["labels"]), FEATURES[method], *wrong)
        rows = [
            worth_row(name, worth(apart.labels[chosen], labels.only(chosen), apart.fit.level))
            for name, chosen in _by_scene(labels).items()
        ]
        print(table(["objects held out", *HEADING[1:]], rows))
    write_fit("quality", fits)


def _print(method: str, fitted: Fitted, labels: Judged, others: Judged, alike: Judged, sizes: Judged) -> None:
    level, found = fitted.fit.level, fitted.fit.found
    rows: list[list[Any]] = []
    for name, chosen in _by_scene(labels).items():
        present = fitted.present_labels[chosen] >= found
        rows.append(worth_row(name, worth(fitted.labels[chosen], labels.only(chosen), level, present)))
    rows.append(worth_row("all labels", worth(fitted.labels, labels, level, fitted.present_labels >= found)))
    rows.append(worth_row("others", worth(fitted.others, others, level, fitted.present_others >= found)))
    for kind, judged, quality in (("textures", alike, fitted.alike), ("sizes", sizes, fitted.sizes)):
        rows += [
            worth_row(f"other {kind}: {name}", worth(quality[chosen], judged.only(chosen), level))
            for name, chosen in _by_scene(judged, kind).items()
        ]
    print(f"{method}: level {level:.3f}, found {found:.3f}")
    print(table(HEADING, rows))
    print(_near_ties(fitted, labels))


def worth_row(name: str, worth: Worth) -> list[Any]:
    """A row under HEADING."""
    chance = "-" if worth.chance is None else "{:.3f} to {:.3f}".format(*worth.chance)
    precision = None if worth.precision is None else 100.0 * worth.precision
    right = 100.0 * worth.right / max(1, worth.poses)
    ece, found, over = known(worth.ece, ".3f"), 100.0 * worth.found, 100.0 * worth.coverage
    return [name, worth.poses, right, ece, chance, found, over, precision]


def by_object(labels: Judged, paths: Sequence[Path]) -> Judged:
    """The same poses as if each object were one frame: then folds hold out whole objects."""
    objects = {
        (str(path), row["scene"], int(row["image"]), row["instance"]): (row["scene"] == OWN, row["object"])
        for path in paths
        for row in json.loads(path.read_text())["rows"]
    }
    return replace(labels, frames=[objects[instance] for instance in labels.instances])


def _by_scene(judged: Judged, kind: str = "labels") -> dict[str, Bool]:
    """Which poses are of each calibration scene, by its name."""
    end = {"textures": "_alike_"}.get(kind, f"_{kind}_")
    scenes = np.array([Path(frame[0]).name.rpartition(end)[0] for frame in judged.frames])
    return {str(name).split("_", 1)[1]: scenes == name for name in dict.fromkeys(scenes.tolist())}


def _near_ties(fitted: Fitted, labels: Judged) -> str:
    """How often the first pose and its best alternative are right, by the probability of the alternative."""
    stated = [fitted.fit.probabilities(terms) for terms in labels.terms]
    second = np.array([p[1] if len(p) > 1 else 0.0 for p in stated])
    first = np.array([p[0] for p in stated])
    rows = []
    for low, high in ((0.05, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 0.5)):
        tied = (second >= low) & (second < high)
        if tied.any():
            right = labels.which[tied]
            shares = [first[tied], right == 0, second[tied], right == 1]
            rows.append([f"{low} to {high}", int(tied.sum()), *(100.0 * s.mean() for s in shares)])
    heading = ["alternative stated", "n", "first stated %", "first right %", "it stated %", "it right %"]
    return table(heading, rows)


def _all(parts: Sequence[Judged]) -> Judged:
    return reduce(lambda a, b: a + b, parts)


def _altered(scene: Path, change: Callable[[Mesh], Mesh], seed: int) -> Path:
    """A scene of the built-in objects, each changed; missing frames are rendered."""
    meshes = {name: change(mesh) for name, mesh in demo_objects().items()}
    write_rendered_set(scene, meshes, {name: k for k, name in enumerate(meshes, 1)}, 12, seed)
    return scene


def _resized(mesh: Mesh, factor: float) -> Mesh:
    return replace(mesh, vertices=np.float32(factor) * mesh.vertices)


def _mirrored(mesh: Mesh) -> Mesh:
    assert mesh.texture is not None
    return replace(mesh, texture=np.ascontiguousarray(mesh.texture[::-1]))


def rendered_scene(scene: Path, models: str, frames: int, seed: int, *more: str) -> Path:
    """A scene of `huepose render-scenes`, rendered if it is missing or incomplete."""
    there = len(BopScene(scene).image_ids) if (scene / "scene_gt.json").exists() else 0
    if there < frames:
        size = ("--frames", str(frames), "--seed", str(seed))
        _run("render-scenes", "--models", models, "--out", str(scene), *size, *more)
    return scene


def bundles_of(models: Path, bundles: Path | None, work: Path) -> Path:
    """The reference models of a BOP models folder; if none are given, they are onboarded under `work`."""
    return onboarded(models, work / "bundles") if bundles is None else bundles


def onboarded(models: Path, out: Path) -> Path:
    """A folder with the reference models of a BOP models folder, made if one of them is missing."""
    if not all(model_path(out, model.name).exists() for model in bop_models(models)):
        _run("onboard-bop", str(models), "--out", str(out), "--paper")
    return out


def _run(*words: str) -> None:
    """Run a command of `huepose`; if it fails or is interrupted, the study ends, too."""
    code = run_huepose(list(words))
    if code:
        raise SystemExit(code)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Fit quality completely, in one run.")
    parser.add_argument("--models", type=Path, required=True, metavar="DIR", help="BOP models folder")
    bundles = "their reference models (onboarded under --work)"
    parser.add_argument("--bundles", type=Path, default=None, metavar="DIR", help=bundles)
    parser.add_argument("--work", type=Path, default=Path("build/quality"), metavar="DIR")
    parser.add_argument("--methods", nargs="+", choices=tuple(FEATURES), default=list(FEATURES))
    parser.add_argument("--processes", type=int, default=2, metavar="N")
    return parser.parse_args()


if __name__ == "__main__":
    main()
