"""Augmentation: rendered images as other cameras and scanned models show them: colours, sheen, noise, depth.

Rendered scenes have exactly the colours of their models. A user's camera and the scanner of a model differ in
colour filters, white balance, tone curve and glare, and the print may be newer; depth has holes, is wider
than the object, or is shifted.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from huepose.propose.view_images import NEAR, SIDE

MOST_VEILED = 0.45
"""Largest share of one colour that is blended over a whole window: cameras show black as grey and red as
pink."""

CROSSTALK = 0.12
"""Standard deviation of the share that a colour channel takes from each other one in another camera."""

SHINY, REPRINTED = 0.3, 0.15
"""Share of the images with patches of sheen, which scanned models have in their textures, too; share of the
views with a part in other colours."""


def recolored(rgb: Tensor, strength: float) -> Tensor:
    """Colours (N, 3, h, w) from 0 to 1 in another light, exposure, saturation and tone curve."""

    def chance(spread: float, channels: int = 1) -> Tensor:
        drawn = torch.randn(len(rgb), channels, 1, 1, device=rgb.device)
        return torch.exp(strength * spread * drawn)

    linear = rgb.clamp(0.0, 1.0) ** 2.2 * chance(0.15, 3) * chance(0.3)
    grey = linear.mean(1, keepdim=True)
    linear = grey + (linear - grey) * chance(0.3) * math.exp(-0.15 * strength)
    return linear.clamp(1e-4, 1.0) ** (chance(0.18) / 2.2)


def scanned(rgb: Tensor) -> Tensor:
    """Views as scanned models show them: in slightly other colours, some with sheen or another print."""
    return reprinted(shone_on(recolored(rgb, 0.4), SHINY), REPRINTED)


def sensed(rgb: Tensor, relief: Tensor) -> tuple[Tensor, Tensor]:
    """Windows as other sensors would measure them: other colours, sheen, a veil, sharpened or soft, noisy;
    depth with holes, wider than the object, or shifted."""
    count, device = len(rgb), rgb.device

    def share() -> Tensor:
        return torch.rand(count, 1, 1, device=device)

    rgb = mixed(recolored(shone_on(rgb, SHINY), 1.0))
    veil = MOST_VEILED * share()[:, None] ** 2
    grey, tint = torch.rand(count, 1, 1, 1, device=device), torch.rand(count, 3, 1, 1, device=device)
    rgb = (1.0 - veil) * rgb + veil * (0.6 * grey + 0.4 * tint)
    soft = functional.avg_pool2d(functional.pad(rgb, (1, 1, 1, 1), mode="replicate"), 3, 1)
    rgb = rgb + (1.6 * share()[:, None] - 0.8) * (rgb - soft)
    rgb = rgb + 0.03 * share()[:, None] * torch.randn_like(rgb)
    holes = (_blobs(count, device) > 1.1 + 1.2 * share()) & (share() < 0.4)
    relief = _widened(relief) + 0.02 * share() ** 2 * torch.randn_like(relief)
    return rgb.clamp(0.0, 1.0), torch.where(holes, math.nan, relief)


def _blobs(count: int, device: torch.device) -> Tensor:
    """Smooth noise (N, 64, 64), standard deviation about 0.8."""
    coarse = torch.randn(count, 1, 9, 9, device=device)
    return functional.interpolate(coarse, (SIDE, SIDE), mode="bicubic")[:, 0]


def mixed(rgb: Tensor) -> Tensor:
    """Colours as a sensor with other filters measures them: each channel has a part of the others; greys do
    not change."""
    matrix = torch.eye(3, device=rgb.device) + CROSSTALK * torch.randn(len(rgb), 3, 3, device=rgb.device)
    matrix = matrix / matrix.sum(2, keepdim=True)
    return torch.einsum("nij,njhw->nihw", matrix, rgb).clamp(0.0, 1.0)


def shone_on(rgb: Tensor, share: float) -> Tensor:
    """Colours with patches of sheen in a share of the images."""
    strength = torch.rand(len(rgb), 1, 1, device=rgb.device)
    some = torch.rand(len(rgb), 1, 1, device=rgb.device) < share
    patch = ((_blobs(len(rgb), rgb.device) - 0.7) * 2.0).clamp(0.0, 1.0) * strength * some
    return rgb + (0.95 - rgb).clamp(min=0.0) * patch[:, None]


def reprinted(rgb: Tensor, share: float) -> Tensor:
    """Colours with a part in other colours, in a share of the images: another lid, a newer print."""
    some = torch.rand(len(rgb), 1, 1, device=rgb.device) < share
    part = (_blobs(len(rgb), rgb.device) > 0.6) & some
    other = recolored(rgb.flip(1), 2.0) * 0.5 + 0.5 * torch.rand(len(rgb), 3, 1, 1, device=rgb.device)
    return torch.where(part[:, None], other, rgb)


def _widened(relief: Tensor) -> Tensor:
    """Relief (N, 64, 64): in some, near surfaces are widened, others are shifted."""
    count, device = len(relief), relief.device
    kind = torch.rand(count, 1, 1, device=device)
    near = -functional.max_pool2d(torch.where(torch.isfinite(relief), -relief, -99.0)[:, None], 3, 1, 1)[:, 0]
    near = torch.where(near > 90.0, math.nan, near)
    off = [int(x) for x in torch.randint(-2, 3, (2,))]
    aside = relief.roll((off[0], off[1]), (1, 2))
    return torch.where(kind < 0.25, near, torch.where(kind < 0.45, aside, relief))


def network_input(rgb: Tensor, relief: Tensor, *, clean: bool) -> Tensor:
    """As `view_images.network_input`, but from colours 0 to 1 and as floats (N, 6, 64, 64)."""
    known = torch.isfinite(relief)
    level = torch.where(known, relief, 0.0)
    colors = (2.0 * rgb - 1.0) * (known[:, None] if clean else 1.0)
    parts = [2.0 * level.clamp(-NEAR, NEAR), known.float(), (known & (level.abs() < NEAR)).float()]
    return torch.cat([colors, torch.stack(parts, 1)], 1)
