"""What a detector is told of its answers: which places stand for which object, and how far off they are.

An object is given to the places in it that come closest to its class and box already (Feng et al., TOOD,
2021); these learn its box, and as their score the overlap that they reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

PLACES_PER_OBJECT = 8
SCORE_POWER, OVERLAP_POWER = 0.5, 4.0
BOX_SHARE = 2.0
"""Weight of the boxes against the scores."""


@dataclass(frozen=True, eq=False)
class Assignment:
    """Of the places of one picture: chosen (P,) their numbers, objects (P,) which object each stands for,
    scores (P,) what each has to say of its class."""

    chosen: Tensor
    objects: Tensor
    scores: Tensor


def overlaps(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Intersection over union and its generalised form (Rezatofighi et al. 2019, -1 to 1) of boxes (..., 4)
    x0 y0 x1 y1 that broadcast."""
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    common = (high - low).clamp(min=0.0).prod(-1)
    union = _area(a) + _area(b) - common
    around = torch.cat([torch.minimum(a[..., :2], b[..., :2]), torch.maximum(a[..., 2:], b[..., 2:])], -1)
    whole = _area(around).clamp(min=1e-6)
    iou = common / union.clamp(min=1e-6)
    return iou, iou - (whole - union) / whole


def _area(corners: Tensor) -> Tensor:
    return (corners[..., 2:] - corners[..., :2]).clamp(min=0.0).prod(-1)


@torch.no_grad()  # type: ignore[untyped-decorator]
def assigned(
    corners: Tensor, logits: Tensor, centres: Tensor, strides: Tensor, true: Tensor, classes: Tensor
) -> Assignment:
    """Places for objects with boxes `true` (K, 4) of `classes` (K,), given what the network answers: corners
    (G, 4) and logits (G, C) at centres (G, 2) of grids with the steps (G,)."""
    if not len(true):
        none = torch.zeros(0, dtype=torch.long, device=true.device)
        return Assignment(none, none, true.new_zeros(0))
    # A thing smaller than a grid's step has its nearest place outside.
    middle, half = (true[:, None, :2] + true[:, None, 2:]) / 2, (true[:, None, 2:] - true[:, None, :2]) / 2
    reach = torch.maximum(half, strides[None, :, None] * 0.75)
    inside = ((centres - middle).abs() < reach).all(-1)
    iou, _ = overlaps(true[:, None], corners[None])
    fit = torch.sigmoid(logits[:, classes].T) ** SCORE_POWER * iou.clamp(min=1e-3) ** OVERLAP_POWER * inside
    best = fit.topk(min(PLACES_PER_OBJECT, fit.shape[1]), dim=1)
    wanted = torch.zeros_like(inside).scatter_(1, best.indices, best.values > 0.0)
    # A place that two objects want goes to the one that it overlaps more.
    owner = torch.where(wanted, iou + 1e-6, 0.0).max(0)
    chosen = torch.nonzero(owner.values > 0.0)[:, 0]
    objects = owner.indices[chosen]
    fit_of, iou_of = fit[objects, chosen], iou[objects, chosen]
    top_fit = torch.zeros(len(true), device=true.device).scatter_reduce_(0, objects, fit_of, "amax")
    top_iou = torch.zeros(len(true), device=true.device).scatter_reduce_(0, objects, iou_of, "amax")
    return Assignment(chosen, objects, fit_of / top_fit[objects].clamp(min=1e-12) * top_iou[objects])


def detector_loss(
    corners: Tensor,
    logits: Tensor,
    centres: Tensor,
    strides: Tensor,
    true: list[Tensor],
    classes: list[Tensor],
) -> Tensor:
    """The loss of a batch: corners (B, G, 4), logits (B, G, C); `true` and `classes` by picture. Per unit of
    score that was to be given."""
    target = torch.zeros_like(logits)
    box_loss, total = corners.new_zeros(()), corners.new_zeros(())
    for k, (boxes, labels) in enumerate(zip(true, classes, strict=True)):
        got = assigned(corners[k], logits[k], centres, strides, boxes, labels)
        target[k, got.chosen, labels[got.objects]] = got.scores
        _, generalised = overlaps(corners[k, got.chosen], boxes[got.objects])
        box_loss = box_loss + ((1.0 - generalised) * got.scores).sum()
        total = total + got.scores.sum()
    score_loss = functional.binary_cross_entropy_with_logits(logits, target, reduction="sum")
    return (score_loss + BOX_SHARE * box_loss) / total.clamp(min=1.0)
