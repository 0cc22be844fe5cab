"""The newest rendered objects in a device's memory, and images of their views and windows."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from huepose.geometry import icosphere
from huepose.propose.templates import SPAN
from huepose.propose.view_images import LEVEL as VIEW_LEVEL
from huepose.propose.view_images import ROLLS, SIDE, UPRIGHT_PX
from huepose.training.windows import PIXELS, WINDOWS, Drawn


class ObjectBuffer:
    """The newest rendered objects, in the memory of a device. added: number of objects added so far."""

    def __init__(self, room: int, device: str) -> None:
        views = len(icosphere.directions(VIEW_LEVEL))
        byte, half = ({"dtype": kind, "device": device} for kind in (torch.uint8, torch.float16))
        self.view_colors = torch.zeros(room, views, UPRIGHT_PX, UPRIGHT_PX, 3, **byte)
        self.view_reliefs = torch.zeros(room, views, UPRIGHT_PX, UPRIGHT_PX, **half)
        self.colors = torch.zeros(room, WINDOWS, PIXELS, PIXELS, 3, **byte)
        self.reliefs = torch.zeros(room, WINDOWS, PIXELS, PIXELS, **half)
        self.rotations = torch.zeros(room, WINDOWS, 3, 3, device=device)
        self.shown = torch.zeros(room, WINDOWS, PIXELS, PIXELS, dtype=torch.bool, device=device)
        self.pose_colors = torch.zeros(room, WINDOWS, SIDE, SIDE, 3, **byte)
        self.pose_reliefs = torch.zeros(room, WINDOWS, SIDE, SIDE, **half)
        self.added = 0

    def __len__(self) -> int:
        return min(self.added, len(self.rotations))

    def add(self, one: Drawn) -> None:
        """Add an object; it replaces the oldest if the buffer is full."""
        kept = (
            *(self.view_colors, self.view_reliefs, self.colors, self.reliefs, self.rotations),
            *(self.shown, self.pose_colors, self.pose_reliefs),
        )
        for room, part in zip(kept, one, strict=True):
            room[self.added % len(room)] = torch.as_tensor(part).to(room)
        self.added += 1

    def views_of(self, objects: Tensor, numbers: Tensor) -> tuple[Tensor, Tensor]:
        """Colours (M, 3, 64, 64) from 0 to 1 and relief (M, 64, 64), NaN beside the object, of views of
        objects (M,). numbers (M,): in the order of `view_images.turned`."""
        view, roll = numbers // ROLLS, numbers % ROLLS
        angle = 2.0 * math.pi * roll / ROLLS
        c, s, zero = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)
        share = SIDE / UPRIGHT_PX
        rows = torch.stack([c * share, s * share, zero]), torch.stack([-s * share, c * share, zero])
        to_image = torch.stack(rows).permute(2, 0, 1)
        return _resampled(self.view_colors[objects, view], self.view_reliefs[objects, view], to_image)

    def windows_of(
        self, objects: Tensor, numbers: Tensor, shift: Tensor, stretch: Tensor, deeper: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Colours and relief, NaN where depth is unknown, of the windows `numbers` (M,) of objects (M,),
        moved by `shift` (M, 2) and `deeper` (M,) diameters and enlarged by `stretch` (M,)."""
        colors, reliefs = _resampled(
            self.colors[objects, numbers], self.reliefs[objects, numbers], _moved(shift, stretch)
        )
        return colors, reliefs + deeper[:, None, None]

    def shown_in(self, objects: Tensor, numbers: Tensor, shift: Tensor, stretch: Tensor) -> Tensor:
        """The pixels (M, 64, 64) of the windows of `windows_of` that show the object."""
        shown = self.shown[objects, numbers].float()[:, None]
        grid = functional.affine_grid(
            _moved(shift, stretch).float(), [len(shown), 1, SIDE, SIDE], align_corners=False
        )
        return functional.grid_sample(shown, grid, mode="nearest", align_corners=False)[:, 0]

    def poses_of(self, objects: Tensor, numbers: Tensor) -> tuple[Tensor, Tensor]:
        """Colours (M, 3, 64, 64) and relief (M, 64, 64) of clean views in nearly the rotations of windows."""
        rgb = self.pose_colors[objects, numbers].permute(0, 3, 1, 2).float() / 255.0
        return rgb, self.pose_reliefs[objects, numbers].float()


def _moved(shift: Tensor, stretch: Tensor) -> Tensor:
    """Affine maps (M, 2, 3) into the rendered windows, for windows moved by `shift` (M, 2) diameters and
    enlarged by `stretch` (M,)."""
    share, zero = SIDE / PIXELS * stretch, torch.zeros_like(stretch)
    half = PIXELS / SIDE * SPAN / 2.0
    rows = (
        torch.stack([share, zero, shift[:, 0] / half]),
        torch.stack([zero, share, shift[:, 1] / half]),
    )
    return torch.stack(rows).permute(2, 0, 1)


def _resampled(colors: Tensor, reliefs: Tensor, to_image: Tensor) -> tuple[Tensor, Tensor]:
    """Colours (M, 3, 64, 64) from 0 to 1 and relief (M, 64, 64) of colours (M, n, n, 3) and relief (M, n, n),
    resampled by affine maps `to_image` (M, 2, 3) in torch's coordinates from -1 to 1."""
    known = torch.isfinite(reliefs)
    both = torch.stack([torch.where(known, reliefs, 0.0).float(), known.float()], 1)
    grid = functional.affine_grid(to_image.float(), [len(colors), 1, SIDE, SIDE], align_corners=False)
    rgb = functional.grid_sample(colors.permute(0, 3, 1, 2).float() / 255.0, grid, align_corners=False)
    both = functional.grid_sample(both, grid, mode="nearest", align_corners=False)
    return rgb, torch.where(both[:, 1] > 0.5, both[:, 0], math.nan)
