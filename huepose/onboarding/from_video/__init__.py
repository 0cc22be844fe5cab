"""A mesh of an object from an RGB-D recording in which it is turned before a camera."""

from huepose.onboarding.from_video.learn import Learned, learn
from huepose.onboarding.from_video.selection import Selection

__all__ = ["Learned", "Selection", "learn"]
