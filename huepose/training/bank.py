"""The newest samples, kept to be asked again: drawing one costs more than learning from it.

Each time it comes out another way round: turned about the line of sight, mirrored, or with the two moments
exchanged. Every one of these is a question that the tracker might ask, and its answer follows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from huepose.paper.canonical import FEATURES
from huepose.paper.rotation_network import POINTS

FIRST, SECOND, FIRST_UV, SECOND_UV = slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 10)
MOVED, MOVED_UV = slice(10, 13), slice(13, 15)
"""What the columns of the features are."""

Samples = tuple[Tensor, Tensor, Tensor]
"""Features (B, K, 128, 15), weights (B, 128) and answers (B, K, 3, 3) for each of K kinds of question."""


class Bank:
    """At most `room` samples on a device, the oldest overwritten. drawn: how many came in so far."""

    def __init__(self, room: int, kinds: int, device: str) -> None:
        self.features = torch.empty(room, kinds, POINTS, FEATURES, dtype=torch.float16, device=device)
        self.weights = torch.empty(room, POINTS, dtype=torch.float16, device=device)
        self.answers = torch.empty(room, kinds, 3, 3, device=device)
        self.drawn = 0

    def add(self, samples: Samples) -> None:
        """Keep new ones."""
        room, count = len(self.weights), len(samples[1])
        at = (torch.arange(count, device=self.weights.device) + self.drawn) % room
        for kept, new in zip((self.features, self.weights, self.answers), samples, strict=True):
            kept[at] = new.to(kept)
        self.drawn += count

    def batch(self, count: int) -> Samples:
        """So many of those that are here, any one perhaps twice, each another way round."""
        device = self.weights.device
        chosen = torch.randint(min(self.drawn, len(self.weights)), (count,), device=device)
        features, answers = varied(self.features[chosen].float(), self.answers[chosen])
        return features, self.weights[chosen].float(), answers


def varied(features: Tensor, answers: Tensor) -> tuple[Tensor, Tensor]:
    """The questions (B, K, N, 15) and answers (B, K, 3, 3), each turned about the line of sight by any angle,
    and by chance mirrored and with its two moments exchanged."""
    count, device = len(features), features.device
    angle = 2.0 * math.pi * torch.rand(count, device=device)
    side = 1.0 - 2.0 * torch.randint(2, (count,), device=device)
    c, s, zero, one = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle), torch.ones_like(angle)
    rows: Sequence[Tensor] = (side * c, -s, zero, side * s, c, zero, zero, zero, one)
    M = torch.stack(rows, 1).reshape(count, 1, 3, 3)
    back = (torch.rand(count, device=device) < 0.5)[:, None, None, None]
    features = torch.where(back, exchanged(features), features) @ _of_all_columns(M)
    answers = torch.where(back, answers.transpose(2, 3), answers)
    return features, M @ answers @ M.transpose(2, 3)


def exchanged(features: Tensor) -> Tensor:
    """The features (..., 15) of the motion backwards."""
    parts = (SECOND, FIRST, SECOND_UV, FIRST_UV)
    return torch.cat(
        [*(features[..., p] for p in parts), -features[..., MOVED], -features[..., MOVED_UV]], -1
    )


def _of_all_columns(M: Tensor) -> Tensor:
    """What rows of features are multiplied by when canonical space is turned by M (B, 1, 3, 3)."""
    out = M.new_zeros(len(M), 1, FEATURES, FEATURES)
    for part in (FIRST, SECOND, MOVED):
        out[:, :, part, part] = M.transpose(2, 3)
    for part in (FIRST_UV, SECOND_UV, MOVED_UV):
        out[:, :, part, part] = M[:, :, :2, :2].transpose(2, 3)
    return out
