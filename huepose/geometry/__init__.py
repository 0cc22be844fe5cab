"""SE(3), cameras, the RGB-D frame, meshes, boxes, rigid registration, symmetries."""

from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.mesh import Mesh

__all__ = ["Box", "Camera", "Mesh", "RgbdFrame"]
