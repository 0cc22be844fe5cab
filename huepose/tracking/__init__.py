"""Tracking: proposals, refinement, history, state."""

from typing import TYPE_CHECKING

from huepose.support.deferred import deferred

if TYPE_CHECKING:
    from huepose.tracking.config import TrackerConfig
    from huepose.tracking.tracker import Tracker
    from huepose.tracking.types import Applied, Correction, TrackedPose, Verdict

__all__ = ["Applied", "Correction", "TrackedPose", "Tracker", "TrackerConfig", "Verdict"]

__getattr__ = deferred(
    __name__,
    {
        "TrackerConfig": "huepose.tracking.config",
        "Tracker": "huepose.tracking.tracker",
        **dict.fromkeys(("Applied", "Correction", "TrackedPose", "Verdict"), "huepose.tracking.types"),
    },
)
