"""Which objects have room in the rendered scene; they rotate about their own centres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Mesh, se3
from huepose.scenes.builtin import check_scene
from huepose.scenes.camera import CAMERA
from huepose.scenes.motion import FARTHEST_M, NEAREST_M
from huepose.scenes.plan import plan
from huepose.support.errors import InputError
from tests.meshes import demo_objects

BOX = demo_objects(0)["tea_box"]


def sized(diameter_m: float, cornered: bool = False) -> Mesh:
    """The tea box scaled to this diameter, its origin in the middle or in a corner."""
    vertices = BOX.vertices * (diameter_m / np.linalg.norm(np.ptp(BOX.vertices, axis=0)))
    return replace(BOX, vertices=vertices - vertices.min(0) if cornered else vertices)


def test_objects_of_usual_sizes_have_room_wherever_their_origins_are() -> None:
    """Fewer of them have room where these do: they are placed one after the other."""
    three = {"small": sized(0.12), "middle": sized(0.2), "large": sized(0.26, cornered=True)}
    check_scene(three | {"fourth": sized(0.24, cornered=True), "fifth": sized(0.26)})


@pytest.fixture
def first_draft(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use the first draft of a plan instead of the best of twelve; the tests hold for every draft."""
    monkeypatch.setattr("huepose.scenes.plan._ATTEMPTS", 1)


@pytest.mark.usefixtures("first_draft")
def test_an_object_with_its_origin_in_a_corner_moves_about_its_middle() -> None:
    objects = {f"box{k}": sized(0.26, cornered=True) for k in range(3)}
    stage = plan(objects, 0, 60, CAMERA)
    for k, mesh in enumerate(objects.values()):
        middle = np.append(np.ptp(mesh.vertices, axis=0) / 2, 1.0)
        depth_m = (stage.T_room_mesh[k] @ middle)[:, 2]
        assert (depth_m > NEAREST_M).all()
        assert (depth_m < FARTHEST_M).all()


@pytest.mark.usefixtures("first_draft")
def test_motion_between_frames_does_not_depend_on_the_origin() -> None:
    """Between two frames, an origin 42 m away moves on an arc, some millimetres off a straight line."""
    near, away = sized(0.2), np.array([25.0, 33.75, 0.0])
    far = replace(near, vertices=(near.vertices.astype(np.float64) + away).astype(np.float32))
    stages = [plan({"box": mesh}, 0, 60, CAMERA) for mesh in (near, far)]
    for i in range(60):
        (T_near, *_), (T_far, *_) = (stage.poses(i, -0.25)[0] for stage in stages)
        np.testing.assert_allclose(se3.apply(T_far, away), T_near[:3, 3], atol=2e-5)


def test_the_check_gives_the_same_error_as_the_plan() -> None:
    huge = {"huge": sized(1.2)}
    with pytest.raises(InputError, match=r"1 objects of 120 to 120 cm") as of_plan:
        plan(huge, 0, 30, CAMERA)
    with pytest.raises(InputError) as of_check:
        check_scene(huge)
    assert str(of_check.value) == str(of_plan.value)
