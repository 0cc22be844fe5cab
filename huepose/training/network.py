"""Attention-DGCNN: edge convolutions on moving neighbourhoods, then attention in place of a global maximum.

Paper, section III-E; edge convolution after Wang et al., Dynamic Graph CNN for Learning on Point Clouds
(2019); the six numbers of a rotation after Zhou et al. (2019).
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

NEIGHBOURS = 12
WIDTHS = (48, 64, 96)
EMBEDDING = 128
HEADS = 4
NEGATIVE_SLOPE = 0.2


class EdgeConvolution(nn.Module):
    """Of each point and its nearest neighbours in feature space: the largest response to (x_j - x_i, x_i).

    The linear map of an edge is the sum of one of each end, so it is taken per point before neighbours are
    gathered: the same numbers, a twelfth of the work.
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
        # The own terms are the same for all neighbours of a point: they come after the maximum.
        largest = gathered.reshape(b, n, k, -1).amax(2) - other + self.own(x)
        normal = self.normal(largest.transpose(1, 2)).transpose(1, 2)
        return functional.leaky_relu(normal, NEGATIVE_SLOPE)


def neighbours(x: Tensor, count: int = NEIGHBOURS) -> Tensor:
    """Indices (B, N, count) of the nearest points in x (B, N, D), themselves included."""
    square = (x * x).sum(-1)
    distance = square[:, :, None] - 2.0 * x @ x.transpose(1, 2) + square[:, None]
    return distance.topk(count, dim=-1, largest=False).indices


class AttentionDgcnn(nn.Module):
    """features (B, 128, 15), weights (B, 128) -> rotation (B, 3, 3). `reach`: how far from no turn at all an
    untrained network answers; small for a network that corrects."""

    def __init__(self, inputs: int = 15, reach: float = 1.0) -> None:
        super().__init__()
        self.reach = reach
        self.scale = nn.BatchNorm1d(inputs)
        sizes = (inputs, *WIDTHS)
        self.edges = nn.ModuleList(EdgeConvolution(a, b) for a, b in pairwise(sizes))
        self.embed = nn.Linear(sum(WIDTHS) + inputs, EMBEDDING)
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
        # Each head pools the points by an attention of its own; a match's weight is a prior of it.
        share = torch.softmax(self.look(points) + torch.log(weights + 1e-3)[..., None], dim=1)
        pooled = (share.transpose(1, 2) @ points).flatten(1)
        return rotation_of_six(self.reach * self.head(pooled))


def rotation_of_six(six: Tensor) -> Tensor:
    """Rotations (B, 3, 3) of numbers (B, 6), by Gram-Schmidt; zeros are no turn."""
    x = functional.normalize(six[:, :3] + six.new_tensor([1.0, 0.0, 0.0]), dim=1)
    y = six[:, 3:] + six.new_tensor([0.0, 1.0, 0.0])
    y = functional.normalize(y - (x * y).sum(1, keepdim=True) * x, dim=1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], 2)


def geodesic(R: Tensor, R_true: Tensor) -> Tensor:
    """Angles (B,) between rotations (B, 3, 3), radians; differentiable at zero, unlike the arc cosine."""
    chord = ((R - R_true) ** 2).sum((1, 2)).add(1e-12).sqrt() / 8.0**0.5
    return 2.0 * torch.asin(chord.clamp(max=1.0 - 1e-6))
