"""Training of the rotation network: endless samples, checkpoints, a validation curve, an ONNX file."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset

from huepose.drawing.plots import line_plot
from huepose.geometry.arrays import Float
from huepose.paper.canonical import FEATURES
from huepose.paper.rotation_network import POINTS, Kind
from huepose.training.network import AttentionDgcnn, geodesic
from huepose.training.runs import (
    Course,
    endless_loader,
    export_onnx,
    load_checkpoint,
    save_checkpoint,
    stream_number,
    timed_batches,
)
from huepose.training.turns import RotationSample, endless

VALIDATION_STREAM = 1_000_000
REACH = {"residual": 0.1, "direct": 1.0}


@dataclass(frozen=True)
class RotationTraining:
    """How to train. hours: of wall time, the learning rate falls to zero over them; steps: end after so many,
    for a trial; every: steps between two validations; workers: processes that make samples, 0: this one."""

    kind: Kind = "residual"
    hours: float = 1.0
    steps: int | None = None
    seed: int = 0
    batch: int = 64
    rate: float = 2e-3
    every: int = 200
    validation: int = 2000
    workers: int = 1
    device: str = "cpu"


class _Endless(IterableDataset[tuple[Tensor, Tensor, Tensor]]):
    """Batches of one process, shuffled within a window so that neighbours are not of one shape."""

    def __init__(self, config: RotationTraining, round_number: int) -> None:
        self.config, self.round = config, round_number

    def __iter__(self) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        stream = stream_number(self.round)
        cv2.setNumThreads(1)
        samples = endless(self.config.seed, stream, self.config.kind)
        rng = np.random.default_rng([self.config.seed, stream, 1])
        window = list(islice(samples, 8 * self.config.batch))
        while True:
            chosen = rng.choice(len(window), self.config.batch, replace=False)
            yield stack([window[k] for k in chosen])
            for k in chosen:
                window[k] = next(samples)


def stack(samples: list[RotationSample]) -> tuple[Tensor, Tensor, Tensor]:
    """Features (B, 128, 15), weights (B, 128) and answers (B, 3, 3) of samples."""
    return (
        torch.from_numpy(np.stack([s.features for s in samples])),
        torch.from_numpy(np.stack([s.weights for s in samples])),
        torch.from_numpy(np.stack([s.R_canon for s in samples])),
    )


def train(config: RotationTraining, out: Path, resume: bool = False) -> dict[str, Any]:
    """Train until `config.hours` are over, or until interrupted; leave `rotation.onnx`, `rotation.json`,
    `curve.png` and `checkpoint.pt` in `out`. Returns what rotation.json says.

    Raises InputError where `resume` finds no checkpoint, or one of another kind.
    """
    out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(config.seed)
    torch.set_num_threads(max(1, torch.get_num_threads() - config.workers))
    net = AttentionDgcnn(FEATURES, REACH[config.kind]).to(config.device)
    optimiser = torch.optim.AdamW(net.parameters(), config.rate, weight_decay=1e-4)
    parts = {"network": net, "optimiser": optimiser}
    course = load_checkpoint(out, config.kind, parts) if resume else Course()
    held_out = stack(list(islice(endless(config.seed, VALIDATION_STREAM, config.kind), config.validation)))
    unturned = torch.eye(3).expand(len(held_out[2]), 3, 3)
    without = np.degrees(geodesic(unturned, held_out[2]).numpy())
    loader = endless_loader(_Endless(config, course.rounds), config.workers)
    course.rounds += 1
    try:
        for batch in timed_batches(loader, "rotation network", course, optimiser, config):
            _step(net, optimiser, batch, config.device)
            course.steps += 1
            if course.steps % config.every == 0:
                _validated(net, held_out, config.device, course)
                save_checkpoint(out, config.kind, course, parts)
                _draw(out, course, without)
    except KeyboardInterrupt:
        pass
    errors = _validated(net, held_out, config.device, course)
    save_checkpoint(out, config.kind, course, parts)
    _draw(out, course, without)
    export(net, out / "rotation.onnx")
    report = {
        "training": asdict(config),
        "hours": round(course.hours, 3),
        "steps": course.steps,
        "machine": f"{platform.machine()}, {torch.get_num_threads()} threads, {config.device}",
        "torch": torch.__version__,
        "validation_deg": {"median": float(np.median(errors)), "mean": float(errors.mean())},
        "without_network_deg": {"median": float(np.median(without)), "mean": float(without.mean())},
    }
    (out / "rotation.json").write_text(json.dumps(report, indent=2) + "\n")
    return report


def _step(
    net: AttentionDgcnn, optimiser: torch.optim.Optimizer, batch: tuple[Tensor, Tensor, Tensor], device: str
) -> None:
    features, weights, answer = (part.to(device) for part in batch)
    net.train()
    loss = geodesic(net(features, weights), answer).mean()
    optimiser.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    optimiser.step()


def _validated(
    net: AttentionDgcnn, held_out: tuple[Tensor, Tensor, Tensor], device: str, course: Course
) -> Float:
    """Errors (N,) in degrees, noted on the curve."""
    errors = validate(net, held_out, device)
    course.curve.append([course.hours, course.steps, float(np.median(errors)), float(errors.mean())])
    return errors


def validate(net: AttentionDgcnn, samples: tuple[Tensor, Tensor, Tensor], device: str) -> Float:
    """Angles (N,) in degrees between answers and truth."""
    net.eval()
    features, weights, answer = samples
    with torch.no_grad():
        angles = [
            geodesic(net(f.to(device), w.to(device)).cpu(), a)
            for f, w, a in zip(features.split(256), weights.split(256), answer.split(256), strict=True)
        ]
    return np.degrees(torch.cat(angles).numpy())


def export(net: AttentionDgcnn, file: Path) -> None:
    """Write the network as ONNX, one set of matches at a time."""
    examples = {"features": torch.zeros(1, POINTS, FEATURES), "weights": torch.ones(1, POINTS)}
    export_onnx(net, file, examples, "rotation")


def _draw(out: Path, course: Course, without: Float) -> None:
    table = np.array(course.curve)
    steps = table[:, 1]
    picture = line_plot(
        {
            "network, median": (steps, table[:, 2]),
            "network, mean": (steps, table[:, 3]),
            "without, median": (steps, np.full(len(steps), np.median(without))),
            "without, mean": (steps, np.full(len(steps), without.mean())),
        },
        "Turns that the network was not trained on",
        "steps",
        "rotation error, degrees",
        y_range=(0.0, 1.2 * float(max(without.mean(), table[:, 3].min()))),
    )
    cv2.imwrite(str(out / "curve.png"), picture[..., ::-1])
