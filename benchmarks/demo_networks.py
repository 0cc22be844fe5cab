"""The demo with each choice of detector and segmenter, one after the other.

    .venv/bin/python -m benchmarks.demo_networks [--seconds 15] [--seed 0] --json FILE

`yolo` is the network in the package. `sam` is a pair of small networks with the interface of NanoSAM whose
answer is the box that it is prompted with: so what is shown is that everything around them is right, and what
the estimator makes of outlines that hold no more than the box.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

from huepose.evaluation.result_files import write_json
from huepose.evaluation.summary import table
from huepose_services.demo.run import Perception, run_demo
from tests.perception import networks

COLUMNS = (
    "recall_add",
    "coverage_tracking",
    "false_tracking_frames",
    "acquired_after_s",
    "confirmed_after_s",
)


def main() -> None:
    """Run, write, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=float, default=15.0, metavar="S")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sam = _sam(Path(folder))
        choices = (Perception(), Perception("yolo"), Perception("yolo", "sam", sam))
        results = {
            f"{choice.detector} / {choice.segmenter}": run_demo(
                arguments.seconds, arguments.seed, False, lambda: False, choice
            )
            for choice in choices
        }
    write_json(arguments.json, results)
    rows = [[name, *_row(result)] for name, result in results.items()]
    head = ["detector / segmenter", "ADD recall", "TRACKING", "false", "acquired s", "confirmed s"]
    print(table([*head, "detector ms", "segmenter ms"], rows))


def _sam(folder: Path) -> list[str]:
    return [
        str(networks.sam_encoder(folder / "encoder.onnx")),
        str(networks.sam_decoder(folder / "decoder.onnx")),
    ]


def _row(result: dict[str, Any]) -> list[str]:
    figures = [_shown(result["summary"][key]) for key in COLUMNS]
    work = (result["workers"].get(name, {}).get("work_ms") for name in ("detector", "segmenter"))
    return figures + [_shown(times and times[0]) for times in work]


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


if __name__ == "__main__":
    main()
