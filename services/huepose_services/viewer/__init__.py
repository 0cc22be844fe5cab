"""The viewer: what the pipeline sees and believes, for people. One more reader, in a process of its own."""

from huepose_services.viewer.work import make

__all__ = ["make"]
