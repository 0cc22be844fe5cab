"""Tracking: flow, correspondences, relative pose, refinement, history, state."""

from huepose.tracking.config import TrackerConfig
from huepose.tracking.tracker import Tracker
from huepose.tracking.types import Applied, Correction, State, TrackedPose, Verdict

__all__ = ["Applied", "Correction", "State", "TrackedPose", "Tracker", "TrackerConfig", "Verdict"]
