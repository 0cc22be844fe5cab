"""Reference models and rendered frames of them, shared by the tests of several rooms."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from huepose.geometry import Camera, Mesh, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render
from tests import onboarded
from tests.meshes import demo_objects

CAMERA = Camera(600.0, 605.0, 318.5, 241.0, 640, 480)

TakePicture = Callable[..., RgbdFrame]


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With `-m live`, skip files without such tests: importing all files takes ten seconds."""
    is_tests = collection_path.name.startswith("test_") and collection_path.suffix == ".py"
    only_live = config.getoption("markexpr").startswith("live") and is_tests
    return True if only_live and "pytest.mark.live" not in collection_path.read_text() else None


@pytest.fixture(scope="session", autouse=True)
def _shelf(tmp_path_factory: pytest.TempPathFactory) -> None:
    own, given = tmp_path_factory.getbasetemp(), os.environ.get("TEST_SHELF")
    ours = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    onboarded.shelf = Path(given) if given else ours / "shelf"


@pytest.fixture(scope="session")
def tea_box() -> ReferenceModel:
    """A printed box of 9 x 6 x 15 cm, with the tables of the paper's method."""
    return onboarded.onboarded(demo_objects(0)["tea_box"], "tea_box", paper=True)


@pytest.fixture(scope="session")
def soup_can() -> ReferenceModel:
    """A printed can of 7.4 cm across and 11 cm tall."""
    return onboarded.onboarded(demo_objects(0)["soup_can"], "soup_can")


@pytest.fixture(scope="session")
def box_and_can(tea_box: ReferenceModel, soup_can: ReferenceModel) -> dict[str, ReferenceModel]:
    """Two models: the tea box and the can."""
    return {"tea_box": tea_box, "soup_can": soup_can}


@pytest.fixture(scope="session")
def larger_box(box_and_can: dict[str, ReferenceModel], take_picture: TakePicture) -> TakePicture:
    """A function of a scale: a frame of the tea box at this scale beside a can of the right size."""

    def take(times: float) -> RgbdFrame:
        box, can = (box_and_can[name].mesh for name in ("tea_box", "soup_can"))
        box = replace(box, vertices=(box.vertices * times).astype(np.float32))
        return take_picture([(box, standing_pose(0.6, -0.12, 0.0)), (can, standing_pose(0.4, 0.12, 0.0))])

    return take


@pytest.fixture(scope="session")
def take_picture() -> TakePicture:
    """A function of [(mesh, T_cam_obj), ...] and `light` (3,): the frame of a camera that looks down at these
    objects on a wooden table. `light` multiplies the colour channels."""
    table, T_cam_table = table_top()

    def take(
        scene: list[tuple[Mesh, np.ndarray]],
        light: tuple[float, float, float] = (1.0, 1.0, 1.0),
        with_table: bool = True,
        frame_id: int = 0,
    ) -> RgbdFrame:
        things = [(table, T_cam_table), *scene] if with_table else scene
        picture = render(things, CAMERA)
        color = np.clip(np.round(picture.color * np.array(light)), 0, 255).astype(np.uint8)
        return RgbdFrame(color, picture.depth, CAMERA, frame_id)

    return take


@pytest.fixture(scope="session")
def standing() -> np.ndarray:
    """T_cam_obj of the tea box: upright on the table, rotated by 35 degrees, 0.7 m away."""
    return standing_pose(np.radians(35.0), 0.0, 0.0)


@pytest.fixture(scope="session")
def box_frame(tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray) -> RgbdFrame:
    """The frame of the tea box at the pose `standing`. Tests must not write into it."""
    return take_picture([(tea_box.mesh, standing)])


def standing_pose(yaw: float, x: float, y: float) -> np.ndarray:
    """T_cam_obj of the tea box: upright at (x, y) on the table."""
    up = 0.075
    on_table = se3.make(se3.rotation_exp(np.array([0.0, 0.0, yaw])), np.array([x, y, up]))
    return se3.compose(table_top()[1], on_table)


def table_top() -> tuple[Mesh, np.ndarray]:
    """A wooden table top of 1.2 m, z up, and its T_cam_table. The camera looks down by 35 degrees."""
    rng = np.random.default_rng(5)
    grain = np.cumsum(rng.normal(0, 3, (64, 256)), axis=0)
    grain = 120 + 25 * (grain - grain.mean()) / grain.std()
    texture = np.clip(grain[..., None] * np.array([1.1, 0.9, 0.65]), 0, 255).astype(np.uint8)
    corners = np.array([[-0.6, -0.6, 0], [0.6, -0.6, 0], [0.6, 0.6, 0], [-0.6, 0.6, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)[faces]
    look_down = se3.rotation_exp(np.array([np.radians(90.0 + 35.0), 0.0, 0.0]))
    return Mesh(corners, faces, uv, texture), se3.make(look_down, np.array([0.0, 0.03, 0.7]))
