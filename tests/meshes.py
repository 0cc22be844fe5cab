"""The meshes of the built-in objects. They are drawn once in a process, which takes a second."""

from __future__ import annotations

from functools import cache

from huepose.geometry import Mesh
from huepose.scenes import shapes


@cache
def demo_objects(seed: int) -> dict[str, Mesh]:
    """Those of `shapes.demo_objects`. Tests must not change them."""
    return shapes.demo_objects(seed)
