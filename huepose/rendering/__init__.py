"""Mesh to depth, colour, surface coordinates and normals; small and fast."""

from huepose.rendering.render import Rendering, render, render_depth

__all__ = ["Rendering", "render", "render_depth"]
