"""A small detector without anchors, whose output has the layout of YOLOv8: boxes and scores of three grids.

Under half a million numbers; bottlenecks with a shortcut (He et al. 2016), a top-down path (Lin et al. 2017),
one head for all grids (Tian et al. 2019: distances to the four sides of the box, in steps of the grid).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from huepose.perception.yolo_layouts import STRIDES

WIDTHS = (16, 32, 64, 80, 112)
NECK = 48
FIRST_SCORE = 0.01
"""What an untrained network says of every place: few of them hold an object."""


class _Convolution(nn.Sequential):
    """Convolution, normalisation, SiLU."""

    def __init__(self, inputs: int, outputs: int, side: int = 3, stride: int = 1) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False),
            nn.BatchNorm2d(outputs),
            nn.SiLU(),
        )


class _Bottleneck(nn.Module):
    """A shortcut around two convolutions of half the width."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.inner = nn.Sequential(_Convolution(width, width // 2, 1), _Convolution(width // 2, width))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.inner(x)


class SmallYolo(nn.Module):
    """images (B, 3, H, W) RGB in 0..1, sides multiples of 32 -> corners (B, G, 4) x0 y0 x1 y1 in pixels and
    logits (B, G, classes), over the places of the three grids."""

    def __init__(self, classes: int, input_size: tuple[int, int]) -> None:
        super().__init__()
        a, b, c, d, e = WIDTHS
        self.stem = nn.Sequential(_Convolution(3, a, 3, 2), _Convolution(a, b, 3, 2), _Bottleneck(b))
        self.grids = nn.ModuleList(
            [
                nn.Sequential(_Convolution(b, c, 3, 2), _Bottleneck(c), _Bottleneck(c)),
                nn.Sequential(_Convolution(c, d, 3, 2), _Bottleneck(d), _Bottleneck(d)),
                nn.Sequential(_Convolution(d, e, 3, 2), _Bottleneck(e)),
            ]
        )
        self.lateral = nn.ModuleList(_Convolution(width, NECK, 1) for width in (c, d, e))
        self.smooth = nn.ModuleList(_Convolution(NECK, NECK) for _ in (c, d))
        self.look, self.measure = _Convolution(NECK, NECK), _Convolution(NECK, NECK)
        self.scores, self.sides = nn.Conv2d(NECK, classes, 1), nn.Conv2d(NECK, 4, 1)
        nn.init.constant_(self.scores.bias, float(torch.logit(torch.tensor(FIRST_SCORE))))
        centres, strides = grid(input_size)
        self.register_buffer("centres", centres, persistent=False)
        self.register_buffer("strides", strides, persistent=False)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """See the class."""
        x, seen = self.stem(images), []
        for stage in self.grids:
            x = stage(x)
            seen.append(x)
        fine, middle, coarse = (lateral(x) for lateral, x in zip(self.lateral, seen, strict=True))
        middle = self.smooth[1](middle + functional.interpolate(coarse, scale_factor=2.0))
        fine = self.smooth[0](fine + functional.interpolate(middle, scale_factor=2.0))
        levels: Sequence[Tensor] = (fine, middle, coarse)
        logits = torch.cat([self.scores(self.look(x)).flatten(2) for x in levels], 2).transpose(1, 2)
        sides = torch.cat([self.sides(self.measure(x)).flatten(2) for x in levels], 2).transpose(1, 2)
        reach = 2.0 * torch.exp(sides.clamp(-5.0, 4.0)) * self.strides[:, None]
        return torch.cat([self.centres - reach[..., :2], self.centres + reach[..., 2:]], -1), logits


class Exported(nn.Module):
    """The network as it is written: one output (B, 4 + classes, G), cx cy w h and scores."""

    def __init__(self, network: SmallYolo) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        """See the class."""
        corners, logits = self.network(images)
        low, high = corners[..., :2], corners[..., 2:]
        return torch.cat([(low + high) / 2, high - low, torch.sigmoid(logits)], -1).transpose(1, 2)


def grid(input_size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Centres (G, 2) x y of the places in pixels of an input (height, width), and their steps (G,)."""
    centres, strides = [], []
    for stride in STRIDES:
        height, width = input_size[0] // stride, input_size[1] // stride
        ys, xs = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        centres.append((torch.stack([xs, ys], -1).reshape(-1, 2) + 0.5) * stride)
        strides.append(torch.full((height * width,), float(stride)))
    return torch.cat(centres), torch.cat(strides)
