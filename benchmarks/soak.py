"""Ten minutes of the built-in scene: rate and gaps of poses, their age, and whether memory grows.

python -m benchmarks.soak [--minutes 10] [--json FILE] [--memory PNG]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from huepose.drawing.plots import line_plot
from huepose.support.files import write_picture, write_text
from huepose_services.chaos.memory import Said, growth
from huepose_services.chaos.system import CHAIN, LivePipeline, SeenPose, gaps_s, too_old, wrong


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description="A long run on the built-in scene.")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--memory", type=Path, help="a plot of each worker's memory over time")
    arguments = parser.parse_args()
    with LivePipeline() as pipeline:
        if not pipeline.wait_until_steady(3, 240.0):
            sys.exit(f"the pipeline does not become steady:\n{pipeline.log()[-3000:]}")
        start, cpu = time.monotonic(), {w: _cpu_s(pid) for w, pid in pipeline.pids().items()}
        until = start + 60.0 * arguments.minutes
        while time.monotonic() < until:
            time.sleep(min(30.0, max(0.1, until - time.monotonic())))
            print(
                f"{time.monotonic() - start:5.0f} s  {len(pipeline.poses)} poses", file=sys.stderr, flush=True
            )
        end = time.monotonic()
        seconds = end - start
        spent = {w: 100.0 * (_cpu_s(pid) - cpu[w]) / seconds for w, pid in pipeline.pids().items()}
        lines = pipeline.log().splitlines()
        result = {
            "seconds": seconds,
            "poses": pose_figures([p for p in pipeline.poses if start <= p.at <= end], start, end),
            "frames_hz": sum(start <= at <= end for at in pipeline.truths) / seconds,
            "estimates_hz": sum(start <= at <= end for at in pipeline.estimates) / seconds,
            "workers": {w: _worker(pipeline, w, start, end, spent[w]) for w in CHAIN},
            "too_old_tracking": too_old(pipeline.poses, pipeline.max_age_ms),
            "unreadable": pipeline.reader.refused,
            "log_lines": len(lines),
            "restarts": sum("starting" in line and "again" in line for line in lines),
        }
        if arguments.memory is not None:
            draw(pipeline.health_log, start, arguments.memory)
    print(json.dumps(result, indent=2))
    if arguments.json is not None:
        write_text(arguments.json, json.dumps(result, indent=2) + "\n")


def draw(said: Said, start_s: float, path: Path) -> None:
    """A plot of each worker's memory over the minutes."""
    series = {}
    for worker in dict.fromkeys(m.worker for _, m in said):
        own = [(at, m) for at, m in said if m.worker == worker and at >= start_s]
        minutes = np.array([(at - start_s) / 60.0 for at, _ in own])
        series[worker] = (minutes, np.array([m.memory_mib for _, m in own]))
    write_picture(path, line_plot(series, "resident memory", "minutes", "MiB"))


def pose_figures(poses: list[SeenPose], start: float, end: float) -> dict[str, Any]:
    """Rate of frames with poses, the gaps between them, ages, and the number of wrong poses."""
    gaps = np.array(gaps_s(poses, start, end)) * 1000.0
    ages = np.array([p.age_ms for p in poses])
    tracking = [p for p in poses if p.state == "TRACKING"]
    return {
        "rate_hz": len({p.frame for p in poses}) / (end - start),
        "gap_ms_p50_p99_max": [float(v) for v in (*np.percentile(gaps, [50, 99]), gaps.max())],
        "gaps_over_100_ms": int((gaps > 100.0).sum()),
        "age_ms_p50_p99_max": [float(v) for v in (*np.percentile(ages, [50, 99]), ages.max())],
        "messages": len(poses),
        "tracking_share": len(tracking) / max(len(poses), 1),
        "wrong_tracking": wrong(poses),
        "tracking": len(tracking),
    }


def _worker(pipeline: LivePipeline, worker: str, start: float, end: float, cpu: float) -> dict[str, Any]:
    said = [(at, m) for at, m in pipeline.health_log if m.worker == worker and start <= at <= end]
    if not said:
        return {"cpu_percent": cpu, "last_error": "it sent no health message"}
    last, grown = said[-1][1], growth(said, start, end).get(worker)
    return {
        "cpu_percent": cpu,
        "memory": None if grown is None else asdict(grown),
        "locked_mib": last.locked_mib,
        "drops": last.drops - said[0][1].drops,
        "errors": last.errors,
        "last_error": last.last_error,
        "work_ms": last.work_ms,
    }


def _cpu_s(pid: int) -> float:
    """User and system time of a process, all threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


if __name__ == "__main__":
    main()
