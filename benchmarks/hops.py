"""The hop from camera to tracker: shared memory and TCP as HuePose has them, beside dora-rs, in one run.

    .venv/bin/python benchmarks/hops.py [--rounds 5] [--seconds 6] [--json FILE]

One frame of 640x480 colour and depth (1.5 MB) at 30 Hz, latest wins. The time is from before the sender's
copy until the receiver holds arrays: for zenoh a copy of its own, as every worker makes one; for dora-rs
pixels that are read in place, and beside it such a copy. The ways take turns in every round, so that all
meet the same machine; the percentiles are over the frames of all rounds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from huepose.support.errors import InputError
from huepose_services.bus_bench import FRAME_BYTES, RATE_HZ, WARM_UP, hop_spans

_NODES = Path(__file__).with_name("dora_nodes.py").resolve()


def main() -> None:
    """Measure, print a Markdown table, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5, metavar="N")
    parser.add_argument("--seconds", type=float, default=6.0, metavar="S", help="of each way in a round (6)")
    parser.add_argument("--dora", type=Path, default=Path("build/dora"), metavar="DIR",
                        help="environment made by `make_env.sh dora`")  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    try:
        rounds = [measure(arguments.dora.resolve(), arguments.seconds) for _ in range(arguments.rounds)]
    except InputError as error:
        sys.exit(str(error))
    rows = [summary(way, [r[way] for r in rounds]) for way in rounds[0]]
    print(f"load {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores\n")
    print("| way | p50 ms | p99 ms | p50 of the rounds | frames |\n|---|---|---|---|---|")
    for row in rows:
        low, high = row["p50_ms_of_rounds"]
        print(
            f"| {row['way']} | {row['p50_ms']:.2f} | {row['p99_ms']:.1f} | {low:.2f} to {high:.2f} "
            f"| {row['frames']} |"
        )
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")


def measure(dora: Path, seconds: float) -> dict[str, list[float]]:
    """Seconds of every frame, by way: one round."""
    in_place, copied = dora_spans(dora, seconds)
    return {
        "zenoh, shared memory": [wall for wall, _ in hop_spans(True, seconds)],
        "zenoh, TCP": [wall for wall, _ in hop_spans(False, seconds)],
        "dora-rs, read in place": in_place,
        "dora-rs, copied out": copied,
    }


def dora_spans(environment: Path, seconds: float) -> tuple[list[float], list[float]]:
    """The same hop as a dataflow of two nodes. Raises InputError when dora cannot run it."""
    python, dora = environment / "bin/python", environment / "bin/dora"
    if not dora.exists():
        raise InputError(
            environment,
            found="no dora-rs",
            expected="its environment",
            fix="Run benchmarks/make_env.sh dora.",
        )
    with tempfile.TemporaryDirectory() as folder:
        result, flow = Path(folder, "spans.json"), Path(folder, "flow.yml")
        frames = int(seconds * RATE_HZ)
        nodes = [
            {
                "id": "sender",
                "path": str(python),
                "args": f"{_NODES} send {frames} {FRAME_BYTES} {RATE_HZ}",
                "outputs": ["frame"],
            },
            {
                "id": "receiver",
                "path": str(python),
                "args": f"{_NODES} receive {result}",
                "inputs": {"frame": {"source": "sender/frame", "queue_size": 1}},
            },
        ]
        flow.write_text(json.dumps({"nodes": nodes}))  # JSON is YAML
        ran = subprocess.run(
            [dora, "run", flow],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=60.0 + seconds,
            check=False,
        )
        if ran.returncode != 0 or not result.exists():
            raise InputError(
                "dora run", found=f"exit code {ran.returncode}: {ran.stderr[-500:]}", expected="exit code 0"
            )
        spans = np.array(json.loads(result.read_text())[WARM_UP:], np.float64).reshape(-1, 2) * 1e-9
    return spans[:, 0].tolist(), spans[:, 1].tolist()


def summary(way: str, rounds: list[list[float]]) -> dict[str, object]:
    """Percentiles over all frames, and the lowest and highest median of a round."""
    spans = 1000.0 * np.concatenate([np.array(r) for r in rounds])
    medians = [1000.0 * float(np.median(r)) for r in rounds]
    p50, p95, p99 = (float(p) for p in np.percentile(spans, [50, 95, 99]))
    return {
        "way": way,
        "p50_ms": p50,
        "p95_ms": p95,
        "p99_ms": p99,
        "p50_ms_of_rounds": [min(medians), max(medians)],
        "frames": len(spans),
    }


if __name__ == "__main__":
    main()
