"""Which object a surface belongs to: not to a larger one around the right one, but to a thin one on top."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.geometry.mesh import Mesh
from huepose.judge.open_region import PreparedSurface
from huepose.tracking.competition import Claim, losers

FRONT_M, DEEP_M, HIGH_M = 0.275, 0.15, 0.06
"""Where the near face of the tea box is; its extents along z and y, object axes."""


def scaled(surface: PreparedSurface, by: float) -> PreparedSurface:
    """The surface of the same object in another size."""
    arrays = surface.arrays._replace(
        points=(surface.arrays.points * by).astype(np.float32), centre=surface.arrays.centre * by
    )
    return replace(surface, arrays=arrays, diameter_m=surface.diameter_m * by, radius_m=surface.radius_m * by)


def facing(surface: PreparedSurface, thick_m: float, front_m: float, R: np.ndarray) -> np.ndarray:
    """The pose T_cam_obj (4, 4) with the rotation R (3, 3) and the near face at distance front_m."""
    middle = np.array([0.0, 0.0, front_m + thick_m / 2])
    return se3.make(R, middle - R @ surface.arrays.centre)


@pytest.mark.parametrize("by", [1.1, 1.3])
@pytest.mark.parametrize("pixels", [1, 4])
def test_a_larger_object_around_the_right_one_loses_in_an_image_of_any_size(
    tea_box, shoot, by, pixels
) -> None:
    small = PreparedSurface.of(tea_box)
    large = scaled(small, by)
    T = facing(small, DEEP_M, FRONT_M, np.eye(3))
    around = facing(large, by * DEEP_M, FRONT_M, np.eye(3))
    frame = shoot([(tea_box.mesh, T)])
    depth = np.repeat(np.repeat(frame.depth, pixels, axis=0), pixels, axis=1)
    claims = [Claim(large, around, 0.8), Claim(small, T, 1.4)]
    assert losers(claims, depth, frame.camera.scaled(pixels)) == [0]


def test_a_thin_object_on_another_keeps_its_surface(tea_box, shoot) -> None:
    box, by = PreparedSurface.of(tea_box), 0.2
    thing = scaled(box, by)
    flat = se3.rotation_exp(np.array([np.pi / 2, 0.0, 0.0]))
    under = facing(box, DEEP_M, FRONT_M, np.eye(3))
    above = facing(thing, by * HIGH_M, FRONT_M - by * HIGH_M, flat)
    mesh = tea_box.mesh
    small = Mesh((mesh.vertices * by).astype(np.float32), mesh.faces, mesh.uv, mesh.texture)
    frame = shoot([(mesh, under), (small, above)])
    assert losers([Claim(box, under, 1.4), Claim(thing, above, 0.8)], frame.depth, frame.camera) == []
    # If the thin object is not there, its pose claims the box's surface.
    assert losers(
        [Claim(box, under, 1.4), Claim(thing, above, 0.8)],
        shoot([(mesh, under)]).depth,
        frame.camera,
    ) == [1]
