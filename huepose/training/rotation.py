"""Training of the rotation network: endless samples, checkpoints, a validation curve, an ONNX file.

Networks of several kinds can be trained together on the same motions. The newest samples are kept and reused:
rendering one costs more than a training step on it. Each use is augmented: rotated about the line of sight,
mirrored, or with the two frames exchanged. Each of these can occur in tracking, and its true output is known.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from huepose.drawing.plots import line_plot
from huepose.geometry.arrays import Float
from huepose.paper.canonical import FEATURES
from huepose.paper.rotation_network import POINTS, Kind
from huepose.support.files import write_picture
from huepose.training.network import AttentionDgcnn, geodesic
from huepose.training.runs import (
    VALIDATION_ROUND,
    Course,
    Settings,
    Training,
    check_device,
    checkpoint,
    endless_loader,
    export_onnx,
)
from huepose.training.turns import RotationSample, endless

CHUNK = 32
"""Samples that a process sends at a time."""

REACH = {"residual": 0.1, "direct": 1.0}
"""`reach` of each kind of network: see `AttentionDgcnn`."""

FIRST, SECOND, FIRST_UV, SECOND_UV = slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 10)
MOVED, MOVED_UV = slice(10, 13), slice(13, 15)
"""Columns of the features."""

Samples = tuple[Tensor, Tensor, Tensor]
"""Features (B, K, 128, 15), weights (B, 128) and true rotations (B, K, 3, 3) for K kinds of network."""


class Bank:
    """At most `room` samples on a device; new ones overwrite the oldest. drawn: number added so far."""

    def __init__(self, room: int, kinds: int, device: str) -> None:
        self.features = torch.empty(room, kinds, POINTS, FEATURES, dtype=torch.float16, device=device)
        self.weights = torch.empty(room, POINTS, dtype=torch.float16, device=device)
        self.answers = torch.empty(room, kinds, 3, 3, device=device)
        self.drawn = 0

    def add(self, samples: Samples) -> None:
        """Add samples."""
        room, count = len(self.weights), len(samples[1])
        at = (torch.arange(count, device=self.weights.device) + self.drawn) % room
        for kept, new in zip((self.features, self.weights, self.answers), samples, strict=True):
            kept[at] = new.to(kept)
        self.drawn += count

    def batch(self, count: int) -> Samples:
        """`count` random samples, with replacement, each augmented."""
        device = self.weights.device
        chosen = torch.randint(min(self.drawn, len(self.weights)), (count,), device=device)
        features, answers = varied(self.features[chosen].float(), self.answers[chosen])
        return features, self.weights[chosen].float(), answers


def varied(features: Tensor, answers: Tensor) -> tuple[Tensor, Tensor]:
    """Features (B, K, N, 15) and true rotations (B, K, 3, 3), each rotated about the line of sight by a
    random angle, and at random mirrored and with its two frames exchanged."""
    count, device = len(features), features.device
    angle = 2.0 * math.pi * torch.rand(count, device=device)
    side = 1.0 - 2.0 * torch.randint(2, (count,), device=device)
    c, s, zero, one = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle), torch.ones_like(angle)
    rows: Sequence[Tensor] = (side * c, -s, zero, side * s, c, zero, zero, zero, one)
    M = torch.stack(rows, 1).reshape(count, 1, 3, 3)
    back = (torch.rand(count, device=device) < 0.5)[:, None, None, None]
    features = torch.where(back, exchanged(features), features) @ _of_all_columns(M)
    answers = torch.where(back, answers.transpose(2, 3), answers)
    return features, M @ answers @ M.transpose(2, 3)


def exchanged(features: Tensor) -> Tensor:
    """The features (..., 15) of the inverse motion."""
    parts = (SECOND, FIRST, SECOND_UV, FIRST_UV)
    return torch.cat(
        [*(features[..., p] for p in parts), -features[..., MOVED], -features[..., MOVED_UV]], -1
    )


def _of_all_columns(M: Tensor) -> Tensor:
    """Matrices (B, 1, 15, 15) that multiply rows of features when M (B, 1, 3, 3) transforms canonical
    space."""
    out = M.new_zeros(len(M), 1, FEATURES, FEATURES)
    for part in (FIRST, SECOND, MOVED):
        out[:, :, part, part] = M.transpose(2, 3)
    for part in (FIRST_UV, SECOND_UV, MOVED_UV):
        out[:, :, part, part] = M[:, :, :2, :2].transpose(2, 3)
    return out


@dataclass(frozen=True)
class RotationTraining(Settings):
    """Settings of a training. reuse: largest mean number of uses of a sample; room: samples that are kept."""

    kinds: tuple[Kind, ...] = ("residual",)
    batch: int = 64
    reuse: int = 64
    room: int = 400_000


def chunks(kinds: tuple[Kind, ...], seed: int, stream: int) -> Iterator[Samples]:
    """Samples without end, in chunks."""
    samples = endless(seed, stream, kinds)
    while True:
        yield stack(list(islice(samples, CHUNK)))


def stack(samples: list[list[RotationSample]]) -> Samples:
    """Stack the samples of B motions, each of K kinds."""
    return (
        torch.from_numpy(np.array([[s.features for s in motion] for motion in samples])),
        torch.from_numpy(np.array([motion[0].weights for motion in samples])),
        torch.from_numpy(np.array([[s.R_canon for s in motion] for motion in samples])),
    )


def train(config: RotationTraining, out: Path, resume: bool = False) -> dict[Kind, dict[str, Any]]:
    """Train until `config.hours` are over, or until interrupted; write `KIND.onnx`, `KIND.json`, `KIND.png`
    (its curve) and `checkpoint.pt` into `out`. Returns the content of each KIND.json.

    Raises InputError if `resume` finds no checkpoint, or one of other kinds, if without it there is a
    checkpoint, and if torch cannot use the device.
    """
    check_device(config.device)
    kinds = "+".join(config.kinds)
    saved = checkpoint(out, kinds, resume)
    out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(config.seed)
    nets = [AttentionDgcnn(FEATURES, REACH[kind]).to(config.device) for kind in config.kinds]
    optimiser = torch.optim.AdamW(
        [p for net in nets for p in net.parameters()], config.rate, weight_decay=1e-4
    )
    by_kind = dict(zip(config.kinds, nets, strict=True))
    training = Training.begun(out, kinds, config, optimiser, by_kind, saved)
    draw = partial(chunks, config.kinds)
    held_out = _held_out(endless_loader(draw, config, VALIDATION_ROUND), config.validation)
    fresh = endless_loader(draw, config, training.course.rounds)
    training.run(
        _batches(fresh, config), partial(_step, nets, optimiser), partial(_validated, nets, held_out)
    )
    errors = _errors(nets, held_out)
    identity = torch.eye(3).expand(held_out[2].shape)
    without = np.degrees(geodesic(identity.flatten(0, 1), held_out[2].flatten(0, 1)).numpy())
    without = without.reshape(-1, len(nets))
    reports = {}
    for k, kind in enumerate(config.kinds):
        _draw(out / f"{kind}.png", training.course, k, without[:, k])
        export(nets[k], out / f"{kind}.onnx")
        reports[kind] = training.report(
            kind, validation_deg=_figures(errors[:, k]), without_network_deg=_figures(without[:, k])
        )
    return reports


def _figures(errors: Float) -> dict[str, float]:
    return {"median": float(np.median(errors)), "mean": float(errors.mean())}


def _held_out(drawn: Iterable[Samples], count: int) -> Samples:
    """`count` samples of objects that are not trained on."""
    parts = zip(*islice(drawn, -(-count // CHUNK)), strict=True)
    features, weights, answers = (torch.cat(part)[:count] for part in parts)
    return features, weights, answers


def _batches(fresh: Iterable[Samples], config: RotationTraining) -> Iterator[Samples]:
    """Batches for training, from all samples so far, as many as `reuse` allows."""
    bank, lent = Bank(config.room, len(config.kinds), config.device), 0
    for samples in fresh:
        bank.add(samples)
        while lent + config.batch <= config.reuse * bank.drawn:
            yield bank.batch(config.batch)
            lent += config.batch


def _step(nets: list[AttentionDgcnn], optimiser: torch.optim.Optimizer, batch: Samples) -> None:
    features, weights, answers = batch
    optimiser.zero_grad()
    for k, net in enumerate(nets):
        net.train()
        geodesic(net(features[:, k], weights), answers[:, k]).mean().backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    optimiser.step()


def _validated(nets: list[AttentionDgcnn], held_out: Samples, course: Course) -> None:
    """Append to the curve: hours, steps, then median and mean of each kind's errors in degrees."""
    errors = _errors(nets, held_out)
    figures = np.stack([np.median(errors, 0), errors.mean(0)], 1).ravel()
    course.curve.append([course.hours, course.steps, *figures.tolist()])


def _errors(nets: list[AttentionDgcnn], held_out: Samples) -> Float:
    """Errors (N, K) in degrees."""
    features, weights, answers = held_out
    kinds = [(net, (features[:, k], weights, answers[:, k])) for k, net in enumerate(nets)]
    return np.stack([validate(net, samples) for net, samples in kinds], 1)


def validate(net: AttentionDgcnn, samples: tuple[Tensor, Tensor, Tensor]) -> Float:
    """Errors (N,) in degrees. samples: features (N, 128, 15), weights (N, 128), true rotations (N, 3, 3)."""
    net.eval()
    device = next(net.parameters()).device
    features, weights, answer = samples
    with torch.no_grad():
        angles = [
            geodesic(net(f.to(device), w.to(device)).cpu(), a)
            for f, w, a in zip(features.split(256), weights.split(256), answer.split(256), strict=True)
        ]
    return np.degrees(torch.cat(angles).numpy())


def export(net: AttentionDgcnn, file: Path) -> None:
    """Write the network as ONNX, with batch size 1."""
    examples = {"features": torch.zeros(1, POINTS, FEATURES), "weights": torch.ones(1, POINTS)}
    export_onnx(net, file, examples, "rotation")


def _draw(file: Path, course: Course, kind: int, without: Float) -> None:
    table = np.array(course.curve)
    steps, median, mean = table[:, 1], table[:, 2 + 2 * kind], table[:, 3 + 2 * kind]
    picture = line_plot(
        {
            "network, median": (steps, median),
            "network, mean": (steps, mean),
            "without, median": (steps, np.full(len(steps), np.median(without))),
            "without, mean": (steps, np.full(len(steps), without.mean())),
        },
        f"{file.stem}: motions that it was not trained on",
        "steps",
        "rotation error, degrees",
        y_range=(0.0, 1.2 * float(max(without.mean(), mean.min()))),
    )
    write_picture(file, picture)
