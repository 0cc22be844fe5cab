"""Trains the networks of view codes and of verification on rendered objects and writes them as ONNX.

Processes render new objects (`training.windows`) while the networks are trained on a buffer of the newest
ones. Each step takes random windows and views of some of them, moves and recolours them, and minimises
`info_nce` of their codes (`propose.view_codes`). The network of `perception.verification` learns to
distinguish those windows and views whose codes are similar.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from huepose.drawing.plots import line_plot
from huepose.geometry import icosphere
from huepose.propose.templates import view_rotations
from huepose.propose.view_images import LEVEL as VIEW_LEVEL
from huepose.propose.view_images import ROLLS
from huepose.support.files import write_picture
from huepose.training.byte_input import read_bytes
from huepose.training.network import (
    LARGEST_SHARPNESS,
    VerificationNetwork,
    ViewCodeNetwork,
    info_nce,
    view_codes,
    window_codes,
)
from huepose.training.object_buffer import ObjectBuffer
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
from huepose.training.sensing import network_input, scanned, sensed
from huepose.training.verification import Shown, pairs, verification_loss
from huepose.training.windows import WINDOWS, endless

SHIFT, LARGEST_SHIFT = 0.06, 0.13
"""Offset of a window from the object's middle, in diameters: standard deviation and largest. The detector's
windows are a quarter of a diameter apart."""

STRETCH, DEEPER, DEEPEST = 0.06, 0.1, 0.25
"""Standard deviations of a window's logarithmic size and of its depth offset (diameters), and the largest
depth offset."""

BESIDE = (0.3, 0.52)
"""Offset, in diameters, of windows that count as beside the object (negatives)."""

SPREAD_DEG, REACH_DEG = 18.0, 38.0
"""The target distribution over views falls with the rotation to the true one as a Gaussian of this deviation,
and ends at REACH_DEG."""

CALIBRATED = 3
"""Batches on which activations are calibrated before a network is quantised."""

RIGHT_DEG = 25.0
"""In validation, a view is right if its rotation error is less than this."""

NAME, VERIFICATION = "views", "verification"
"""File names of the two networks."""

FIGURES = ("first_right", "one_of_five_right", "median_rank", "pairs_right")
"""On held-out windows, among all views of the object: share of windows whose most similar view is right,
share with a right view among the five most similar, median rank of the first right view; and the share of
pairs that verification classifies right."""


@dataclass(frozen=True)
class ViewCodeTraining(Settings):
    """Settings of a training. validation: held-out objects. A step takes `objects`, and of each `windows`
    that show it, windows `beside` it (negatives) and `views`. room: objects in the buffer, after which the
    oldest is replaced; first: objects rendered before the first step; reuse: largest number of steps per
    rendered object."""

    every: int = 1000
    validation: int = 48
    objects: int = 24
    windows: int = 6
    beside: int = 3
    views: int = 40
    room: int = 6000
    first: int = 200
    reuse: float = 8.0


class Networks(nn.Module):
    """The two networks, which are trained together."""

    def __init__(self, coding: ViewCodeNetwork, verifying: VerificationNetwork) -> None:
        super().__init__()
        self.coding, self.verifying = coding, verifying


@dataclass(frozen=True, eq=False)
class Batch:
    """Network inputs: `windows` (Q, 6, 64, 64) and `views` (T, 6, 64, 64). known (T, 64, 64): pixels of the
    views that show the object; angles_deg (Q, T), targets (Q, T) and valid (T,): for `info_nce`; shown: the
    contents of windows and views."""

    windows: Tensor
    views: Tensor
    known: Tensor
    angles_deg: Tensor
    targets: Tensor
    valid: Tensor
    shown: Shown


def train(config: ViewCodeTraining, out: Path, resume: bool = False) -> dict[str, Any]:
    """Train until `config.hours` are over, or until interrupted; write `views.onnx`, `verification.onnx`,
    `views.json`, `views.png` (the curve) and `checkpoint.pt` into `out`. Returns the content of views.json.

    Raises InputError, before anything is rendered, if `resume` finds no checkpoint, or one of another kind,
    if without it there is a checkpoint, and if torch cannot use the device."""
    check_device(config.device)
    saved = checkpoint(out, NAME, resume)
    out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(config.seed)
    held_out = ObjectBuffer(config.validation, config.device)
    for one in endless_loader(endless, config, VALIDATION_ROUND):
        held_out.add(one)
        if held_out.added == config.validation:
            break
    nets = Networks(ViewCodeNetwork().to(config.device), VerificationNetwork().to(config.device))
    optimiser = torch.optim.AdamW(nets.parameters(), config.rate, weight_decay=1e-2)
    by_name = {NAME: nets.coding, VERIFICATION: nets.verifying}
    training = Training.begun(out, NAME, config, optimiser, by_name, saved)
    fresh = endless_loader(endless, config, training.course.rounds)
    training.run(
        _buffers(fresh, config),
        lambda buffer: _step(nets, optimiser, buffer, config),
        partial(_validated, nets, held_out, config),
    )
    _draw(out / f"{NAME}.png", training.course)
    export(nets, held_out, config, out)
    figures = dict(zip(FIGURES, training.course.curve[-1][2:], strict=True))
    return training.report(NAME, validation=figures)


def _buffers(fresh: DataLoader[Any], config: ViewCodeTraining) -> Iterator[ObjectBuffer]:
    """The buffer, once for each step, with the objects that were rendered meanwhile."""
    buffer, steps = ObjectBuffer(config.room, config.device), 0
    for one in fresh:
        buffer.add(one)
        while buffer.added >= config.first and steps < config.reuse * buffer.added:
            yield buffer
            steps += 1


class _LogOdds(nn.Module):
    """The verification network without its output for the cells."""

    def __init__(self, verifying: VerificationNetwork) -> None:
        super().__init__()
        self.verifying = verifying

    def forward(self, pair: Tensor) -> Tensor:
        """pair (N, 12, 64, 64) -> (N,)."""
        return self.verifying(pair)[0]


def _step(
    nets: Networks, optimiser: torch.optim.Optimizer, buffer: ObjectBuffer, config: ViewCodeTraining
) -> None:
    nets.train()
    with torch.no_grad():
        drawn = batch(buffer, config)
    of_codes, similarity = _code_loss(nets.coding, drawn)
    with torch.no_grad():
        inputs, there, cells = pairs(buffer, drawn.shown, similarity.detach())
    with _half(inputs):
        of_pairs, _ = verification_loss(nets.verifying, inputs, there, cells)
    optimiser.zero_grad()
    (of_codes + of_pairs).backward()
    for net in (nets.coding, nets.verifying):
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    optimiser.step()


def _half(inputs: Tensor) -> torch.autocast:
    """Half precision if the inputs are on an accelerator."""
    device = inputs.device.type
    return torch.autocast(device, dtype=torch.bfloat16, enabled=device != "cpu")


def _code_loss(net: ViewCodeNetwork, drawn: Batch) -> tuple[Tensor, Tensor]:
    """The loss, a scalar, and the cosines (Q, T) of windows and views."""
    with _half(drawn.windows):
        codes = net(torch.cat([drawn.windows, drawn.views])).float()
    count = len(drawn.windows)
    similarity = window_codes(codes[:count]) @ view_codes(codes[count:], drawn.known).T
    sharpness = net.log_sharpness.exp().clamp(max=LARGEST_SHARPNESS)
    return info_nce(sharpness * similarity, drawn.angles_deg, drawn.targets, drawn.valid), similarity


def batch(buffer: ObjectBuffer, config: ViewCodeTraining) -> Batch:
    """A random batch from the buffer."""
    device = buffer.rotations.device
    count, each = config.objects, config.windows
    objects = torch.randint(len(buffer), (count,), device=device)
    numbers = torch.rand(count, WINDOWS, device=device).argsort(1)[:, :each]
    apart = _angles(buffer.rotations[objects[:, None], numbers])
    nearest = apart.topk(2, dim=2, largest=False).indices
    others = torch.randint(apart.shape[2], (count, config.views - 2 * each), device=device)
    chosen = torch.cat([nearest.flatten(1), others], 1)
    rgb, relief = buffer.views_of(objects.repeat_interleave(config.views), chosen.flatten())
    rgb = scanned(rgb)

    q, beside = count * each, count * config.beside
    shift = (SHIFT * torch.randn(q, 2, device=device)).clamp(-LARGEST_SHIFT, LARGEST_SHIFT)
    way = 2.0 * math.pi * torch.rand(beside, device=device)
    off = BESIDE[0] + (BESIDE[1] - BESIDE[0]) * torch.rand(beside, device=device)
    shift = torch.cat([shift, off[:, None] * torch.stack([torch.cos(way), torch.sin(way)], 1)])
    which = torch.cat([numbers.flatten(), torch.randint(WINDOWS, (beside,), device=device)])
    whose = torch.cat([objects.repeat_interleave(each), objects.repeat_interleave(config.beside)])
    stretch = torch.exp(STRETCH * torch.randn(len(whose), device=device))
    deeper = (DEEPER * torch.randn(len(whose), device=device)).clamp(-DEEPEST, DEEPEST)

    own = apart.gather(2, chosen[:, None].expand(-1, each, -1))
    valid = ~_repeated(chosen)
    weight = torch.exp(-((own / SPREAD_DEG) ** 2)) * (own < REACH_DEG) * valid[:, None]
    weight = weight / weight.sum(2, keepdim=True).clamp(min=1e-9)
    angles_deg = torch.full((len(whose), count, config.views), math.inf, device=device)
    targets = torch.zeros_like(angles_deg)
    owner = torch.arange(count, device=device).repeat_interleave(each)
    rows = torch.arange(q, device=device)
    angles_deg[rows, owner], targets[rows, owner] = own.flatten(0, 1), weight.flatten(0, 1)
    return Batch(
        windows=network_input(*sensed(*buffer.windows_of(whose, which, shift, stretch, deeper)), clean=False),
        views=network_input(rgb, relief, clean=True),
        known=torch.isfinite(relief),
        angles_deg=angles_deg.flatten(1),
        targets=targets.flatten(1),
        valid=valid.flatten(),
        shown=Shown(
            *(whose, which, q, shift, nearest[..., 0].flatten()),
            *(objects.repeat_interleave(config.views), chosen.flatten()),
        ),
    )


def _angles(rotations: Tensor) -> Tensor:
    """Angles (..., N) in degrees between rotations (..., 3, 3) and those of all views."""
    of_views = torch.from_numpy(view_rotations(icosphere.directions(VIEW_LEVEL), ROLLS)).to(rotations)
    cosines = (torch.einsum("...ij,nij->...n", rotations, of_views) - 1.0) / 2.0
    return torch.rad2deg(torch.acos(cosines.clamp(-1.0, 1.0)))


def _repeated(numbers: Tensor) -> Tensor:
    """Whether each of numbers (N, K) also occurs further left in its row."""
    ordered = numbers.sort(dim=1, stable=True)
    again = torch.zeros_like(numbers, dtype=torch.bool)
    again[:, 1:] = ordered.values[:, 1:] == ordered.values[:, :-1]
    return torch.zeros_like(again).scatter(1, ordered.indices, again)


def _validated(nets: Networks, held_out: ObjectBuffer, config: ViewCodeTraining, course: Course) -> None:
    """Append hours, steps and FIGURES to the curve."""
    nets.eval()
    state = torch.random.get_rng_state()
    torch.manual_seed(0)
    with torch.no_grad():
        rank = torch.cat([_ranks(nets.coding, held_out, k) for k in range(len(held_out))]).float()
        drawn = batch(held_out, config)
        checked = pairs(held_out, drawn.shown, _code_loss(nets.coding, drawn)[1])
        log_odds = verification_loss(nets.verifying, *checked)[1]
    torch.random.set_rng_state(state)
    right = ((log_odds > 0) == (checked[1] > 0)).float().mean()
    figures = ((rank < 1).float().mean(), (rank < 5).float().mean(), rank.median(), right)
    course.curve.append([course.hours, course.steps, *map(float, figures)])


def _ranks(net: ViewCodeNetwork, buffer: ObjectBuffer, k: int) -> Tensor:
    """The rank (Q,) of the first right view among all views of object k, for each of its windows."""
    device = buffer.rotations.device
    apart = _angles(buffer.rotations[k])
    every = torch.arange(apart.shape[1], device=device)
    rgb, relief = buffer.views_of(torch.full_like(every, k), every)
    codes = view_codes(net(network_input(rgb, relief, clean=True)), torch.isfinite(relief))
    n, zero = torch.arange(WINDOWS, device=device), torch.zeros(WINDOWS, device=device)
    windows = buffer.windows_of(torch.full_like(n, k), n, zero[:, None].expand(-1, 2), zero + 1.0, zero)
    similarity = window_codes(net(network_input(*sensed(*windows), clean=False))) @ codes.T
    best = torch.where(apart < RIGHT_DEG, similarity, -math.inf).amax(1)
    return (similarity > best[:, None]).sum(1)


def export(nets: Networks, buffer: ObjectBuffer, config: ViewCodeTraining, out: Path) -> None:
    """Write both networks as ONNX with a free batch size, quantised to 8 bits: half the CPU time; the cosine
    between quantised and exact codes is 0.999. Activations are calibrated on objects of the buffer. The
    network of codes reads the bytes of `view_images.network_input`."""
    with torch.no_grad():
        batches = [batch(buffer, config) for _ in range(CALIBRATED)]
        similar = [_code_loss(nets.coding.eval(), drawn)[1] for drawn in batches]
    in_pairs = [pairs(buffer, drawn.shown, s)[0] for drawn, s in zip(batches, similar, strict=True)]
    single = [part for drawn in batches for part in (drawn.windows, drawn.views)]
    _quantised(nets.coding, out / f"{NAME}.onnx", "window", "code", single)
    read_bytes(out / f"{NAME}.onnx")
    _quantised(_LogOdds(nets.verifying), out / f"{VERIFICATION}.onnx", "pair", "log_odds", in_pairs)


def _quantised(net: nn.Module, file: Path, name: str, output: str, inputs: list[Tensor]) -> None:
    """Write a network as ONNX, quantised; name: of its input; inputs: batches for the calibration."""
    from onnxruntime.quantization import QuantFormat, QuantType, quantize_static

    exact = file.with_suffix(".exact.onnx")
    export_onnx(net, exact, {name: torch.zeros(2, *inputs[0].shape[1:])}, output, any_count=True)
    quantize_static(
        str(exact),
        str(file),
        _Batches(name, inputs),
        quant_format=QuantFormat.QDQ,
        per_channel=True,
        weight_type=QuantType.QInt8,
        activation_type=QuantType.QUInt8,
        # 7-bit weights: without VNNI, sums of 8-bit products overflow.
        reduce_range=True,
    )
    exact.unlink()


class _Batches:
    """Batches of inputs, as the quantiser's calibration reads them."""

    def __init__(self, name: str, inputs: list[Tensor]) -> None:
        self.batches = iter([{name: part.cpu().numpy()} for part in inputs])

    def get_next(self) -> dict[str, np.ndarray] | None:
        """The next batch, or None."""
        return next(self.batches, None)


def _draw(file: Path, course: Course) -> None:
    table = np.array(course.curve)
    curves = {"most similar": (table[:, 1], table[:, 2]), "one of five": (table[:, 1], table[:, 3])}
    title = "windows of objects that it was not trained on"
    picture = line_plot(curves, title, "steps", "share with a right view", y_range=(0.0, 1.0))
    write_picture(file, picture)
