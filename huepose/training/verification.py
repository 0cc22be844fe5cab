"""Pairs of a window and a clean view in a pose, for the network that verifies poses.

A true pair shows the object in its pose, a little moved and turned, as a refined pose is; in the nearest of
its views; or, for the network that judges a search, in a rough pose, turned by some tens of degrees to where
its relief fits. A wrong pair shows the object of another window: of all views in the batch those whose codes
are most like the window's, brought to the depth that is measured there, as a wrong pose is; or the right
object in other colours.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from huepose.propose.view_codes import CELLS
from huepose.propose.view_pictures import CHANNELS, NEAR, SIDE
from huepose.training.network import VerificationNetwork
from huepose.training.object_buffer import ObjectBuffer
from huepose.training.sensing import REPRINTED, SHINY, network_input, recolored, reprinted, sensed, shone_on

OFF, STRETCHED, DEEPER = 0.02, 0.02, 0.015
"""Standard deviations of a refined pose's offset in the picture and along the ray (diameters), and of the
logarithm of its size."""

ROUGH = 3.0
"""A rough pose is so many times as far off."""

ROUGH_DEG, CANDIDATES = (12.0, 35.0), 6
"""A rough pose is turned by more than the first, as likely as a Gaussian of the second has it; of so many
views drawn like this the one whose relief fits is taken."""

WRONG = 2
"""Wrong views of each window."""

EXACT, FARTHEST = 0.7, 0.4
"""Share of the true pairs whose depth is that of the pose; all others are moved onto the surface that is seen
within FARTHEST diameters."""

EXCHANGED, PLAINLY = 0.65, 0.12
"""Of the true poses that are shown once more in other colours, as wrong pairs, the share whose channels are
exchanged and little else; mean difference of a colour from which a repainted picture counts."""

ORDERS = torch.tensor([[0, 2, 1], [1, 0, 2], [2, 1, 0], [2, 1, 0], [1, 2, 0], [2, 0, 1]])
"""Of the channels: all but the right one, and twice the one in which red and blue are exchanged, which a
camera's driver may be in."""

CELL_WEIGHT = 0.5
"""Of the cells' loss beside that of the pose."""


@dataclass(frozen=True, eq=False)
class Shown:
    """What windows and views of a batch show. whose, which (Q,): object and number of each window; the first
    `on` lie on the object; shift (Q, 2): offset of the others from it, in diameters; nearest (on,): number of
    the view that is nearest in rotation; rough (on, CANDIDATES): numbers of views that are rotated by more;
    view_objects, view_numbers (T,): object and number of each view."""

    whose: Tensor
    which: Tensor
    on: int
    shift: Tensor
    nearest: Tensor
    rough: Tensor
    view_objects: Tensor
    view_numbers: Tensor


def pairs(buffer: ObjectBuffer, shown: Shown, similar: Tensor, rough: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Pictures (N, 12, 64, 64), whether the object is there (N,), and the share (N, 8, 8) of each cell that
    shows it. similar (Q, T): cosines of the codes of windows and views; rough: with rough poses as well."""
    device, rows = similar.device, torch.arange(len(similar), device=similar.device)
    on = rows < shown.on
    own = shown.view_objects[None] == shown.whose[:, None]
    wrong = similar.masked_fill(own & on[:, None], -2.0)
    # Not always the likest of all.
    wrong = (wrong + 0.05 * torch.randn_like(wrong)).topk(WRONG, dim=1).indices.flatten()

    true = rows[on]
    right = buffer.poses_of(shown.whose[true], shown.which[true])
    of_true, to_paint = [right, buffer.views_of(shown.whose[true], shown.nearest)], right
    if rough:
        turned = buffer.views_of(shown.whose[true], _fitting(buffer, shown))
        half = torch.rand(len(true), 1, 1, device=device) < 0.5
        to_paint = torch.where(half[:, None], right[0], turned[0]), torch.where(half, right[1], turned[1])
        of_true.append(turned)
    in_other_colors, differs = _repainted(*to_paint)
    of_wrong = buffer.views_of(shown.view_objects[wrong], shown.view_numbers[wrong])
    parts = *of_true, of_wrong, (in_other_colors[differs], to_paint[1][differs])
    row = torch.cat([true] * len(of_true) + [rows.repeat_interleave(WRONG), true[differs]])
    rgb, relief = (torch.cat(each) for each in zip(*parts, strict=True))
    number = torch.arange(len(row), device=device)
    there = (number < len(of_true) * shown.on).float()

    def drawn(*shape: int) -> Tensor:
        return torch.randn(len(row), *shape, device=device)

    # Half of the wrong views lie as roughly as the rough ones.
    roughly = (there == 0) & (number < len(row) - int(differs.sum())) & (drawn() > 0) & rough
    off = torch.where((number >= 2 * shown.on) & (there > 0) | roughly, ROUGH, 1.0)
    shift = OFF * off[:, None] * drawn(2) + shown.shift[row] * (~on[row, None])
    place = shown.whose[row], shown.which[row], shift, torch.exp(STRETCHED * off * drawn())
    seen_rgb, seen_relief = buffer.windows_of(*place, DEEPER * off * drawn())
    onto = _onto_surface(seen_relief, relief)
    exact = (there > 0) & (torch.rand(len(row), device=device) < EXACT)
    seen_relief = seen_relief - torch.where(exact, 0.0, onto)[:, None, None]
    windows = network_input(*sensed(seen_rgb, seen_relief), clean=False)
    rgb = reprinted(shone_on(recolored(rgb, 0.4), SHINY), REPRINTED)
    visible = buffer.shown_in(*place) * torch.isfinite(relief)
    cells = functional.avg_pool2d(visible[:, None], SIDE // CELLS)[:, 0] * there[:, None, None]
    return torch.cat([windows, network_input(rgb, relief, clean=True)], 1), there, cells


def rough_views(apart: Tensor) -> Tensor:
    """Numbers (Q, CANDIDATES) of views in rotations that a rough pose may have. apart (Q, V): angles to the
    true rotation, degrees."""
    least, spread = ROUGH_DEG
    chance = torch.exp(-0.5 * (apart / spread) ** 2) * (apart > least)
    # As often at any angle: rotations are the rarer the smaller their angle.
    chance = chance / torch.sin(torch.deg2rad(apart.clamp(min=least) / 2.0)) ** 2
    return torch.multinomial(chance, CANDIDATES)


def _fitting(buffer: ObjectBuffer, shown: Shown) -> Tensor:
    """Of the rough views of each window on the object the number (on,) of the one whose relief fits best."""
    whose, which = (x[: shown.on].repeat_interleave(CANDIDATES) for x in (shown.whose, shown.which))
    still = torch.zeros(len(whose), device=whose.device)
    seen = buffer.windows_of(whose, which, still[:, None].expand(-1, 2), still + 1.0, still)[1]
    drawn = buffer.views_of(whose, shown.rough.flatten())[1]
    apart = (seen - drawn - _onto_surface(seen, drawn)[:, None, None]).abs().clamp(max=NEAR)
    # What is drawn where nothing is measured fits as badly as what is far off.
    misfit = torch.where(torch.isfinite(drawn), torch.nan_to_num(apart, nan=NEAR), 0.0).sum((1, 2))
    misfit = misfit / torch.isfinite(drawn).sum((1, 2)).clamp(min=1)
    best = misfit.view(-1, CANDIDATES).argmin(1, keepdim=True)
    return shown.rough.gather(1, best)[:, 0]


def _onto_surface(seen: Tensor, drawn: Tensor) -> Tensor:
    """How far (N,), in diameters, what is seen (N, 64, 64) lies behind what is drawn, where it may be it."""
    apart = seen - drawn
    middle = torch.where(apart.abs() < FARTHEST, apart, torch.nan).flatten(1).nanmedian(dim=1).values
    return torch.nan_to_num(middle)


def _repainted(rgb: Tensor, relief: Tensor) -> tuple[Tensor, Tensor]:
    """Colours (N, 3, 64, 64) with channels exchanged; in some, light for dark as well, in another tint; and
    whether they differ plainly."""
    count, device = len(rgb), rgb.device
    order = ORDERS.to(device)[torch.randint(len(ORDERS), (count,), device=device)]
    changed = rgb.gather(1, order[:, :, None, None].expand_as(rgb))
    more, dark = torch.rand(2, count, 1, 1, 1, device=device)
    more = more > EXCHANGED
    changed = torch.where(more & (dark < 0.6), 1.0 - changed, changed)
    tint = torch.where(more, 0.7, 0.1) * (torch.rand(count, 3, 1, 1, device=device) - 0.5)
    changed = (changed + tint).clamp(0.0, 1.0)
    known = torch.isfinite(relief)[:, None]
    apart = ((changed - rgb).abs() * known).sum((1, 2, 3)) / (3 * known.sum((1, 2, 3)).clamp(min=1))
    return torch.where(known, changed, rgb), apart > PLAINLY


def verification_loss(
    net: VerificationNetwork, pictures: Tensor, there: Tensor, cells: Tensor
) -> tuple[Tensor, Tensor]:
    """The loss, a scalar, and the log-odds (N,), of what `pairs` gives."""
    log_odds, of_cells = (part.float() for part in net(pictures))
    covered = functional.avg_pool2d(pictures[:, CHANNELS + 4 : CHANNELS + 5], SIDE // CELLS)[:, 0] > 0.1
    each = functional.binary_cross_entropy_with_logits(of_cells, cells, reduction="none")
    of_cells_loss = (each * covered).sum() / covered.sum().clamp(min=1)
    # Some labels are wrong: what is drawn may happen to look alike.
    target = 0.01 + 0.98 * there
    return functional.binary_cross_entropy_with_logits(
        log_odds, target
    ) + CELL_WEIGHT * of_cells_loss, log_odds
