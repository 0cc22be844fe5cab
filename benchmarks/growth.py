"""How cost grows: with the known objects, the objects in view, the image size, the triangles of a mesh, the
readers of poses.

    OMP_NUM_THREADS=1 .venv/bin/python -m benchmarks.growth --out DIR
        [--only known memory visible pixels triangles onboarding readers] [--quick]

CPU milliseconds (all threads) of one frame, medians, and private memory of a process. The scene is a wall
with rows of objects before it, all rotating slowly; the objects are the demo's five, repeated under other
names if more are needed. Each curve gets an exponent: the slope of a straight line through the logarithms,
over the larger half of the curve, where constant costs count less. 1 is linear, 0 is constant.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.readers import readers
from huepose.drawing.plots import line_plot
from huepose.estimation import Estimator, ObjectQuery
from huepose.evaluation.result_files import origin
from huepose.geometry import Camera, se3
from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.mesh import Mesh
from huepose.judge.silhouette import projected_box
from huepose.model import load_models, save_model
from huepose.model.io import model_path
from huepose.model.types import ReferenceModel
from huepose.onboarding import onboard_mesh
from huepose.perception.view_detector import ViewDetector
from huepose.profiles import profile
from huepose.rendering.render import render
from huepose.scenes.builtin import builtin_objects
from huepose.support.files import write_picture
from huepose.support.progress import progress
from huepose.tracking import Tracker
from huepose.tracking.types import Correction
from huepose_services.builtin import builtin_bundles

CAMERA = Camera(600.0, 600.0, 319.5, 239.5, 640, 480)
COLUMNS, SPACING_M, AWAY_M, WALL_M = 5, 0.27, 1.5, 2.2
"""Objects in a row, their spacing and distance, and the distance of the wall behind them."""

KNOWN, VISIBLE = (1, 2, 5, 10, 20, 50, 100), (1, 2, 5, 10, 20)
SIZES = ((320, 240), (480, 360), (640, 480), (960, 720), (1280, 960))
HALVINGS, READERS = (0, 1, 2, 3, 4), (1, 2, 5, 10, 20, 50, 100)
"""How often each edge of a mesh is halved, which makes four triangles of one; number of readers."""

IN_VIEW = 5
"""Objects in view if their number is not varied."""

WORKERS = ("tracker", "estimator", "detector")
FRAMES, WARM = 24, 4
"""Frames of a measurement; frames at its start that are not counted."""

PERIOD_NS = round(1e9 / 30.0)

Curves = dict[str, list[tuple[float, float]]]
Models = Mapping[str, ReferenceModel]


def main() -> None:
    """Measure, plot, print a Markdown table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    axes: dict[str, tuple[str, str, Callable[[Sequence[int]], Curves], Sequence[int]]] = {
        "known": ("known objects, five of them in view", "CPU ms per frame", known, KNOWN),
        "memory": ("known objects", "private MiB", memory, KNOWN),
        "visible": ("objects in view", "CPU ms per frame", visible, VISIBLE),
        "pixels": ("pixels, thousands", "CPU ms per frame", pixels, range(len(SIZES))),
        "triangles": ("triangles of each mesh, thousands", "CPU ms per frame", triangles, HALVINGS),
        "onboarding": ("triangles of the mesh, thousands", "CPU seconds, MiB", onboarding, HALVINGS),
        "readers": ("readers of poses", "sender's CPU ms per second", readers, READERS),
    }
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--only", nargs="+", choices=list(axes), default=list(axes))
    parser.add_argument("--quick", action="store_true", help="only the ends of each axis")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)  # as in the workers
    found: dict[str, Any] = {"origin": origin()}
    print("| | at | cost | exponent |\n|---|---|---|---|")
    for axis in arguments.only:
        x_label, y_label, measure, steps = axes[axis]
        curves = measure([steps[0], steps[-1]] if arguments.quick else steps)
        found[axis] = curves
        lines = {name: tuple(np.array(points).T) for name, points in curves.items()}
        write_picture(arguments.out / f"{axis}.png", line_plot(lines, "", x_label, y_label, marks=True))
        for name, points in curves.items():
            ends = " to ".join(f"{x:g}" for x, _ in (points[0], points[-1]))
            costs = " to ".join(f"{y:.2f}" for _, y in (points[0], points[-1]))
            print(f"| {axis}: {name} | {ends} | {costs} | {exponent(points):.2f} |", flush=True)
    (arguments.out / "growth.json").write_text(json.dumps(found, indent=1) + "\n")


def exponent(points: Sequence[tuple[float, float]]) -> float:
    """Slope of a line through the logarithms of the larger half of a curve.

    >>> exponent([(1, 5.0), (10, 20.0), (100, 200.0)])
    1.0
    """
    x, y = np.log(np.maximum(np.array(points[len(points) // 2 if len(points) > 2 else 0 :]), 1e-3)).T
    return round(float(np.polyfit(x, y, 1)[0]), 6)


def copies(count: int, models: Models | None = None) -> dict[str, ReferenceModel]:
    """`count` models: the demo's, repeated under other names."""
    models = models or load_models(builtin_bundles(0))
    names = list(islice(cycle(models), count))
    return {f"{name}_{k:03d}": replace(models[name], name=f"{name}_{k:03d}") for k, name in enumerate(names)}


def pose_of(k: int, i: int, count: int) -> Float64:
    """Pose (4, 4) of the centre of the k-th of `count` objects in frame i: in rows, centred in the image."""
    rows = -(-count // COLUMNS)
    column, row = k % COLUMNS, k // COLUMNS
    across = min(count, COLUMNS)
    position = np.array([column - (across - 1) / 2, row - (rows - 1) / 2, 0.0]) * SPACING_M
    R = se3.rotation_exp(np.array([0.4, 0.9 * k + 0.02 * i, 0.2]))
    return se3.make(R, position + np.array([0.002 * (i % 10), 0.0, AWAY_M]))


def picture(models: Models, count: int, i: int, camera: Camera = CAMERA) -> RgbdFrame:
    """Frame i with the first `count` models before a wall."""
    shown = list(models.values())[:count]
    rendered = render([(m.mesh, truth(m, k, i, count)) for k, m in enumerate(shown)], camera)
    behind = rendered.depth == 0
    rng = np.random.default_rng(7)
    wall = cv2.resize(rng.integers(110, 150, (60, 80, 3)).astype(np.uint8), (camera.width, camera.height))
    color = np.where(behind[..., None], wall, rendered.color)
    depth = np.where(behind, np.float32(WALL_M), rendered.depth)
    return RgbdFrame(color, depth, camera, i, i * PERIOD_NS)


def truth(model: ReferenceModel, k: int, i: int, count: int) -> Float64:
    """T_cam_obj (4, 4) of the k-th model."""
    return pose_of(k, i, count) @ se3.make(np.eye(3), -model.mesh.centre)


def tracked_ms(models: Models, count: int, camera: Camera = CAMERA) -> float:
    """CPU milliseconds of a step with the first `count` of the models tracked."""
    tracker = Tracker(models, profile("live").tracker)
    tracker.warm_up()
    first = picture(models, count, 0, camera)
    for k, (name, model) in enumerate(islice(models.items(), count)):
        tracker.correct(Correction.first(name, truth(model, k, 0, count), first, 1.0))
    frames = (picture(models, count, i, camera) for i in range(FRAMES))
    return median_ms([lambda f=f: tracker.step(f) for f in frames])


def estimated_ms(models: Models, count: int, camera: Camera = CAMERA) -> float:
    """CPU milliseconds of one estimate of the first `count` of the models in their boxes."""
    estimator = Estimator(models, profile("live").estimator)
    asked = []
    for i in range(0, 12):
        frame, queries = picture(models, count, i, camera), []
        for k, (name, model) in enumerate(islice(models.items(), count)):
            queries.append(ObjectQuery(name, projected_box(model, frame, truth(model, k, i, count))))
        asked.append(lambda f=frame, q=queries: estimator.estimate(f, q))
    return median_ms(asked)


def detected_ms(models: Models, asked: int, in_view: int, camera: Camera = CAMERA) -> float:
    """CPU milliseconds of one search for `asked` absent objects, while `in_view` others are in view."""
    detector = ViewDetector(models, profile("live").detector)
    absent = list(models)[-asked:]
    frames = [picture(models, in_view, i, camera) for i in range(8)]
    return median_ms([lambda f=f: detector.detect(f, absent) for f in frames])


def median_ms(works: Sequence[Callable[[], object]]) -> float:
    """Median CPU milliseconds, without the first few runs, which prepare."""
    spans = []
    for work in works:
        start = time.process_time()
        work()
        spans.append(1e3 * (time.process_time() - start))
    return float(np.median(spans[min(WARM, len(spans) // 3) :]))


def known(counts: Sequence[int]) -> Curves:
    """By the number of known objects, of which five, or all if there are fewer, are in view."""
    curves: Curves = {"track": [], "estimate": [], "detect two": []}
    for count in progress(counts, "known objects"):
        models, seen = copies(count), min(count, IN_VIEW)
        curves["track"].append((count, tracked_ms(models, seen) / seen * IN_VIEW))
        curves["estimate"].append((count, estimated_ms(models, seen) / seen * IN_VIEW))
        curves["detect two"].append((count, detected_ms(models, min(2, count), seen)))
    return curves


def visible(counts: Sequence[int]) -> Curves:
    """By the number of objects in view: tracked, estimated, and searched for while absent."""
    curves: Curves = {"track": [], "estimate": [], "detect absent": []}
    for count in progress(counts, "objects in view"):
        models = copies(count)
        curves["track"].append((count, tracked_ms(models, count)))
        curves["estimate"].append((count, estimated_ms(models, count)))
        curves["detect absent"].append((count, detected_ms(models, count, 0)))
    return curves


def pixels(which: Sequence[int]) -> Curves:
    """By the image size, with five objects in view."""
    curves: Curves = {"track": [], "estimate": [], "detect two": []}
    models = copies(IN_VIEW)
    for size in progress([SIZES[k] for k in which], "image sizes"):
        camera = CAMERA.scaled(size[0] / CAMERA.width)
        thousands = size[0] * size[1] / 1e3
        curves["track"].append((thousands, tracked_ms(models, IN_VIEW, camera)))
        curves["estimate"].append((thousands, estimated_ms(models, IN_VIEW, camera)))
        curves["detect two"].append((thousands, detected_ms(models, 2, 0, camera)))
    return curves


def triangles(halvings: Sequence[int]) -> Curves:
    """By the triangles of the meshes, with five objects of one mesh in view."""
    curves: Curves = {"track": [], "estimate": [], "detect two": []}
    for times in progress(halvings, "sizes of meshes"):
        mesh = halved(_some_mesh(), times)
        models = copies(IN_VIEW, {"object": onboard_mesh(mesh, "object")})
        thousands = len(mesh.faces) / 1e3
        curves["track"].append((thousands, tracked_ms(models, IN_VIEW)))
        curves["estimate"].append((thousands, estimated_ms(models, IN_VIEW)))
        curves["detect two"].append((thousands, detected_ms(models, 2, 0)))
    return curves


def onboarding(halvings: Sequence[int]) -> Curves:
    """By the triangles of a mesh: CPU seconds of onboarding, and MiB of the reference model's file."""
    curves: Curves = {"CPU seconds": [], "MiB": []}
    with tempfile.TemporaryDirectory() as folder:
        path = model_path(folder, "object")
        for times in progress(halvings, "sizes of meshes"):
            mesh = halved(_some_mesh(), times)
            start = time.process_time()
            model = onboard_mesh(mesh, "object")
            thousands = len(mesh.faces) / 1e3
            curves["CPU seconds"].append((thousands, time.process_time() - start))
            save_model(model, path)
            curves["MiB"].append((thousands, path.stat().st_size / 2**20))
    return curves


def halved(mesh: Mesh, times: int) -> Mesh:
    """The same surface with every edge halved `times` times."""
    for _ in range(times):
        corners = mesh.vertices[mesh.faces]
        points, faces = np.unique(_quarters(corners).reshape(-1, 3), axis=0, return_inverse=True)
        mesh = Mesh(points, faces.reshape(-1, 3).astype(np.int32), _quarters(mesh.uv), mesh.texture)
    return mesh


def _quarters(corners: Float32) -> Float32:
    """The four parts of each triangle (F, 3, D), with its edges halved: (4 F, 3, D)."""
    middle = (corners + np.roll(corners, -1, axis=1)) / 2
    tips = [np.stack([corners[:, i], middle[:, i], middle[:, i - 1]], axis=1) for i in range(3)]
    return np.concatenate([*tips, middle])


def _some_mesh() -> Mesh:
    return builtin_objects(0)["soup_can"]


def memory(counts: Sequence[int]) -> Curves:
    """Private memory of a worker by the number of known objects. Each worker is a new process, at its second
    start, when the cache of derived data exists; all files differ. Five of the objects are used, or all."""
    curves: Curves = {f"{worker}, {asked}": [] for asked in ("five seen", "all seen") for worker in WORKERS}
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder:
        for count in progress(counts, "memory"):
            for name, model in copies(count).items():
                if not model_path(folder, name).exists():
                    save_model(model, model_path(folder, name))
            for worker in WORKERS:
                in_fresh_process(context, own_mib, worker, folder, count)
                for seen, asked in (("five seen", min(count, IN_VIEW)), ("all seen", count)):
                    own = in_fresh_process(context, own_mib, worker, folder, asked)
                    curves[f"{worker}, {seen}"].append((count, own))
    return curves


def in_fresh_process(context: Any, work: Callable[..., float], *arguments: object) -> float:
    """The result of a function in a new process."""
    with context.Pool(1) as pool:
        return float(pool.apply(work, arguments))


def own_mib(worker: str, folder: str, asked: int) -> float:
    """Private MiB of a process with all models of a folder loaded, after the first `asked` of them were each
    in a frame."""
    os.environ["XDG_CACHE_HOME"] = folder
    models = load_models(folder)
    names = list(models)[:asked]
    shown = ((name, picture({name: models[name]}, 1, 0)) for name in names)
    held: Any
    if worker == "tracker":
        held = Tracker(models)
        held.warm_up()
        for name, frame in shown:
            held.correct(Correction.first(name, truth(models[name], 0, 0, 1), frame, 1.0))
            held.step(frame)
    elif worker == "estimator":
        held = Estimator(models)
        held.warm_up()
        for name, frame in shown:
            box = projected_box(models[name], frame, truth(models[name], 0, 0, 1))
            held.estimate(frame, [ObjectQuery(name, box)])
    else:
        held = ViewDetector(models)
        held.warm_up()
        for name, frame in shown:
            held.detect(frame, [name])
    pages = Path("/proc/self/smaps_rollup").read_text().splitlines()
    own = sum(int(line.split()[1]) for line in pages if line.startswith(("Private_Dirty", "Private_Clean")))
    return own / 1024 if held is not None else 0.0


if __name__ == "__main__":
    main()
