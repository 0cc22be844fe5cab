"""Which compiled kernels and networks take the time of a frame, and a bound of what a GPU would gain.

    OMP_NUM_THREADS=1 .venv/bin/python -m benchmarks.kernels [--json FILE]

Five objects of the built-in scene are tracked, estimated and searched for. For each kernel: calls, CPU
milliseconds and MiB of its arguments per frame (all arrays, at each call). For kernels that do the same work
for many poses, views, windows or pixels at once, there is an upper bound of the time on the GPU of a Jetson:
each call launches and waits; its arrays are read once from memory; and it has at most as many operations as a
core of this machine could do in its time.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.evaluation.benches import ESTIMATED, TRACKED, bench_estimate, bench_perception, bench_track
from huepose.evaluation.result_files import write_json
from huepose.evaluation.summary import table
from huepose.geometry.arrays import Float32
from huepose.model import load_models
from huepose.profiles import profile
from huepose.scenes.builtin import SyntheticScene
from huepose.support.jit import jit
from huepose_services.builtin import builtin_bundles

MANY = {
    "huepose.propose.close_look._check": "views",
    "huepose.propose.quick_look._score_windows": "views",
    "huepose.judge.terms._score_all": "poses",
    "huepose.refine.coordinate_search._search_all": "poses",
    "huepose.refine.point_to_plane.align_kernel": "poses",
    "huepose.perception.nearby._align": "poses",
    "huepose.colorpair.extract._joint_bilateral": "pixels",
    "huepose.rendering.shade.paint": "pixels",
    "huepose.rendering.raster.rasterise": "triangles",
    "huepose.perception.windows._fill": "windows",
    "network": "windows",
}
"""Kernels that do the same work for many items at once, and the items. The others follow one pose, or are
short."""

JETSONS = {"AGX Orin 64 GB": (5.3e12, 204.8e9), "Orin Nano 8 GB": (1.28e12, 68e9)}
"""Operations (32 bit) and bytes per second of GPU and memory: NVIDIA's data sheets."""

CALL_S = 30e-6
"""Time to launch a kernel and wait for its result. Assumed."""

USABLE_OPERATIONS, USABLE_BYTES = 0.2, 0.6
"""Shares of a GPU's peak that code with gathers and branches reaches. Assumed."""


@dataclass
class Use:
    """Sums over all calls of one kernel: CPU seconds and bytes of its arrays."""

    calls: int = 0
    cpu_s: float = 0.0
    handed_bytes: int = 0


def main() -> None:
    """Measure and print a Markdown table for each use."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)  # as in the workers
    models, scene, live = load_models(builtin_bundles(0)), SyntheticScene(0), profile("live")
    peak = operations_a_second()
    print(f"one core does at most {peak / 1e9:.0f} billion operations per second\n")
    detections = 12
    # The bench estimates each frame twice, and one more; in each frame it searches for all objects, for two,
    # and three times for an absent one.
    uses: dict[str, tuple[Callable[[], object], int]] = {
        "track": (lambda: bench_track(scene, models, live.tracker), TRACKED + 1),
        "estimate": (
            lambda: bench_estimate(scene, models, replace(live.estimator, threads=1)),
            2 * (ESTIMATED + 1) + 1,
        ),
        "detect": (lambda: bench_perception(scene, models, live.detector, detections), detections + 1),
    }
    found: dict[str, Any] = {}
    for name, (work, frames) in uses.items():
        work()  # compiles and prepares
        with watched() as kernels:
            start = time.process_time()
            work()
            whole_ms = 1e3 * (time.process_time() - start) / frames
        found[name] = rows(kernels, frames, peak)
        print(f"{name}: {whole_ms:.1f} CPU ms per frame, with the other work of the bench\n")
        names = ("kernel", "for many", "calls", "CPU ms", "MiB", *(f"{d}, ms" for d in JETSONS))
        print(table(names, [[str(x) for x in row.values()] for row in found[name]]))
        print()
    if arguments.json is not None:
        write_json(arguments.json, found)


def rows(kernels: dict[str, Use], frames: int, peak: float) -> list[dict[str, Any]]:
    """One row for each kernel that takes at least a hundredth of the total, the longest first; per frame."""
    total = sum(use.cpu_s for use in kernels.values())
    longest = sorted(kernels.items(), key=lambda item: -item[1].cpu_s)
    out = []
    for name, use in longest:
        if use.cpu_s < 0.01 * total:
            break
        row: dict[str, Any] = {
            "kernel": name.removeprefix("huepose."),
            "many": MANY.get(name, ""),
            "calls": round(use.calls / frames, 1),
            "cpu_ms": round(1e3 * use.cpu_s / frames, 2),
            "mib": round(use.handed_bytes / frames / 2**20, 1),
        }
        for device, (operations, bandwidth) in JETSONS.items():
            moved_s = on_gpu_s(use, peak, operations, bandwidth) / frames
            row[device] = round(1e3 * moved_s, 2) if name in MANY else ""
        out.append(row)
    return out


def on_gpu_s(use: Use, peak: float, operations: float, bandwidth: float) -> float:
    """Upper bound in seconds on a GPU with `operations` and `bandwidth` (bytes) per second, for work that
    took `use.cpu_s` on a core that does `peak` operations per second.

    >>> on_gpu_s(Use(calls=10, cpu_s=1.0, handed_bytes=6_000_000), 1e9, 1e12, 1e10)
    0.0063
    """
    computed = use.cpu_s * peak / (USABLE_OPERATIONS * operations)
    read = use.handed_bytes / (USABLE_BYTES * bandwidth)
    return round(use.calls * CALL_S + computed + read, 9)


def operations_a_second() -> float:
    """Peak of one core: 32-bit multiplications and additions per second, on vectors that stay in the nearest
    cache."""
    x = np.full(1024, 1.0001, np.float32)
    times = 20_000
    _multiply_and_add(x, 10)
    best = np.inf
    for _ in range(5):
        start = time.thread_time()
        _multiply_and_add(x, times)
        best = min(best, time.thread_time() - start)
    return 8.0 * len(x) * times / best


@jit
def _multiply_and_add(x: Float32, times: int) -> float:
    a, b = np.float32(0.999), np.float32(0.001)
    total = np.float32(0.0)
    for _ in range(times):
        for i in range(x.shape[0]):
            v = x[i]
            v = v * a + b
            v = v * a + b
            v = v * a + b
            x[i] = v * a + b
    for i in range(x.shape[0]):
        total += x[i]
    return total


@contextmanager
def watched() -> Iterator[dict[str, Use]]:
    """Count the calls of all compiled kernels from Python, and of networks, in this context. A kernel that
    another one calls counts as part of it."""
    import onnxruntime as ort
    from numba.core.dispatcher import Dispatcher

    uses: dict[str, Use] = {}
    before = []
    modules = [m for name, m in list(sys.modules.items()) if name.startswith("huepose.")]
    for module in modules:
        for name, kernel in list(vars(module).items()):
            if isinstance(kernel, Dispatcher):
                before.append((module, name, kernel))
                known = f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"
                setattr(module, name, _counted(kernel, uses.setdefault(known, Use())))
    before.append((ort.InferenceSession, "run", ort.InferenceSession.run))
    ort.InferenceSession.run = _counted(ort.InferenceSession.run, uses.setdefault("network", Use()))
    try:
        yield uses
    finally:
        for owner, name, kernel in before:
            setattr(owner, name, kernel)


def _counted(work: Callable[..., Any], use: Use) -> Callable[..., Any]:
    def call(*arguments: Any, **named: Any) -> Any:
        start = time.thread_time()
        result = work(*arguments, **named)
        use.cpu_s += time.thread_time() - start
        use.calls += 1
        use.handed_bytes += _bytes(arguments) + _bytes(tuple(named.values())) + _bytes(result)
        return result

    return call


def _bytes(value: Any) -> int:
    """Bytes of all arrays in a value."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    if isinstance(value, dict):
        return _bytes(tuple(value.values()))
    return sum(_bytes(v) for v in value) if isinstance(value, tuple | list) else 0


if __name__ == "__main__":
    main()
