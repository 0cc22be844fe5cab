"""One step of the paper's tracker (section III-E, "Pose Tracking").

Optical flow on the object's region > matches confirmed by the carried mask and by colour pairs > lifting to
3D > canonical features > the network's rotation > the translation from the matches > a fixed small number of
point-to-plane iterations. There is no velocity, no search, no colour in the refinement and no probability.

Two things are not in the paper. Matches are also filtered by flow from the second frame back to the first
(`propose.flow`): with frames five apart this reduces the error of the network's rotation from 0.62 to 0.56 of
the motion (`huepose eval ablation`: `flow filtered` and `consistent filtered`, `direct`). And the centroid is
trimmed (`paper.canonical`).

What the paper leaves open, and what is done here:

- A late mask, such as a segmenter's at 5 Hz, is carried by flow to the newest frame and used in the next
  step. Other steps use the object's outline at its last pose, where depth agrees with it. Flow carries the
  mask to the new frame, where it filters matches and selects the depth.
- The region of the flow: the outline's box and one box size more on each side, so that the object may move by
  its own size in the image.
- The network regresses the whole rotation, as the paper's does (`rotation_network`, kind "direct"). A network
  that corrects a closed form, or the closed form alone, can be used instead.
- If the matches give no motion, the refinement starts from the last pose.
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
"""Growth of the region of the flow on each side, in sizes of the object's box."""

VISIBLE_M = 0.015
"""Depth up to this distance from the model's surface belongs to the object."""

GATE_START_M, GATE_END_M, ITERATIONS, POINTS = 0.02, 0.008, 10, 1000
"""ICP: gate in the first and in the last iteration, number of iterations, and approximate number of the
mask's points."""


@dataclass(frozen=True)
class PaperStep:
    """From an object's pose in one frame to its pose in the next.

    relative_pose: from matches to a motion; flow: computes the optical flow.
    """

    relative_pose: RelativePose
    flow: optical_flow.FlowSource = optical_flow.compute

    @staticmethod
    def of(
        rotation: Rotation = "direct",
        model: Path | None = None,
        flow: optical_flow.FlowSource = optical_flow.compute,
    ) -> PaperStep:
        """With a network for the rotation (from the file `model`, else the one in the package), or with the
        closed form alone. Raises InputError for a file that is no such network."""
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
        `before`, if a segmenter gave them. If the object is out of view, the pose is returned unchanged."""
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
        in all but the last, which give the region of the flow. None if nothing of the mask is left."""
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
