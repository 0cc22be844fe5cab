"""`huepose bench`: the time of each stage, on the built-in scene."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from huepose.support.files import write_picture
from huepose_services.cli.options import add_from_zero, add_json, add_path, add_profile, print_result
from huepose_services.runtime.threads import single_threaded

_WHAT = ("estimate", "track", "detect", "bus", "all")


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("bench", help="measure the time of every stage")
    parser.add_argument("what", nargs="?", choices=_WHAT, default="all", help="default: all")
    add_json(parser, to_file=True)
    add_path(parser, "--image", "FILE.png", "draw the time of the stages as bars")
    add_from_zero(parser, "--seed", "number of the built-in scene (0)")
    add_profile(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Measure the stages, print a table, write JSON and an image."""
    # As in the workers: waiting threads of the libraries spin, and would count as CPU time.
    single_threaded()
    import resource
    from dataclasses import asdict

    import cv2

    from huepose.evaluation.benches import StageTime, bench_estimate, bench_perception, bench_track
    from huepose.evaluation.summary import table
    from huepose.model import load_models
    from huepose.profiles import profile
    from huepose.scenes.builtin import SyntheticScene
    from huepose_services.builtin import builtin_bundles
    from huepose_services.bus_bench import bench_bus

    cv2.setNumThreads(1)
    stages: list[StageTime] = []
    summary: dict[str, float | str] = {"profile": arguments.profile}
    what, settings = arguments.what, profile(arguments.profile)
    if what != "bus":
        models = load_models(builtin_bundles(arguments.seed))
        scene = SyntheticScene(arguments.seed)
    if what in ("track", "all"):
        stages += bench_track(scene, models, settings.tracker)
        summary["track_five_objects_ms_p50"] = _p50(stages, "track")
    if what in ("estimate", "all"):
        stages += bench_estimate(scene, models, settings.estimator)
        summary["estimate_five_objects_ms_p50"] = _p50(stages, "estimate")
    if what in ("detect", "all"):
        stages += bench_perception(scene, models, settings.detector)
        for name in ("detect", "detect two", "detect missing", "detect still missing", "segment"):
            (stage,) = (s for s in stages if s.name == name)
            summary[f"{name.replace(' ', '_')}_cpu_ms_p50"] = stage.cpu_ms_p50
    if what in ("bus", "all"):
        stages += bench_bus()
        summary["bus_frame_ms_p50"] = _p50(stages, "bus/shared_memory")
        summary["bus_frame_tcp_ms_p50"] = _p50(stages, "bus/tcp")
    summary["peak_memory_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    columns = ("wall_ms_p50", "wall_ms_p95", "wall_ms_p99", "cpu_ms_p50", "cpu_ms_p99")
    rows = [
        [
            s.name,
            *(f"{getattr(s, column):.2f}" for column in columns),
            "" if s.first_wall_ms is None else f"{s.first_wall_ms:.0f}",
            "" if s.allocated_mib is None else f"{s.allocated_mib:.1f}",
        ]
        for s in stages
    ]
    text = table(("stage, ms", "wall p50", "p95", "p99", "CPU p50", "p99", "first", "MiB"), rows)
    text += f"\npeak memory {summary['peak_memory_mib']:.0f} MiB"
    print_result(arguments, {"summary": summary, "stages": [asdict(s) for s in stages]}, text)
    if arguments.image is not None:
        draw_stages(arguments.image, [(s.name, s.cpu_ms_p50, s.cpu_ms_p99) for s in stages])
    return 0


def draw_stages(path: Path, stages: list[tuple[str, float, float]]) -> None:
    """Draw stages (name, median and 99th percentile in CPU ms) as bars: one row for each task that has
    several stages. No image is written if no task has."""
    import numpy as np

    from huepose.drawing.plots import bar_chart

    rows = []
    for whole in dict.fromkeys(name.split("/")[0].split()[0] for name, _, _ in stages):
        own = [s for s in stages if s[0].split("/")[0].split()[0] == whole]
        names = [name.split("/", 1)[-1].removeprefix(f"{whole} ") for name, _, _ in own]
        times = {"median": [p50 for _, p50, _ in own], "99th percentile": [p99 for _, _, p99 in own]}
        if len(own) > 1:
            rows.append(bar_chart(names, times, whole, "CPU ms a frame", size=(1300, 320)))
    if rows:
        write_picture(path, np.concatenate(rows))


def _p50(stages: list[Any], name: str) -> float:
    return float(next(s.wall_ms_p50 for s in stages if s.name == name))
