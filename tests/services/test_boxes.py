"""Outlines of known objects in an image."""

import numpy as np
import pytest

from huepose.geometry import Camera, se3
from huepose_services.models import Outline

CAMERA = Camera(600.0, 600.0, 319.5, 239.5, 640, 480)
CUBE = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)], np.float32)


@pytest.mark.parametrize("z", [-0.8, 0.0])
def test_an_object_behind_the_camera_has_no_outline(z):
    assert Outline(CUBE, 0.1732).box(se3.make(np.eye(3), np.array([0.0, 0.0, z])), CAMERA) is None
