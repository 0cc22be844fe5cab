"""A mesh of an object from an RGB-D recording in which it rotates in front of the camera."""

from huepose.onboarding.from_video.learn import Learned, learn
from huepose.onboarding.from_video.selection import Selection

__all__ = ["Learned", "Selection", "learn"]
