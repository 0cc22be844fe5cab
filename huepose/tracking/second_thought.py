"""After a leap: the pose that was left behind is followed as well, until the image decides between the two.

A turn within one frame that no hand makes is not a motion. Either the object was taken for another side of
itself before, or it is now: on a pen seen end-on hardly anything tells. So neither is believed alone: both
are refined in every frame, and what one explains more than the other is added up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.tracking.config import TrackerConfig
from huepose.tracking.motion import predicted
from huepose.tracking.scoring import Tint
from huepose.tracking.step import LONG_STEP_S, Anchor, Step, best_of
from huepose.tracking.surface import TrackedSurface

SLACK_RAD = np.radians(10.0)

DECIDED = 0.3
"""Sum of score differences that decides; one frame's counts up to MOST."""

MOST = 0.2
SAME = 0.05
"""Poses whose surfaces lie this share of the diameter apart are one pose, and no leap lies between them."""

POINTS = 48


def leapt(
    surface: TrackedSurface, T_before: Float64, T_after: Float64, seconds: float, config: TrackerConfig
) -> bool:
    """Whether an object would have turned faster than anything is carried. After a gap everything may be."""
    if seconds > LONG_STEP_S:
        return False
    fastest = SLACK_RAD + config.max_search_rad_s * seconds
    turned = se3.rotation_angle(T_before, T_after) > fastest
    return bool(turned) and not _same(surface, T_before, T_after)


def _same(surface: TrackedSurface, T_a: Float64, T_b: Float64) -> bool:
    points = surface.arrays.points[:POINTS].astype(np.float64)
    apart = np.linalg.norm(se3.apply(T_a, points) - se3.apply(T_b, points), axis=1).mean()
    return bool(apart < SAME * surface.diameter_m)


@dataclass(frozen=True, eq=False)
class SecondThought:
    """A pose that was left by a leap, carried on; velocity (6,) that it had; lead: by how much the pose that
    is published has explained more since."""

    T_cam_obj: Float64
    velocity: Float64 | None
    lead: float = 0.0

    @staticmethod
    def left_behind(anchor: Anchor, step: Step, seconds: float) -> SecondThought:
        """What would be believed if a leap had not been made: where a start near by had led, or the
        prediction."""
        T = (
            predicted(anchor.T_cam_obj, anchor.velocity, seconds)
            if step.near is None
            else step.near.T_cam_obj
        )
        return SecondThought(T, anchor.velocity)

    def followed(
        self, surface: TrackedSurface, frame: RgbdFrame, seconds: float, tint: Tint, published: Step
    ) -> tuple[SecondThought, Step]:
        """It in the next frame, after weighing it against what is published there; and how it stands
        there."""
        starts = [(self.T_cam_obj, "second thought")]
        if self.velocity is not None:
            starts.append((predicted(self.T_cam_obj, self.velocity, seconds), "second thought"))
        own = best_of(surface, frame, starts, tint)
        difference = published.fit.total - own.fit.total
        lead = self.lead + float(np.clip(difference, -MOST, MOST))
        if _same(surface, own.T_cam_obj, published.T_cam_obj):
            lead = DECIDED
        return replace(self, T_cam_obj=own.T_cam_obj, lead=lead), own

    @property
    def refuted(self) -> bool:
        """Whether the published pose is the right one of the two."""
        return self.lead >= DECIDED

    @property
    def borne_out(self) -> bool:
        """Whether this one is."""
        return self.lead <= -DECIDED
