"""Trains the network of view codes (`propose.view_codes`) on drawn objects and writes it as ONNX.

Processes draw new objects (`training.windows`) while the network learns from a buffer of the newest ones.
Each step takes windows and views of some of them at random, moves and recolours them, and takes `info_nce`.
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
from torch import Tensor
from torch.nn import functional
from torch.utils.data import DataLoader

from huepose.drawing.plots import line_plot
from huepose.geometry import icosphere
from huepose.propose.templates import SPAN, view_rotations
from huepose.propose.view_pictures import CHANNELS, NEAR, ROLLS, SIDE, UNTURNED
from huepose.propose.view_pictures import LEVEL as VIEW_LEVEL
from huepose.support.files import write_picture
from huepose.training.byte_input import read_bytes
from huepose.training.network import LARGEST_SHARPNESS, ViewCodeNetwork, info_nce, view_codes, window_codes
from huepose.training.runs import VALIDATION_ROUND, Course, Settings, Training, endless_loader, export_onnx
from huepose.training.windows import PIXELS, WINDOWS, Drawn, endless

SHIFT, LARGEST_SHIFT = 0.06, 0.13
"""Offset of a window from the object's middle, in diameters: standard deviation and largest. The detector's
windows are a quarter of a diameter apart."""

STRETCH, DEEPER, DEEPEST = 0.06, 0.1, 0.25
"""Standard deviations of a window's logarithmic size and of its depth (diameters); largest depth offset."""

BESIDE = (0.3, 0.52)
"""Offset, in diameters, of windows that count as beside the object (negatives)."""

SPREAD_DEG, REACH_DEG = 18.0, 38.0
"""The target distribution over views falls with the rotation to the true one as a Gaussian of this deviation,
and ends at REACH_DEG."""

RIGHT_DEG = 25.0
"""In validation, a view rotated by less than this is right."""

MOST_VEILED = 0.3
"""Largest share of one colour that lies over a whole window: cameras show black as grey and red as pink."""

NAME = "views"
FIGURES = ("first_right", "one_of_five_right", "median_rank")
"""On held-out windows, among all views of the object: share whose most similar view is right, share with a
right view among the five most similar, median rank of the first right view."""


@dataclass(frozen=True)
class ViewCodeTraining(Settings):
    """Settings of a training. validation: held-out objects. A step takes `objects`, and of each `windows`
    that show it, windows `beside` it (negatives) and `views`. room: objects in the buffer, after which the
    oldest is replaced; first: objects drawn before the first step; reuse: most steps an object."""

    every: int = 1000
    validation: int = 48
    objects: int = 24
    windows: int = 6
    beside: int = 3
    views: int = 40
    room: int = 6000
    first: int = 200
    reuse: float = 8.0


class ObjectBuffer:
    """The newest drawn objects, in memory of a device. added: how many there have been."""

    def __init__(self, room: int, device: str) -> None:
        views = len(icosphere.directions(VIEW_LEVEL))
        byte, half = ({"dtype": kind, "device": device} for kind in (torch.uint8, torch.float16))
        self.view_colors = torch.zeros(room, views, UNTURNED, UNTURNED, 3, **byte)
        self.view_reliefs = torch.zeros(room, views, UNTURNED, UNTURNED, **half)
        self.colors = torch.zeros(room, WINDOWS, PIXELS, PIXELS, 3, **byte)
        self.reliefs = torch.zeros(room, WINDOWS, PIXELS, PIXELS, **half)
        self.rotations = torch.zeros(room, WINDOWS, 3, 3, device=device)
        self.added = 0

    def __len__(self) -> int:
        return min(self.added, len(self.rotations))

    def add(self, one: Drawn) -> None:
        """Add an object; it replaces the oldest where the buffer is full."""
        kept = self.view_colors, self.view_reliefs, self.colors, self.reliefs, self.rotations
        for room, part in zip(kept, one, strict=True):
            room[self.added % len(room)] = torch.as_tensor(part).to(room)
        self.added += 1

    def views_of(self, objects: Tensor, numbers: Tensor) -> tuple[Tensor, Tensor]:
        """Colours (M, 3, 64, 64) from 0 to 1 and relief (M, 64, 64), NaN where nothing is, of the numbered
        views, in the order of `view_pictures.turned`, of objects (M,)."""
        view, roll = numbers // ROLLS, numbers % ROLLS
        angle = 2.0 * math.pi * roll / ROLLS
        c, s, zero = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)
        share = SIDE / UNTURNED
        rows = torch.stack([c * share, s * share, zero]), torch.stack([-s * share, c * share, zero])
        to_picture = torch.stack(rows).permute(2, 0, 1)
        return _resampled(self.view_colors[objects, view], self.view_reliefs[objects, view], to_picture)

    def windows_of(
        self, objects: Tensor, numbers: Tensor, shift: Tensor, stretch: Tensor, deeper: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Colours and relief, likewise, of the numbered windows of objects (M,), moved by `shift` (M, 2) and
        `deeper` (M,) diameters and enlarged by `stretch` (M,)."""
        share, zero = SIDE / PIXELS * stretch, torch.zeros_like(stretch)
        half = PIXELS / SIDE * SPAN / 2.0
        rows = (
            torch.stack([share, zero, shift[:, 0] / half]),
            torch.stack([zero, share, shift[:, 1] / half]),
        )
        to_picture = torch.stack(rows).permute(2, 0, 1)
        colors, reliefs = _resampled(
            self.colors[objects, numbers], self.reliefs[objects, numbers], to_picture
        )
        return colors, reliefs + deeper[:, None, None]


def _resampled(colors: Tensor, reliefs: Tensor, to_picture: Tensor) -> tuple[Tensor, Tensor]:
    """Pictures (M, 3, 64, 64) and relief (M, 64, 64) of colours (M, n, n, 3) and relief (M, n, n),
    resampled by affine maps `to_picture` (M, 2, 3) in torch's coordinates from -1 to 1."""
    known = torch.isfinite(reliefs)
    both = torch.stack([torch.where(known, reliefs, 0.0).float(), known.float()], 1)
    grid = functional.affine_grid(to_picture.float(), [len(colors), 1, SIDE, SIDE], align_corners=False)
    rgb = functional.grid_sample(colors.permute(0, 3, 1, 2).float() / 255.0, grid, align_corners=False)
    both = functional.grid_sample(both, grid, mode="nearest", align_corners=False)
    return rgb, torch.where(both[:, 1] > 0.5, both[:, 0], math.nan)


def recolored(rgb: Tensor, strength: float) -> Tensor:
    """Colours (N, 3, h, w) from 0 to 1 in another light, exposure, saturation and tone curve."""

    def chance(spread: float, channels: int = 1) -> Tensor:
        drawn = torch.randn(len(rgb), channels, 1, 1, device=rgb.device)
        return torch.exp(strength * spread * drawn)

    linear = rgb.clamp(0.0, 1.0) ** 2.2 * chance(0.15, 3) * chance(0.3)
    grey = linear.mean(1, keepdim=True)
    linear = grey + (linear - grey) * chance(0.3) * math.exp(-0.15 * strength)
    return linear.clamp(1e-4, 1.0) ** (chance(0.18) / 2.2)


def sensed(rgb: Tensor, relief: Tensor) -> tuple[Tensor, Tensor]:
    """Windows as other sensors would give them: other colours, sharpened or soft, noisy; depth with holes."""
    count, device = len(rgb), rgb.device

    def share() -> Tensor:
        return torch.rand(count, 1, 1, device=device)

    rgb = recolored(rgb, 1.0)
    veil = MOST_VEILED * share()[:, None] ** 2
    rgb = (1.0 - veil) * rgb + veil * torch.rand(count, 3, 1, 1, device=device)
    soft = functional.avg_pool2d(functional.pad(rgb, (1, 1, 1, 1), mode="replicate"), 3, 1)
    rgb = rgb + (1.6 * share()[:, None] - 0.8) * (rgb - soft)
    rgb = rgb + 0.03 * share()[:, None] * torch.randn_like(rgb)
    blobs = functional.interpolate(torch.randn(count, 1, 9, 9, device=device), (SIDE, SIDE), mode="bicubic")
    holes = (blobs[:, 0] > 1.1 + 1.2 * share()) & (share() < 0.4)
    relief = relief + 0.02 * share() ** 2 * torch.randn_like(relief)
    return rgb.clamp(0.0, 1.0), torch.where(holes, math.nan, relief)


def network_input(rgb: Tensor, relief: Tensor, *, clean: bool) -> Tensor:
    """As `view_pictures.network_input`, of colours from 0 to 1, but plain numbers (N, 6, 64, 64)."""
    known = torch.isfinite(relief)
    level = torch.where(known, relief, 0.0)
    colors = (2.0 * rgb - 1.0) * (known[:, None] if clean else 1.0)
    parts = [2.0 * level.clamp(-NEAR, NEAR), known.float(), (known & (level.abs() < NEAR)).float()]
    return torch.cat([colors, torch.stack(parts, 1)], 1)


def train(config: ViewCodeTraining, out: Path, resume: bool = False) -> dict[str, Any]:
    """Train until `config.hours` are over, or until interrupted; leave `views.onnx`, `views.json`,
    `views.png`, its curve, and `checkpoint.pt` in `out`. Returns what views.json says.

    Raises InputError where `resume` finds no checkpoint, or one of another kind."""
    out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(config.seed)
    held_out = ObjectBuffer(config.validation, config.device)
    for one in endless_loader(endless, config, VALIDATION_ROUND):
        held_out.add(one)
        if held_out.added == config.validation:
            break
    net = ViewCodeNetwork().to(config.device)
    optimiser = torch.optim.AdamW(net.parameters(), config.rate, weight_decay=1e-2)
    training = Training.begun(out, NAME, config, optimiser, {NAME: net}, resume)
    fresh = endless_loader(endless, config, training.course.rounds)
    training.run(
        _buffers(fresh, config),
        lambda buffer: _step(net, optimiser, buffer, config),
        partial(_validated, net, held_out),
    )
    _draw(out / f"{NAME}.png", training.course)
    export(net, held_out, out / f"{NAME}.onnx")
    figures = dict(zip(FIGURES, training.course.curve[-1][2:], strict=True))
    return training.report(NAME, validation=figures)


def _buffers(fresh: DataLoader[Any], config: ViewCodeTraining) -> Iterator[ObjectBuffer]:
    """The buffer once for each step, with the objects that were drawn meanwhile."""
    buffer, steps = ObjectBuffer(config.room, config.device), 0
    for one in fresh:
        buffer.add(one)
        while buffer.added >= config.first and steps < config.reuse * buffer.added:
            yield buffer
            steps += 1


def _step(
    net: ViewCodeNetwork, optimiser: torch.optim.Optimizer, buffer: ObjectBuffer, config: ViewCodeTraining
) -> None:
    net.train()
    with torch.no_grad():
        windows, views, known, angles_deg, targets, valid = batch(buffer, config)
    half = torch.autocast(config.device, dtype=torch.bfloat16, enabled=config.device != "cpu")
    with half:
        codes = net(torch.cat([windows, views])).float()
    similarity = window_codes(codes[: len(windows)]) @ view_codes(codes[len(windows) :], known).T
    sharpness = net.log_sharpness.exp().clamp(max=LARGEST_SHARPNESS)
    optimiser.zero_grad()
    info_nce(sharpness * similarity, angles_deg, targets, valid).backward()
    torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    optimiser.step()


def batch(
    buffer: ObjectBuffer, config: ViewCodeTraining
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """A random batch: pictures of windows (Q, 6, 64, 64) and of views (T, 6, 64, 64), which pixels of the
    views show the object (T, 64, 64), and for `info_nce` angles_deg (Q, T), targets (Q, T) and valid (T,)."""
    device = buffer.rotations.device
    count, each = config.objects, config.windows
    objects = torch.randint(len(buffer), (count,), device=device)
    numbers = torch.rand(count, WINDOWS, device=device).argsort(1)[:, :each]
    apart = _angles(buffer.rotations[objects[:, None], numbers])
    nearest = apart.topk(2, dim=2, largest=False).indices.flatten(1)
    others = torch.randint(apart.shape[2], (count, config.views - nearest.shape[1]), device=device)
    chosen = torch.cat([nearest, others], 1)
    rgb, relief = buffer.views_of(objects.repeat_interleave(config.views), chosen.flatten())
    views = network_input(recolored(rgb, 0.4), relief, clean=True)

    q, beside = count * each, count * config.beside
    shift = (SHIFT * torch.randn(q, 2, device=device)).clamp(-LARGEST_SHIFT, LARGEST_SHIFT)
    way = 2.0 * math.pi * torch.rand(beside, device=device)
    off = BESIDE[0] + (BESIDE[1] - BESIDE[0]) * torch.rand(beside, device=device)
    shift = torch.cat([shift, off[:, None] * torch.stack([torch.cos(way), torch.sin(way)], 1)])
    which = torch.cat([numbers.flatten(), torch.randint(WINDOWS, (beside,), device=device)])
    whose = torch.cat([objects.repeat_interleave(each), objects.repeat_interleave(config.beside)])
    stretch = torch.exp(STRETCH * torch.randn(len(whose), device=device))
    deeper = (DEEPER * torch.randn(len(whose), device=device)).clamp(-DEEPEST, DEEPEST)
    windows = network_input(*sensed(*buffer.windows_of(whose, which, shift, stretch, deeper)), clean=False)

    own = apart.gather(2, chosen[:, None].expand(-1, each, -1))
    valid = ~_repeated(chosen)
    weight = torch.exp(-((own / SPREAD_DEG) ** 2)) * (own < REACH_DEG) * valid[:, None]
    weight = weight / weight.sum(2, keepdim=True).clamp(min=1e-9)
    angles_deg = torch.full((len(whose), count, config.views), math.inf, device=device)
    targets = torch.zeros_like(angles_deg)
    owner = torch.arange(count, device=device).repeat_interleave(each)
    rows = torch.arange(q, device=device)
    angles_deg[rows, owner], targets[rows, owner] = own.flatten(0, 1), weight.flatten(0, 1)
    return windows, views, torch.isfinite(relief), angles_deg.flatten(1), targets.flatten(1), valid.flatten()


def _angles(rotations: Tensor) -> Tensor:
    """Angles (..., N) in degrees between rotations (..., 3, 3) and those of all views."""
    turns = torch.from_numpy(view_rotations(icosphere.directions(VIEW_LEVEL), ROLLS)).to(rotations)
    cosines = (torch.einsum("...ij,nij->...n", rotations, turns) - 1.0) / 2.0
    return torch.rad2deg(torch.acos(cosines.clamp(-1.0, 1.0)))


def _repeated(numbers: Tensor) -> Tensor:
    """Whether each of numbers (N, K) stands further left in its row, too."""
    ordered = numbers.sort(dim=1, stable=True)
    again = torch.zeros_like(numbers, dtype=torch.bool)
    again[:, 1:] = ordered.values[:, 1:] == ordered.values[:, :-1]
    return torch.zeros_like(again).scatter(1, ordered.indices, again)


def _validated(net: ViewCodeNetwork, held_out: ObjectBuffer, course: Course) -> None:
    """Append hours, steps and FIGURES to the curve."""
    net.eval()
    state = torch.random.get_rng_state()
    torch.manual_seed(0)
    with torch.no_grad():
        ranks = [_ranks(net, held_out, k) for k in range(len(held_out))]
    torch.random.set_rng_state(state)
    rank = torch.cat(ranks).float()
    figures = ((rank < 1).float().mean(), (rank < 5).float().mean(), rank.median())
    course.curve.append([course.hours, course.steps, *map(float, figures)])


def _ranks(net: ViewCodeNetwork, buffer: ObjectBuffer, k: int) -> Tensor:
    """The rank (Q,) of the first right view among all views of object k, for each of its windows."""
    device = buffer.rotations.device
    apart = _angles(buffer.rotations[k])
    every = torch.arange(apart.shape[1], device=device)
    rgb, relief = buffer.views_of(torch.full_like(every, k), every)
    codes = view_codes(net(network_input(rgb, relief, clean=True)), torch.isfinite(relief))
    n, still = torch.arange(WINDOWS, device=device), torch.zeros(WINDOWS, device=device)
    seen = buffer.windows_of(torch.full_like(n, k), n, still[:, None].expand(-1, 2), still + 1.0, still)
    similarity = window_codes(net(network_input(*sensed(*seen), clean=False))) @ codes.T
    best = torch.where(apart < RIGHT_DEG, similarity, -math.inf).amax(1)
    return (similarity > best[:, None]).sum(1)


def export(net: ViewCodeNetwork, buffer: ObjectBuffer, file: Path) -> None:
    """Write the network as ONNX with a free batch size, quantised to 8 bits: half the CPU time, and the
    cosine of its codes with the exact ones is 0.999. Activations are calibrated on objects of the buffer. It
    reads the bytes of `view_pictures.network_input`."""
    from onnxruntime.quantization import QuantFormat, QuantType, quantize_static

    exact = file.with_suffix(".exact.onnx")
    export_onnx(net, exact, {"window": torch.zeros(2, CHANNELS, SIDE, SIDE)}, "code", any_count=True)
    quantize_static(
        str(exact),
        str(file),
        _Pictures(buffer),
        quant_format=QuantFormat.QDQ,
        per_channel=True,
        weight_type=QuantType.QInt8,
        activation_type=QuantType.QUInt8,
        # 7-bit weights: without VNNI, sums of 8-bit products overflow.
        reduce_range=True,
    )
    exact.unlink()
    read_bytes(file)


class _Pictures:
    """Batches of windows and views, as the quantiser's calibration reads them."""

    def __init__(self, buffer: ObjectBuffer, objects: int = 12, each: int = 6) -> None:
        self.batches = iter(_some(buffer, min(objects, len(buffer)), each))

    def get_next(self) -> dict[str, np.ndarray] | None:
        """The next batch, or None."""
        return next(self.batches, None)


def _some(buffer: ObjectBuffer, objects: int, each: int) -> Iterator[dict[str, np.ndarray]]:
    device = buffer.rotations.device
    still = torch.zeros(each, device=device)
    for k in range(objects):
        whose, which = torch.full((each,), k, device=device), torch.arange(each, device=device)
        views = buffer.views_of(whose, which * ROLLS)
        windows = buffer.windows_of(whose, which, still[:, None].expand(-1, 2), still + 1.0, still)
        yield {"window": network_input(*views, clean=True).cpu().numpy()}
        yield {"window": network_input(*windows, clean=False).cpu().numpy()}


def _draw(file: Path, course: Course) -> None:
    table = np.array(course.curve)
    curves = {"likest": (table[:, 1], table[:, 2]), "one of five": (table[:, 1], table[:, 3])}
    title = "windows of objects that it was not trained on"
    picture = line_plot(curves, title, "steps", "share with a right view", y_range=(0.0, 1.0))
    write_picture(file, picture)
