"""The networks that are trained: for rotations, for view codes with their loss, and for verification.

Rotations: Attention-DGCNN, edge convolutions on dynamic neighbourhoods, then attention in place of a global
maximum. Paper, section III-E; edge convolution after Wang et al., Dynamic Graph CNN for Learning on Point
Clouds (2019); the six numbers of a rotation after Zhou et al. (2019).

View codes and verification: depthwise separable convolutions as in ConvNeXt (Liu et al. 2022), with batch
norm, which is folded into the weights for inference. The loss of codes is InfoNCE (van den Oord et al. 2018)
in both directions: each window has to pick its view among views of its own and of other objects, and each
view its window among windows of other objects and windows beside the object.
"""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from huepose.propose.view_codes import CELLS, NUMBERS
from huepose.propose.view_images import CHANNELS, SIDE

NEIGHBOURS = 12
"""Number of points, itself included, with which each point has an edge."""

EDGE_WIDTHS = (48, 64, 96)
EMBEDDING = 128
"""Channels of each point after each edge convolution, and after all of them."""

HEADS = 4
"""Heads of the attention between the points, and of the attention that pools them."""

NEGATIVE_SLOPE = 0.2
"""Of the leaky rectifiers, as in the published DGCNN."""


class EdgeConvolution(nn.Module):
    """For each point the largest response, over its nearest neighbours in feature space, to (x_j - x_i, x_i).

    The linear map of an edge is the sum of a map of each end, so it is computed per point before neighbours
    are gathered: the same numbers, a twelfth of the work.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.other = nn.Linear(inputs, outputs, bias=False)
        self.own = nn.Linear(inputs, outputs, bias=False)
        self.normal = nn.BatchNorm1d(outputs)

    def forward(self, x: Tensor, near: Tensor) -> Tensor:
        """x (B, N, inputs), near (B, N, K) indices -> (B, N, outputs)."""
        b, n, k = near.shape
        other = self.other(x)
        gathered = torch.gather(other, 1, near.reshape(b, n * k, 1).expand(-1, -1, other.shape[2]))
        # The point's own terms are the same for all its neighbours: they are added after the maximum.
        largest = gathered.reshape(b, n, k, -1).amax(2) - other + self.own(x)
        normal = self.normal(largest.transpose(1, 2)).transpose(1, 2)
        return functional.leaky_relu(normal, NEGATIVE_SLOPE)


def neighbours(x: Tensor, count: int = NEIGHBOURS) -> Tensor:
    """Indices (B, N, count) of the nearest points in x (B, N, D), themselves included."""
    square = (x * x).sum(-1)
    distance = square[:, :, None] - 2.0 * x @ x.transpose(1, 2) + square[:, None]
    return distance.topk(count, dim=-1, largest=False).indices


class AttentionDgcnn(nn.Module):
    """features (B, 128, 15), weights (B, 128) -> rotation (B, 3, 3). `reach`: scale of the rotations that an
    untrained network gives; small for a network that corrects."""

    def __init__(self, inputs: int = 15, reach: float = 1.0) -> None:
        super().__init__()
        self.reach = reach
        self.scale = nn.BatchNorm1d(inputs)
        sizes = (inputs, *EDGE_WIDTHS)
        self.edges = nn.ModuleList(EdgeConvolution(a, b) for a, b in pairwise(sizes))
        self.embed = nn.Linear(sum(EDGE_WIDTHS) + inputs, EMBEDDING)
        self.attention = nn.MultiheadAttention(EMBEDDING, HEADS, batch_first=True)
        self.after = nn.LayerNorm(EMBEDDING)
        self.look = nn.Linear(EMBEDDING, HEADS)
        self.head = nn.Sequential(
            nn.Linear(EMBEDDING * HEADS, 128), nn.LeakyReLU(NEGATIVE_SLOPE), nn.Linear(128, 6)
        )

    def forward(self, features: Tensor, weights: Tensor) -> Tensor:
        """See the class."""
        x = self.scale(features.transpose(1, 2)).transpose(1, 2)
        seen = [x]
        for k, edge in enumerate(self.edges):
            near = neighbours(features[:, :, :3] if k == 0 else seen[-1])
            seen.append(edge(seen[-1], near))
        points = functional.leaky_relu(self.embed(torch.cat(seen, -1)), NEGATIVE_SLOPE)
        points = self.after(points + self.attention(points, points, points, need_weights=False)[0])
        # Each head pools the points by its own attention; the weights of the matches are its prior.
        share = torch.softmax(self.look(points) + torch.log(weights + 1e-3)[..., None], dim=1)
        pooled = (share.transpose(1, 2) @ points).flatten(1)
        return rotation_of_six(self.reach * self.head(pooled))


def rotation_of_six(six: Tensor) -> Tensor:
    """Rotations (B, 3, 3) of numbers (B, 6), by Gram-Schmidt; zeros give the identity."""
    x = functional.normalize(six[:, :3] + six.new_tensor([1.0, 0.0, 0.0]), dim=1)
    y = six[:, 3:] + six.new_tensor([0.0, 1.0, 0.0])
    y = functional.normalize(y - (x * y).sum(1, keepdim=True) * x, dim=1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], 2)


def geodesic(R: Tensor, R_true: Tensor) -> Tensor:
    """Angles (B,) between rotations (B, 3, 3), radians; differentiable at zero, unlike the arc cosine."""
    chord = ((R - R_true) ** 2).sum((1, 2)).add(1e-12).sqrt() / 8.0**0.5
    return 2.0 * torch.asin(chord.clamp(max=1.0 - 1e-6))


WIDTHS, DEPTHS = (32, 64, 128), (4, 5)
"""Channels at 1/2, 1/4 and 1/8 of the image's side; number of blocks at 1/4 and at 1/8."""

SAME_DEG, NOT_SAME_DEG = 22.0, 60.0
"""A view matches a window when the object's rotation differs by less than the first, and does not match when
it differs by more than the second. Views between the two are left out of the loss."""

SHARP, LARGEST_SHARPNESS = 14.0, 100.0
"""Inverse temperature of the loss, which is learned: its start and its upper bound."""

EXCLUDED = -1e4
"""The logit of entries that are left out of a softmax."""


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
    """Encodes images (N, 6, 64, 64) of `propose.view_images` as codes (N, 16, 8, 8)."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(*_body(CHANNELS), nn.Conv2d(WIDTHS[-1], NUMBERS, 1))
        self.log_sharpness = nn.Parameter(torch.tensor(math.log(SHARP)))

    def forward(self, images: Tensor) -> Tensor:
        """images (N, 6, 64, 64) -> codes (N, 16, 8, 8)."""
        return self.body(images)


class VerificationNetwork(nn.Module):
    """Says whether a window shows an object in a pose. Input: images (N, 12, 64, 64), the channels of the
    window and then those of the object's clean view in this pose. Output: the log-odds (N,) that the window
    shows the object in it, and for each cell (N, 8, 8) that the cell shows it."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(*_body(2 * CHANNELS))
        self.cell = nn.Conv2d(WIDTHS[-1], 1, 1)
        self.head = nn.Sequential(nn.Linear(2 * WIDTHS[-1] + 2, 128), nn.ReLU(), nn.Linear(128, 1))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """See the class."""
        features = self.body(images)
        cells = self.cell(features)
        covered = functional.avg_pool2d(images[:, CHANNELS + 4 : CHANNELS + 5], SIDE // CELLS)
        area = covered.mean((2, 3))
        of_object = (features * covered).mean((2, 3)) / area.clamp(min=1e-3)
        seen = (torch.sigmoid(cells) * covered).mean((2, 3)) / area.clamp(min=1e-3)
        everywhere = features.mean((2, 3))
        return self.head(torch.cat([of_object, everywhere, area, seen], 1))[:, 0], cells[:, 0]


def _body(channels: int) -> list[nn.Module]:
    """From images (N, channels, 64, 64) to features (N, 128, 8, 8)."""
    first, second, third = WIDTHS
    return [
        *_downsampling(channels, first),
        nn.ReLU(),
        *_downsampling(first, second),
        nn.ReLU(),
        *(Block(second) for _ in range(DEPTHS[0])),
        *_downsampling(second, third),
        *(Block(third) for _ in range(DEPTHS[1])),
    ]


def _downsampling(channels_in: int, channels_out: int) -> tuple[nn.Module, nn.Module]:
    return nn.Conv2d(channels_in, channels_out, 3, 2, 1, bias=False), nn.BatchNorm2d(channels_out)


def view_codes(codes: Tensor, known: Tensor) -> Tensor:
    """Unit vectors (N, D) of clean views, from the network's codes (N, 16, 8, 8). known (N, 64, 64): the
    pixels that show the object; cells without it become zero."""
    covered = functional.avg_pool2d(known[:, None].float(), SIDE // CELLS)
    flat = (codes * covered).flatten(1)
    return flat / flat.norm(dim=1, keepdim=True).clamp(min=1e-6)


def window_codes(codes: Tensor) -> Tensor:
    """Unit vectors (N, D) of windows, from the network's codes (N, 16, 8, 8); all cells have equal weight."""
    return (functional.normalize(codes, dim=1, eps=1e-4) / CELLS).flatten(1)


def info_nce(logits: Tensor, angles_deg: Tensor, targets: Tensor, valid: Tensor) -> Tensor:
    """The loss of Q windows and T views, a scalar.

    logits (Q, T): cosines of their codes, times the inverse temperature. angles_deg (Q, T): the rotation
    between each view and the object in the window; inf for views of other objects, and for windows beside the
    object. targets (Q, T): the target distribution over the views, rows of sum 1; zeros for windows beside
    the object. valid (T,): False for views that are in the batch twice."""
    logits = logits.masked_fill(~valid, EXCLUDED)
    positive = targets.sum(1) > 0
    by_window = -(targets * functional.log_softmax(logits, 1)).sum(1)[positive].mean()
    between = (angles_deg >= SAME_DEG) & (angles_deg < NOT_SAME_DEG)
    of_view = logits.masked_fill(between, EXCLUDED)
    same = angles_deg < SAME_DEG
    log_share = torch.logsumexp(of_view.masked_fill(~same, EXCLUDED), 0) - torch.logsumexp(of_view, 0)
    return by_window - log_share[same.any(0) & valid].mean()
