"""The network of view codes and its loss.

Depthwise separable convolutions as in ConvNeXt (Liu et al. 2022), with batch norm, which is folded into the
weights for inference. The loss is InfoNCE (van den Oord et al. 2018) in both directions: each window has to
pick its view among views of its own and of other objects, and each view its window among windows of other
objects and windows beside the object.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from huepose.propose.view_codes import CELLS, NUMBERS
from huepose.propose.view_pictures import CHANNELS, SIDE

WIDTHS, DEPTHS = (32, 64, 128), (4, 5)
"""Channels at 1/2, 1/4 and 1/8 of the picture's side; number of blocks at 1/4 and at 1/8."""

SAME_DEG, NOT_SAME_DEG = 22.0, 60.0
"""A view matches a window when the object's rotation differs by less than the first, and does not match when
it differs by more than the second. Views between the two are left out of the loss."""

SHARP, LARGEST_SHARPNESS = 14.0, 100.0
"""Inverse temperature of the loss: where it starts, and its upper bound. It is learned."""

EXCLUDED = -1e4
"""The logit of what is left out of a softmax."""


class Block(nn.Module):
    """A residual block: a depthwise convolution, batch norm, and a perceptron of two layers in each cell."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.depthwise = nn.Conv2d(channels, channels, 5, padding=2, groups=channels, bias=False)
        self.norm = nn.BatchNorm2d(channels)
        self.expand = nn.Conv2d(channels, 2 * channels, 1)
        self.project = nn.Conv2d(2 * channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """x (N, C, h, w) -> (N, C, h, w)."""
        return x + self.project(functional.relu(self.expand(self.norm(self.depthwise(x)))))


class ViewCodeNetwork(nn.Module):
    """Encodes pictures (N, 6, 64, 64) of `propose.view_pictures` as codes (N, 16, 8, 8)."""

    def __init__(self) -> None:
        super().__init__()
        first, second, third = WIDTHS
        self.body = nn.Sequential(
            *_downsampling(CHANNELS, first),
            nn.ReLU(),
            *_downsampling(first, second),
            nn.ReLU(),
            *(Block(second) for _ in range(DEPTHS[0])),
            *_downsampling(second, third),
            *(Block(third) for _ in range(DEPTHS[1])),
            nn.Conv2d(third, NUMBERS, 1),
        )
        self.log_sharpness = nn.Parameter(torch.tensor(math.log(SHARP)))

    def forward(self, pictures: Tensor) -> Tensor:
        """pictures (N, 6, 64, 64) -> codes (N, 16, 8, 8)."""
        return self.body(pictures)


def _downsampling(channels_in: int, channels_out: int) -> tuple[nn.Module, nn.Module]:
    return nn.Conv2d(channels_in, channels_out, 3, 2, 1, bias=False), nn.BatchNorm2d(channels_out)


def view_codes(codes: Tensor, known: Tensor) -> Tensor:
    """Unit vectors (N, D) of clean views, of the network's codes (N, 16, 8, 8). known (N, 64, 64): the pixels
    that show the object; cells without it become zero."""
    covered = functional.avg_pool2d(known[:, None].float(), SIDE // CELLS)
    flat = (codes * covered).flatten(1)
    return flat / flat.norm(dim=1, keepdim=True).clamp(min=1e-6)


def window_codes(codes: Tensor) -> Tensor:
    """Unit vectors (N, D) of windows, of the network's codes (N, 16, 8, 8); all cells weigh the same."""
    return (functional.normalize(codes, dim=1, eps=1e-4) / CELLS).flatten(1)


def info_nce(logits: Tensor, angles_deg: Tensor, targets: Tensor, valid: Tensor) -> Tensor:
    """The loss of Q windows and T views, a scalar.

    logits (Q, T): cosines of their codes, times the inverse temperature. angles_deg (Q, T): the rotation
    between each view and the object in the window; inf for views of other objects, and for windows beside the
    object. targets (Q, T): the distribution of the right answer over the views, rows of sum 1; zeros for
    windows beside the object. valid (T,): False for views that were drawn twice."""
    logits = logits.masked_fill(~valid, EXCLUDED)
    positive = targets.sum(1) > 0
    by_window = -(targets * functional.log_softmax(logits, 1)).sum(1)[positive].mean()
    between = (angles_deg >= SAME_DEG) & (angles_deg < NOT_SAME_DEG)
    of_view = logits.masked_fill(between, EXCLUDED)
    same = angles_deg < SAME_DEG
    log_share = torch.logsumexp(of_view.masked_fill(~same, EXCLUDED), 0) - torch.logsumexp(of_view, 0)
    return by_window - log_share[same.any(0) & valid].mean()
