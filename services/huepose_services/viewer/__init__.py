"""The viewer: what the pipeline sees and believes, for people. A reader like any other, in its own process."""

from huepose_services.viewer.work import make

__all__ = ["make"]
