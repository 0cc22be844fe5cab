"""Training of a detector from models alone: endless pictures, checkpoints, a curve, an ONNX file."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import IterableDataset

from huepose.drawing.plots import line_plot
from huepose.geometry import Mesh
from huepose.perception.yolo_layouts import Candidates, candidates
from huepose.support.errors import InputError
from huepose.training.detector_loss import detector_loss
from huepose.training.detector_network import Exported, SmallYolo
from huepose.training.detector_score import DetectorScore, score
from huepose.training.pictures import LabelledPicture, endless_pictures
from huepose.training.runs import (
    Course,
    endless_loader,
    export_onnx,
    load_checkpoint,
    save_checkpoint,
    stream_number,
    timed_batches,
)

VALIDATION_STREAM = 1_000_000
LEAST_SCORE = 0.02
AVERAGED = 0.998
Things = Mapping[str, Sequence[Mesh]]
Batch = tuple[Tensor, list[Tensor], list[Tensor]]


@dataclass(frozen=True)
class DetectorTraining:
    """How to train. input_size: height and width, multiples of 32; hours: of wall time, the learning rate
    falls to zero over them; steps: end after so many, for a trial; every: steps between two validations on
    `validation` pictures; workers: processes that make pictures, 0: this one."""

    input_size: tuple[int, int] = (256, 320)
    hours: float = 1.0
    steps: int | None = None
    seed: int = 0
    batch: int = 12
    rate: float = 2e-3
    every: int = 250
    validation: int = 200
    workers: int = 1
    device: str = "cpu"


class _Endless(IterableDataset[Batch]):
    """Batches of one process."""

    def __init__(self, things: Things, config: DetectorTraining, round_number: int) -> None:
        self.things, self.config, self.round = things, config, round_number

    def __iter__(self) -> Iterator[Batch]:
        stream = stream_number(self.round)
        cv2.setNumThreads(1)
        pictures = endless_pictures(self.things, self.config.input_size, self.config.seed, stream)
        while True:
            yield stack(list(islice(pictures, self.config.batch)))


def stack(pictures: Sequence[LabelledPicture]) -> Batch:
    """Images (B, 3, H, W) uint8, and by picture corners (K, 4) and classes (K,)."""
    images = np.stack([p.image for p in pictures]).transpose(0, 3, 1, 2)
    return (
        torch.from_numpy(np.ascontiguousarray(images)),
        [torch.from_numpy(p.corners) for p in pictures],
        [torch.from_numpy(p.classes) for p in pictures],
    )


def train(things: Things, config: DetectorTraining, out: Path, resume: bool = False) -> dict[str, Any]:
    """Train a detector of `things` (by class the meshes that mean it) until `config.hours` are over, or until
    interrupted; leave `detector.onnx`, `detector.json`, `curve.png` and `checkpoint.pt` in `out`. Returns
    what detector.json says.

    Raises InputError for nothing to find, an input of a size that does not fit the grids, or where `resume`
    finds no checkpoint of the same classes and size."""
    _check(things, config)
    out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(config.seed)
    torch.set_num_threads(max(1, torch.get_num_threads() - config.workers))
    network = SmallYolo(len(things), config.input_size).to(config.device, memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(network.parameters(), config.rate, weight_decay=1e-3)
    # What is validated and kept is a running mean: steadier than the last step.
    mean = AveragedModel(network, avg_fn=_averaged, use_buffers=True)
    kind = f"{', '.join(things)} at {config.input_size[1]}x{config.input_size[0]}"
    parts = {"network": network, "optimiser": optimiser, "mean": mean}
    course = load_checkpoint(out, kind, parts) if resume else Course()
    pictures = endless_pictures(things, config.input_size, config.seed, VALIDATION_STREAM)
    held_out = list(islice(pictures, config.validation))
    loader = endless_loader(_Endless(things, config, course.rounds), config.workers)
    course.rounds += 1
    try:
        for batch in timed_batches(loader, "detector", course, optimiser, config):
            _step(network, optimiser, batch, config.device)
            mean.update_parameters(network)
            course.steps += 1
            if course.steps % config.every == 0:
                _note(mean.module, held_out, len(things), config, course)
                save_checkpoint(out, kind, course, parts)
                _draw(out, course)
    except KeyboardInterrupt:
        pass
    final = _note(mean.module, held_out, len(things), config, course)
    save_checkpoint(out, kind, course, parts)
    _draw(out, course)
    export(mean.module, out / "detector.onnx", tuple(things), config.input_size)
    report = {
        "classes": list(things),
        "meshes": sum(len(meshes) for meshes in things.values()),
        "training": asdict(config),
        "hours": round(course.hours, 3),
        "steps": course.steps,
        "pictures": course.steps * config.batch,
        "parameters": sum(p.numel() for p in network.parameters()),
        "machine": f"{platform.machine()}, {torch.get_num_threads()} threads, {config.device}",
        "torch": torch.__version__,
        "validation": asdict(final),
    }
    (out / "detector.json").write_text(json.dumps(report, indent=2) + "\n")
    return report


def _averaged(mean: Tensor, now: Tensor, count: Tensor | int) -> Tensor:
    """A running mean that forgets its beginning: at first over all steps, later over the last few hundred."""
    return mean + (now - mean) * max(1.0 - AVERAGED, 9.0 / (10.0 + float(count)))


def _check(things: Things, config: DetectorTraining) -> None:
    if not things or not all(things.values()):
        raise InputError("detector", found="no object", expected="one mesh or more")
    if any(side % 32 or side < 64 for side in config.input_size):
        height, width = config.input_size
        raise InputError("--size", found=f"{width}x{height}", expected="sides that are multiples of 32")


def _step(network: SmallYolo, optimiser: torch.optim.Optimizer, batch: Batch, device: str) -> None:
    images, corners, classes = batch
    network.train()
    answered, logits = network((images.to(device).float() / 255.0).to(memory_format=torch.channels_last))
    true, labels = [c.to(device) for c in corners], [c.to(device) for c in classes]
    loss = detector_loss(answered, logits, network.centres, network.strides, true, labels)
    optimiser.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
    optimiser.step()


def found(
    network: SmallYolo, pictures: Sequence[LabelledPicture], input_size: tuple[int, int], device: str
) -> list[Candidates]:
    """What a network sees in pictures, by picture, before overlapping boxes are dropped."""
    network.eval()
    exported, out = Exported(network), []
    for first in range(0, len(pictures), 16):
        images, _, _ = stack(pictures[first : first + 16])
        with torch.no_grad():
            answers = exported(images.to(device).float() / 255.0).cpu().numpy()
        out += [candidates(answer[None], "v8", input_size, LEAST_SCORE) for answer in answers]
    return out


def _note(
    network: SmallYolo,
    held_out: Sequence[LabelledPicture],
    count: int,
    config: DetectorTraining,
    course: Course,
) -> DetectorScore:
    """The score, noted on the curve."""
    seen = found(network, held_out, config.input_size, config.device)
    got = score(seen, [p.corners for p in held_out], [p.classes for p in held_out], count)
    course.curve.append([course.hours, course.steps, got.precision, got.recall, got.false_boxes])
    return got


def _draw(out: Path, course: Course) -> None:
    table = np.array(course.curve)
    names = ("average precision at IoU 0.5", "recall at a confidence of 0.25")
    picture = line_plot(
        {name: (table[:, 1], table[:, 2 + k]) for k, name in enumerate(names)},
        "Pictures that the network was not trained on",
        "steps",
        "",
        y_range=(0.0, 1.0),
    )
    cv2.imwrite(str(out / "curve.png"), picture[..., ::-1])


def export(network: SmallYolo, file: Path, names: Sequence[str], input_size: tuple[int, int]) -> None:
    """Write the network as ONNX, one picture at a time, with the names of its classes."""
    whole = Exported(network)
    properties = {"names": str(dict(enumerate(names)))}
    export_onnx(whole, file, {"images": torch.zeros(1, 3, *input_size)}, "output0", properties)
