"""The frame of a training: how far it has come, checkpoints, the course of the learning rate, the export."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from huepose.support.errors import InputError
from huepose.support.progress import progress

CHECKPOINT = "checkpoint.pt"

Batch = TypeVar("Batch")


@dataclass
class Course:
    """How far a training has come; `rounds` counts how often it was started, `curve` holds validations."""

    steps: int = 0
    hours: float = 0.0
    rounds: int = 0
    curve: list[list[float]] = field(default_factory=list)


class Limits(Protocol):
    """How long to train, in hours of wall time and in steps (None: without end), and how fast."""

    @property
    def hours(self) -> float:
        """Of wall time."""

    @property
    def steps(self) -> int | None:
        """End after so many."""

    @property
    def rate(self) -> float:
        """Learning rate at its highest."""


def rate_factor(share: float, step: int) -> float:
    """Factor of the learning rate: a short rise, then a cosine to zero at the end of the time."""
    return min(1.0, (step + 1) / 200.0) * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0)))


def timed_batches(
    batches: Iterable[Batch], what: str, course: Course, optimiser: torch.optim.Optimizer, limits: Limits
) -> Iterator[Batch]:
    """Batches until the hours or the steps of `limits` are over, under a progress bar named `what`. Before
    each one the course's hours and the optimiser's learning rate are brought up to date."""
    before_h, begun = course.hours, time.monotonic()
    for batch in progress((b for b in batches), what):
        course.hours = before_h + (time.monotonic() - begun) / 3600.0
        if course.hours >= limits.hours or course.steps == limits.steps:
            return
        for group in optimiser.param_groups:
            group["lr"] = limits.rate * rate_factor(course.hours / limits.hours, course.steps)
        yield batch


def endless_loader(batches: IterableDataset[Any], workers: int) -> DataLoader[Any]:
    """Batches from so many processes, or from this one. They are started afresh: a copy of this process would
    hold locks of threads that it has not copied."""
    context = "spawn" if workers else None
    return DataLoader(batches, batch_size=None, num_workers=workers, multiprocessing_context=context)


def stream_number(round_number: int) -> int:
    """Which stream of samples the process that asks has to draw in this round of a training. A worker that
    asks also leaves Ctrl-C to the process that trains."""
    worker = get_worker_info()
    if worker is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return 1 + round_number * 64 + (0 if worker is None else worker.id)


def save_checkpoint(out: Path, kind: str, course: Course, parts: Mapping[str, Any]) -> None:
    """Write a checkpoint, whole or not at all. parts: things with a `state_dict`, by name; kind: what is
    trained, in a word: a checkpoint of another kind does not fit."""
    unfinished = out / "checkpoint.tmp"
    states = {name: part.state_dict() for name, part in parts.items()}
    torch.save({"kind": kind, "course": asdict(course), **states}, unfinished)
    unfinished.replace(out / CHECKPOINT)


def load_checkpoint(out: Path, kind: str, parts: Mapping[str, Any]) -> Course:
    """Read one into its parts. Raises InputError where there is none, or one of another kind."""
    file = out / CHECKPOINT
    if not file.is_file():
        raise InputError(f"checkpoint {file}", found="no such file", fix="train without --resume first")
    saved = torch.load(file, weights_only=True)
    if saved["kind"] != kind:
        raise InputError(f"checkpoint {file}", found=f"kind {saved['kind']}", expected=kind)
    for name, part in parts.items():
        part.load_state_dict(saved[name])
    return Course(**saved["course"])


def export_onnx(
    network: nn.Module,
    file: Path,
    examples: Mapping[str, Tensor],
    output: str,
    *,
    any_count: bool = False,
) -> None:
    """Write a network as ONNX: its inputs by name, each with an example, and its one output, without what the
    exporter notes there about the source files and their folders. any_count: the first size is free."""
    import onnx

    torch.onnx.export(
        network.cpu().eval(),
        tuple(examples.values()),
        str(file),
        input_names=list(examples),
        output_names=[output],
        dynamic_shapes=tuple({0: torch.export.Dim.DYNAMIC} for _ in examples) if any_count else None,
        dynamo=True,
        external_data=False,
        verbose=False,
    )
    model = onnx.load(str(file))
    without_notes(model.graph)
    del model.metadata_props[:]
    onnx.save(model, str(file))


def without_notes(graph: Any) -> None:
    """Take the exporter's notes (an `onnx.GraphProto`'s metadata) away, in place."""
    parts = (graph.node, graph.value_info, graph.input, graph.output, graph.initializer)
    for part in (graph, *(entry for entries in parts for entry in entries)):
        del part.metadata_props[:]
        part.ClearField("doc_string")
