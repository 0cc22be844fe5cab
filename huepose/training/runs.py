"""What all trainings share: samples, learning rate, validations, checkpoints, reports, ONNX export."""

from __future__ import annotations

import json
import math
import platform
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from textwrap import shorten
from typing import Any, TypeVar

import cv2
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from huepose.support.errors import InputError
from huepose.support.files import whole, write_text
from huepose.support.progress import progress

CHECKPOINT = "checkpoint.pt"

VALIDATION_ROUND = 10_000
"""Round number of validation samples: no training uses the same streams."""

Batch = TypeVar("Batch")
Sample = TypeVar("Sample")


@dataclass
class Course:
    """Progress of a training. rounds: number of starts; curve: the validations."""

    steps: int = 0
    hours: float = 0.0
    rounds: int = 0
    curve: list[list[float]] = field(default_factory=list)


@dataclass(frozen=True)
class Settings:
    """Settings of a training. hours: wall time, over which the learning rate falls from `rate` to zero;
    steps: largest number, for a trial; every: steps between two validations; validation: held-out samples;
    workers: processes that render, 0: this one."""

    hours: float = 1.0
    steps: int | None = None
    seed: int = 0
    rate: float = 2e-3
    every: int = 500
    validation: int = 2000
    workers: int = 1
    device: str = "cpu"


def rate_factor(share: float, step: int) -> float:
    """Factor of the learning rate: a short linear rise, then a cosine to zero. share: of the time."""
    return min(1.0, (step + 1) / 200.0) * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0)))


@dataclass(frozen=True)
class Training:
    """One training. kind: a word for what is trained; optimiser and nets: contents of a checkpoint."""

    out: Path
    kind: str
    settings: Settings
    optimiser: torch.optim.Optimizer
    nets: Mapping[str, nn.Module]
    course: Course

    @staticmethod
    def begun(
        out: Path,
        kind: str,
        settings: Settings,
        optimiser: torch.optim.Optimizer,
        nets: Mapping[str, nn.Module],
        saved: Mapping[str, Any] | None,
    ) -> Training:
        """A new training, or one resumed from `saved`, which `checkpoint` read. Raises InputError if that is
        of other networks."""
        parts = {"optimiser": optimiser, **nets}
        course = Course() if saved is None else restored(saved, out, parts)
        return Training(out, kind, settings, optimiser, nets, course)

    def run(
        self, batches: Iterable[Batch], step: Callable[[Batch], None], validate: Callable[[Course], None]
    ) -> None:
        """Train on batches until the time is over, or until interrupted. validate: appends a validation to
        the course's curve; called every `every` steps and at the end. Raises InputError, and writes nothing,
        if the training ends before its first step."""
        course, settings = self.course, self.settings
        course.rounds += 1
        before_h, begun = course.hours, time.monotonic()
        try:
            for batch in progress((b for b in batches), f"training {self.kind}"):
                course.hours = before_h + (time.monotonic() - begun) / 3600.0
                if course.hours >= settings.hours or course.steps == settings.steps:
                    break
                for group in self.optimiser.param_groups:
                    group["lr"] = settings.rate * rate_factor(course.hours / settings.hours, course.steps)
                step(batch)
                course.steps += 1
                if course.steps % settings.every == 0:
                    self._note(validate)
        except KeyboardInterrupt:
            pass
        if course.steps == 0:
            raise InputError(
                f"training {self.kind}",
                found="its end before its first step",
                expected="a step at least",
                fix=f"Nothing was written to {self.out}. Give it more --hours.",
            )
        self._note(validate)

    def _note(self, validate: Callable[[Course], None]) -> None:
        validate(self.course)
        save_checkpoint(self.out, self.kind, self.course, {"optimiser": self.optimiser, **self.nets})

    def report(self, name: str, **figures: Any) -> dict[str, Any]:
        """The result of the training, also written as NAME.json."""
        settings = self.settings
        record = {
            "training": asdict(settings),
            "hours": round(self.course.hours, 3),
            "steps": self.course.steps,
            "machine": f"{platform.machine()}, {settings.workers} processes that render, {settings.device}",
            "torch": torch.__version__,
            **figures,
        }
        write_text(self.out / f"{name}.json", json.dumps(record, indent=2) + "\n")
        return record


class _Endless(IterableDataset[Sample]):
    """The samples of one process."""

    def __init__(self, draw: Callable[[int, int], Iterator[Sample]], seed: int, round_number: int) -> None:
        self.draw, self.seed, self.round = draw, seed, round_number

    def __iter__(self) -> Iterator[Sample]:
        cv2.setNumThreads(1)
        torch.set_num_threads(1)
        yield from self.draw(self.seed, _stream_number(self.round))


def endless_loader(
    draw: Callable[[int, int], Iterator[Sample]], settings: Settings, round_number: int
) -> DataLoader[Sample]:
    """Samples without end in this round of a training, from `settings.workers` processes, or from this one.
    Processes are spawned, not forked: a fork would copy locks but not the threads that hold them.

    draw: (seed, stream) to samples, deterministic; must be picklable."""
    return DataLoader(
        _Endless(draw, settings.seed, round_number),
        batch_size=None,
        num_workers=settings.workers,
        multiprocessing_context="spawn" if settings.workers else None,
    )


def _stream_number(round_number: int) -> int:
    """The stream of samples of the calling process in this round of a training. In a worker process it also
    ignores Ctrl-C, which the training process handles."""
    worker = get_worker_info()
    if worker is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return 1 + round_number * 64 + (0 if worker is None else worker.id)


def save_checkpoint(out: Path, kind: str, course: Course, parts: Mapping[str, Any]) -> None:
    """Write a checkpoint atomically. parts: objects with a `state_dict`, by name; kind: a word for what is
    trained: a checkpoint of another kind does not fit."""
    states = {name: part.state_dict() for name, part in parts.items()}
    with whole(out / CHECKPOINT) as file:
        torch.save({"kind": kind, "course": asdict(course), **states}, file)


def checkpoint(out: Path, kind: str, resume: bool) -> dict[str, Any] | None:
    """The checkpoint from which a training of this kind resumes, loaded to the CPU; None for a new training.
    Raises InputError if `resume` finds no such checkpoint or cannot read it, and if a new training would
    replace one."""
    file = out / CHECKPOINT
    if not resume:
        if file.exists():
            raise InputError(
                f"checkpoint {file}",
                found="one of an earlier training",
                expected="none for a new training",
                fix="Go on from it with --resume, name another folder with --out, or delete it.",
            )
        return None
    if not file.is_file():
        raise InputError(f"checkpoint {file}", found="no such file", fix="Train without --resume first.")
    try:
        saved: dict[str, Any] = torch.load(file, map_location="cpu", weights_only=True)
        found = saved["kind"]
    except Exception as error:  # any error of its parsers
        why = error.strerror if isinstance(error, OSError) else None
        raise _unfit(file, why or "a damaged file") from error
    if found != kind:
        raise InputError(f"checkpoint {file}", found=f"kind {found}", expected=kind)
    return saved


def restored(saved: Mapping[str, Any], out: Path, parts: Mapping[str, Any]) -> Course:
    """Load a checkpoint's states into the parts of the same names, on any device. Raises InputError if they
    do not fit."""
    try:
        for name, part in parts.items():
            part.load_state_dict(saved[name])
        return Course(**saved["course"])
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise _unfit(out / CHECKPOINT, "networks of another shape") from error


def _unfit(file: Path, found: str) -> InputError:
    return InputError(
        f"checkpoint {file}",
        found=found,
        expected="a complete one, written by this version",
        fix="Copy it again, or delete it and train without --resume.",
    )


def check_device(name: str) -> None:
    """Raises InputError if torch cannot compute on this device: checked before the work."""
    try:
        torch.zeros(1, device=name).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as error:  # depends on the build of torch
        reason = shorten(str(error).partition(". ")[0], 80, placeholder=" ...")
        raise InputError(
            f"device {name}",
            found=f"none that torch can use here ({reason})",
            expected="cpu, or cuda if there is a GPU with its driver",
            fix="Leave --device out to train on the CPU.",
        ) from error


def export_onnx(
    network: nn.Module, file: Path, examples: Mapping[str, Tensor], output: str, *, any_count: bool = False
) -> None:
    """Write a network as ONNX, without the exporter's notes about source files and their folders. examples:
    its inputs by name; output: name of its one output; any_count: the batch size is free."""
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
    """Remove the exporter's notes (metadata of an `onnx.GraphProto`), in place."""
    parts = (graph.node, graph.value_info, graph.input, graph.output, graph.initializer)
    for part in (graph, *(entry for entries in parts for entry in entries)):
        del part.metadata_props[:]
        part.ClearField("doc_string")
