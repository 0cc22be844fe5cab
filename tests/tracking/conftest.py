"""Plain objects, functions that render frames of moving objects, and a tracker that has started."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from huepose.geometry import Camera, Mesh, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render
from huepose.tracking import Correction, TrackedPose, Tracker, Verdict
from studies.stress.objects import builtin_meshes
from tests.onboarded import onboarded

CAMERA = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)
PERIOD_NS = 33_333_333

Scene = Sequence[tuple[Mesh, np.ndarray]]
Shoot = Callable[..., RgbdFrame]


@pytest.fixture(scope="session")
def plain_box() -> ReferenceModel:
    """A box of one colour, with a sticker on a side that is out of view when it lies."""
    return onboarded(builtin_meshes(0)["plain_box"], "plain_box", plain=True)


@pytest.fixture(scope="session")
def half_plain_can() -> ReferenceModel:
    """A can with a label on one half and lids; the other half is of one colour."""
    return onboarded(builtin_meshes(0)["half_plain_can"], "half_plain_can")


@pytest.fixture(scope="session")
def plain_bracket() -> ReferenceModel:
    """A bracket of one colour; only its shape shows its orientation."""
    return onboarded(builtin_meshes(0)["plain_bracket"], "plain_bracket", plain=True)


@pytest.fixture(scope="session")
def backdrop() -> RgbdFrame:
    """A wall of coloured tiles 1.1 m away."""
    rng = np.random.default_rng(4)
    tiles = rng.integers(40, 200, (15, 20, 3)).astype(np.uint8)
    color = np.repeat(np.repeat(tiles, 16, 0), 16, 1)
    return RgbdFrame(np.ascontiguousarray(color), np.full((240, 320), 1.1, np.float32), CAMERA)


@pytest.fixture(scope="session")
def board() -> tuple[Mesh, np.ndarray]:
    """A grey board of 0.4 m, 0.3 m in front of the camera, and its pose T_cam_mesh."""
    corners = np.array([[-0.2, -0.2, 0], [0.2, -0.2, 0], [0.2, 0.2, 0], [-0.2, 0.2, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)[faces]
    grey = np.full((4, 4, 3), 90, np.uint8)
    return Mesh(corners, faces, uv, grey), se3.make(np.eye(3), np.array([0.0, 0.0, 0.3]))


@pytest.fixture(scope="session")
def shoot(backdrop: RgbdFrame) -> Shoot:
    """A function of [(mesh, T_cam_obj), ...] and a frame number: the 30 Hz frame of these objects in front of
    the wall, with camera noise."""

    def take(
        scene: Scene,
        number: int = 0,
        light: tuple[float, float, float] = (1.0, 1.0, 1.0),
        noise: float = 2.0,
        epoch: int = 1,
    ) -> RgbdFrame:
        rendered = render(scene, CAMERA) if scene else None
        color, depth = backdrop.color.astype(np.float64), backdrop.depth.copy()
        if rendered is not None:
            visible = rendered.depth > 0
            color = np.where(visible[..., None], rendered.color, color)
            depth = np.where(visible, rendered.depth, depth)
        rng = np.random.default_rng([7, number])
        noisy = rng.normal(0.0, noise, color.shape)  # thousands of frames: in place
        noisy += color if light == (1.0, 1.0, 1.0) else color * np.array(light)
        depth = depth + rng.normal(0.0, 0.0004, depth.shape) * depth
        return RgbdFrame(
            np.clip(np.round(noisy, out=noisy), 0, 255, out=noisy).astype(np.uint8),
            depth.astype(np.float32),
            CAMERA,
            number,
            number * PERIOD_NS,
            epoch,
        )

    return take


@pytest.fixture(scope="session")
def path() -> Callable[[int], np.ndarray]:
    """The pose T_cam_obj of an object that is carried and rotated: 0.25 m/s and 80 degrees per second."""

    def at(number: float) -> np.ndarray:
        t = number / 30.0
        turn = se3.rotation_exp(np.array([0.5, 1.1, 0.7]) * t) @ se3.rotation_exp(np.array([1.9, 0.3, 0.4]))
        place = np.array([0.06 * np.sin(3.0 * t), 0.03 * np.sin(5.0 * t), 0.52 + 0.04 * np.sin(4.0 * t)])
        return se3.make(turn, place)

    return at


@pytest.fixture
def film(tea_box, shoot, path):
    """A function: the first `count` frames of the carried box, every `step`-th."""

    def make(count: int, step: int = 1, first: int = 0) -> list[RgbdFrame]:
        return [shoot([(tea_box.mesh, path(k))], k) for k in range(first, first + count, step)]

    return make


@pytest.fixture
def started(tea_box, film, path):
    """A tracker that has tracked the box for six frames."""
    tracker = Tracker({"tea_box": tea_box})
    for k, frame in enumerate(film(6)):
        if k == 0:
            tracker.correct(correction(frame, path(0)))
        tracker.step(frame)
    return tracker


def correction(
    frame: RgbdFrame,
    T: np.ndarray,
    seq: int = 1,
    verdict: Verdict = Verdict.ACQUIRE,
    quality: float = 0.99,
    name: str = "tea_box",
    instance: int = 0,
) -> Correction:
    return Correction(name, instance, frame.epoch, frame.frame_id, frame.stamp_ns, T, quality, verdict, seq)


def errors(pose: TrackedPose, truth: np.ndarray) -> tuple[float, float]:
    """Millimetres and degrees."""
    assert pose.T_cam_obj is not None
    mm = 1e3 * float(np.linalg.norm(pose.T_cam_obj[:3, 3] - truth[:3, 3]))
    return mm, float(np.degrees(se3.rotation_angle(pose.T_cam_obj, truth)))
