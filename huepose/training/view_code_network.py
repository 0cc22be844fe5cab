"""The network of view codes, and what it learns by: which view shows what a window shows, and which window.

Separable convolutions as in ConvNeXt (Liu et al. 2022), with batch norm, which costs nothing when it runs.
The loss is InfoNCE (van den Oord et al. 2018) both ways: a window has to find its view among those of its own
and of other objects, and a view its window among others and among ones beside the object.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from huepose.propose.view_codes import CELLS, NUMBERS
from huepose.propose.view_pictures import CHANNELS, SIDE

WIDTHS, DEPTHS = (32, 64, 128), (4, 5)
"""Channels at a half, a quarter and an eighth of the picture; blocks at the last two."""

SAME_DEG, NOT_SAME_DEG = 22.0, 60.0
"""Views of the object turned by less than the first from a window's are its; by more than the second, not;
between, nobody asks."""

SHARP, LARGEST_SHARPNESS = 14.0, 100.0
"""What likenesses are multiplied by, at first and at most."""

NEVER = -1e4


class Block(nn.Module):
    """What is near, then what each cell makes of it, added to what was there."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.near = nn.Conv2d(channels, channels, 5, padding=2, groups=channels, bias=False)
        self.norm = nn.BatchNorm2d(channels)
        self.wide = nn.Conv2d(channels, 2 * channels, 1)
        self.back = nn.Conv2d(2 * channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """x (N, C, h, w) -> (N, C, h, w)."""
        return x + self.back(functional.relu(self.wide(self.norm(self.near(x)))))


class ViewCodeNetwork(nn.Module):
    """Pictures (N, 6, 64, 64) of `propose.view_pictures` -> codes (N, 16, 8, 8)."""

    def __init__(self) -> None:
        super().__init__()
        first, second, third = WIDTHS
        self.body = nn.Sequential(
            *_halved(CHANNELS, first),
            nn.ReLU(),
            *_halved(first, second),
            nn.ReLU(),
            *(Block(second) for _ in range(DEPTHS[0])),
            *_halved(second, third),
            *(Block(third) for _ in range(DEPTHS[1])),
            nn.Conv2d(third, NUMBERS, 1),
        )
        self.log_sharpness = nn.Parameter(torch.tensor(math.log(SHARP)))

    def forward(self, pictures: Tensor) -> Tensor:
        """See the class."""
        return self.body(pictures)


def _halved(before: int, after: int) -> tuple[nn.Module, nn.Module]:
    return nn.Conv2d(before, after, 3, 2, 1, bias=False), nn.BatchNorm2d(after)


def view_codes(codes: Tensor, known: Tensor) -> Tensor:
    """Codes (N, D) of unit length of clean views, of the network's (N, 16, 8, 8); known (N, 64, 64): what
    each view covers."""
    covered = functional.avg_pool2d(known[:, None].float(), SIDE // CELLS)
    flat = (codes * covered).flatten(1)
    return flat / flat.norm(dim=1, keepdim=True).clamp(min=1e-6)


def window_codes(codes: Tensor) -> Tensor:
    """Codes (N, D) of windows, of the network's (N, 16, 8, 8)."""
    return (functional.normalize(codes, dim=1, eps=1e-4) / CELLS).flatten(1)


def loss_of(alike: Tensor, angles: Tensor, wanted: Tensor, asked: Tensor) -> Tensor:
    """alike (Q, T): sharpened likenesses of windows and views; angles (Q, T): how far, in degrees, each view
    is turned from what the window shows, inf where it is of another object or the window is beside it; wanted
    (Q, T): how much of the answer each view is, rows of sum 1, or 0 for windows beside the object; asked
    (T,): views that are not there twice."""
    alike = alike.masked_fill(~asked, NEVER)
    own = wanted.sum(1) > 0
    by_window = -(wanted * functional.log_softmax(alike, 1)).sum(1)[own].mean()
    between = (angles >= SAME_DEG) & (angles < NOT_SAME_DEG)
    column = alike.masked_fill(between, NEVER)
    same = angles < SAME_DEG
    found = torch.logsumexp(column.masked_fill(~same, NEVER), 0) - torch.logsumexp(column, 0)
    return by_window - found[same.any(0) & asked].mean()
