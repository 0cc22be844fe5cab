"""Pairs of a window and a clean view in a pose, for the network that verifies poses.

A true pair shows the object in its pose, slightly shifted and rotated, like a refined pose, or the nearest of
its views. A wrong pair has a view of another object, or any view with a window beside its object: of all
views in the batch those whose codes have the largest likeness to the window's. Its depth is aligned with the
measured depth, like that of a wrong pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from huepose.propose.view_codes import CELLS
from huepose.propose.view_images import CHANNELS, SIDE
from huepose.training.network import VerificationNetwork
from huepose.training.object_buffer import ObjectBuffer
from huepose.training.sensing import network_input, scanned, sensed

OFF, STRETCHED, DEEPER = 0.02, 0.02, 0.015
"""Standard deviations of a refined pose: offset in the image (diameters), logarithm of the size, and offset
along the ray (diameters)."""

WRONG = 2
"""Wrong views of each window."""

EXACT, FARTHEST = 0.7, 0.4
"""Share of the true pairs whose depth is that of the pose; all others are aligned with the measured surface
within FARTHEST diameters."""

REPAINTED = 0.15
"""Share of the wrong pairs that show the right shape in other colours."""

CELL_WEIGHT = 0.5
"""Weight of the loss of the cells; the loss of the pose has weight 1."""


@dataclass(frozen=True, eq=False)
class Shown:
    """Contents of the windows and views of a batch. whose, which (Q,): object and number of each window; the
    first `on` windows show the object, the others lie beside it; shift (Q, 2): offset from the object, in
    diameters; nearest (on,): number of the view nearest in rotation; view_objects, view_numbers (T,): object
    and number of each view."""

    whose: Tensor
    which: Tensor
    on: int
    shift: Tensor
    nearest: Tensor
    view_objects: Tensor
    view_numbers: Tensor


def pairs(buffer: ObjectBuffer, shown: Shown, similar: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Inputs (N, 12, 64, 64), whether the pair is true (N,), and the share (N, 8, 8) of each cell that shows
    the object. similar (Q, T): cosines of the codes of windows and views."""
    device, rows = similar.device, torch.arange(len(similar), device=similar.device)
    on = rows < shown.on
    own = shown.view_objects[None] == shown.whose[:, None]
    wrong = similar.masked_fill(own & on[:, None], -2.0)
    # Noise, so that the view with the largest likeness is not always the one.
    wrong = (wrong + 0.05 * torch.randn_like(wrong)).topk(WRONG, dim=1).indices.flatten()

    true = rows[on]
    painted = true[torch.rand(shown.on, device=device) < REPAINTED]
    in_other_colors, differs = _repainted(*buffer.poses_of(shown.whose[painted], shown.which[painted]))
    painted = painted[differs]
    parts = (
        buffer.poses_of(shown.whose[true], shown.which[true]),
        buffer.views_of(shown.whose[true], shown.nearest),
        buffer.views_of(shown.view_objects[wrong], shown.view_numbers[wrong]),
        (in_other_colors[differs], buffer.poses_of(shown.whose[painted], shown.which[painted])[1]),
    )
    row = torch.cat([true, true, rows.repeat_interleave(WRONG), painted])
    rgb, relief = (torch.cat(each) for each in zip(*parts, strict=True))
    there = (torch.arange(len(row), device=device) < 2 * shown.on).float()

    def drawn(*shape: int) -> Tensor:
        return torch.randn(len(row), *shape, device=device)

    shift = OFF * drawn(2) + shown.shift[row] * (~on[row, None])
    place = shown.whose[row], shown.which[row], shift, torch.exp(STRETCHED * drawn())
    seen_rgb, seen_relief = buffer.windows_of(*place, DEEPER * drawn())
    onto = _onto_surface(seen_relief, relief)
    exact = (there > 0) & (torch.rand(len(row), device=device) < EXACT)
    seen_relief = seen_relief - torch.where(exact, 0.0, onto)[:, None, None]
    windows = network_input(*sensed(seen_rgb, seen_relief), clean=False)
    rgb = scanned(rgb)
    visible = buffer.shown_in(*place) * torch.isfinite(relief)
    cells = functional.avg_pool2d(visible[:, None], SIDE // CELLS)[:, 0] * there[:, None, None]
    return torch.cat([windows, network_input(rgb, relief, clean=True)], 1), there, cells


def _onto_surface(seen: Tensor, drawn: Tensor) -> Tensor:
    """Median distance (N,), in diameters, of the measured relief (N, 64, 64) behind the rendered one, over
    the pixels within FARTHEST; 0 without such pixels."""
    apart = seen - drawn
    middle = torch.where(apart.abs() < FARTHEST, apart, torch.nan).flatten(1).nanmedian(dim=1).values
    return torch.nan_to_num(middle)


def _repainted(rgb: Tensor, relief: Tensor) -> tuple[Tensor, Tensor]:
    """Colours (N, 3, 64, 64) with channels exchanged, some inverted, in another tint; and whether they differ
    clearly from the original."""
    count, device = len(rgb), rgb.device
    order = torch.rand(count, 3, device=device).argsort(1)
    changed = rgb.gather(1, order[:, :, None, None].expand_as(rgb))
    changed = torch.where(torch.rand(count, 1, 1, 1, device=device) < 0.6, 1.0 - changed, changed)
    changed = (changed + 0.7 * (torch.rand(count, 3, 1, 1, device=device) - 0.5)).clamp(0.0, 1.0)
    known = torch.isfinite(relief)[:, None]
    apart = ((changed - rgb).abs() * known).sum((1, 2, 3)) / (3 * known.sum((1, 2, 3)).clamp(min=1))
    return torch.where(known, changed, rgb), apart > 0.15


def verification_loss(
    net: VerificationNetwork, inputs: Tensor, there: Tensor, cells: Tensor
) -> tuple[Tensor, Tensor]:
    """The loss, a scalar, and the log-odds (N,), of the output of `pairs`."""
    log_odds, of_cells = (part.float() for part in net(inputs))
    covered = functional.avg_pool2d(inputs[:, CHANNELS + 4 : CHANNELS + 5], SIDE // CELLS)[:, 0] > 0.1
    each = functional.binary_cross_entropy_with_logits(of_cells, cells, reduction="none")
    of_cells_loss = (each * covered).sum() / covered.sum().clamp(min=1)
    # Some labels are wrong: a wrong view can look like the window by chance.
    target = 0.01 + 0.98 * there
    return functional.binary_cross_entropy_with_logits(
        log_odds, target
    ) + CELL_WEIGHT * of_cells_loss, log_odds
