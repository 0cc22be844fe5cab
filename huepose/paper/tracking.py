"""One step of the paper's tracker (section III-E, "Pose Tracking").

Optical flow on the object's region > matches that the carried mask and their colour pairs confirm > lifted to
3D > canonical features > the network's rotation > the translation that the matches agree on > a fixed small
number of point-to-plane iterations. There is no velocity, no search, no colour in the refinement, no belief.

Two things the paper does not have. Matches are also filtered by flow from the second frame back to the first
(`propose.flow`): it takes the error of the network's rotation five frames on from 0.62 to 0.56 of the motion
(`huepose eval ablation`: `flow filtered` and `consistent filtered`, `direct`). And the centroid is trimmed
(`paper.canonical`).

What the paper leaves open, and what is done here:

- A mask that comes late, as a segmenter's at 5 Hz, is carried by flow to now and used in the next step. In
  the others it is the object's outline at its last pose, where depth agrees with it. Flow carries it to the
  new frame; there it filters matches and cuts out the depth.
- The region of the flow: the outline's box and as much again on each side, so that a step may be as long as
  the object is large in the picture.
- The network regresses the whole rotation, as the paper's does (`rotation_network`, kind "direct"). Instead
  of it, one that corrects a closed form may be given, or the closed form alone.
- Where the matches give no motion the last pose goes on, and the refinement has to find the object.
- ICP: ten iterations, a gate from 20 to 8 mm, a thousand points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.silhouette import projected_box, visible_mask
from huepose.model.types import ReferenceModel
from huepose.paper.correspondences import match, propagate
from huepose.paper.relative_pose import RelativePose, lift_matches, robust_kabsch
from huepose.paper.rotation_network import learned
from huepose.propose import flow as optical_flow
from huepose.refine.point_to_plane import align

Rotation = Literal["direct", "residual", "kabsch"]

GROWTH = 1.0
"""Of the region of the flow on each side, in sizes of the object's box."""

VISIBLE_M = 0.015
"""Depth may lie this far from the model's surface and still be the object's."""

GATE_START_M, GATE_END_M, ITERATIONS, POINTS = 0.02, 0.008, 10, 1000
"""Of the alignment to depth: how far points may be apart in the first and in the last of its iterations, and
about how many of the mask's points are aligned."""


@dataclass(frozen=True)
class PaperStep:
    """From an object's pose in one frame to its pose in the next.

    relative_pose: from matches to a motion; flow: where optical flow comes from.
    """

    relative_pose: RelativePose
    flow: optical_flow.FlowSource = optical_flow.compute

    @staticmethod
    def of(
        rotation: Rotation = "direct",
        model: Path | None = None,
        flow: optical_flow.FlowSource = optical_flow.compute,
    ) -> PaperStep:
        """With a network for the rotation (the one of a file, else the one that comes with the library), or
        with the closed form alone. Raises InputError for a file that is no such network."""
        return PaperStep(robust_kabsch if rotation == "kabsch" else learned(rotation, model), flow)

    def __call__(
        self,
        model: ReferenceModel,
        T_cam_obj: Float64,
        before: RgbdFrame,
        after: RgbdFrame,
        mask: Bool | None = None,
    ) -> Float64:
        """T_cam_obj (4, 4) in the frame `after`, from that in `before`. mask (H, W): the object's pixels in
        `before`, where a segmenter gave them. The pose comes back as it is where the object is out of sight.
        """
        box = projected_box(model, before, T_cam_obj)
        flow = None if box is None else self.flow(before.color, after.color, box.grown(GROWTH))
        if flow is None:
            return T_cam_obj
        if mask is None:
            mask = visible_mask(model, before, T_cam_obj, VISIBLE_M)
        matches = lift_matches(before, after, match(before.color, after.color, mask, flow))
        T_b_a = self.relative_pose(matches)
        T = T_cam_obj if T_b_a is None else se3.compose(T_b_a, T_cam_obj)
        points = _depth_points(after, propagate(mask, flow))
        return align(model.surface, model.grid, points, T, GATE_START_M, GATE_END_M, ITERATIONS).T_cam_obj

    def carried(
        self, model: ReferenceModel, mask: Bool, T_cam_obj: Sequence[Float64], frames: Sequence[RgbdFrame]
    ) -> Bool | None:
        """A mask (H, W) in the first of some frames, carried by flow to the last; T_cam_obj: the poses (4, 4)
        in all but the last, which say where to look. None where nothing of it arrives."""
        for T, before, after in zip(T_cam_obj, frames, frames[1:], strict=False):
            box = projected_box(model, before, T)
            flow = None if box is None else self.flow(before.color, after.color, box.grown(GROWTH))
            if flow is None:
                return None
            mask = propagate(mask, flow)
        return mask if mask.any() else None


def _depth_points(frame: RgbdFrame, mask: Bool) -> Float64:
    """About POINTS points (N, 3), camera axes, of the mask's pixels (H, W) that have depth."""
    rows, columns = np.nonzero(mask & (frame.depth > 0))
    step = max(1, -(-len(rows) // POINTS))
    rows, columns = rows[::step], columns[::step]
    pixels = np.stack([columns, rows], 1).astype(np.float64)
    return frame.camera.backproject(pixels, frame.depth[rows, columns])
