"""From a script to the frames that a camera delivers of it, kept on disk because drawing takes its time."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from huepose.geometry import RgbdFrame, se3
from huepose.geometry.arrays import Float32, Float64, UInt8
from huepose.scenes.frame import Shot, Stage, shoot
from huepose.scenes.loop_file import kept_loop
from huepose.scenes.sensor import COLOR, STEREO, gaussian
from huepose.support.progress import progress
from studies.hard_moments.scripts import RATE_HZ, Script

VERSION = 1  # raise it when any pixel changes
BLUR_SHOTS = 5
HOLES = 0.6
HOLE_PX = 4.0


@dataclass(frozen=True, eq=False)
class Seen:
    """A frame and the truth in it: T_cam_obj (K, 4, 4) and visib_fract (K,) of the script's objects."""

    frame: RgbdFrame
    T_cam_obj: Float64
    visib_fract: Float64


def kept_row(shot: Shot) -> tuple[UInt8, Float32, dict[str, Any]]:
    """A frame and its truth as they are kept in a loop."""
    truth = {"T_cam_obj": shot.labels.T_cam_obj.tolist(), "visib_fract": shot.labels.visib_fract.tolist()}
    return shot.color, shot.depth, truth


class Shown(Protocol):
    """Anything that can be played: the objects that it shows (a name stands there once per instance), and its
    frames in order."""

    @property
    def objects(self) -> tuple[str, ...]:
        """Names."""
        ...

    def __iter__(self) -> Iterator[Seen]:
        """Frames."""
        ...


class Film:
    """The frames of a script, drawn at first use and kept in a folder."""

    def __init__(self, script: Script, cache: Path) -> None:
        self.script = script
        self.path = cache / f"{script.name.replace(' ', '-').replace(',', '')}-{_key(script)}.loop"
        self._loop, self._rows = kept_loop(self.path, self._drawn, {"name": script.name})

    def __len__(self) -> int:
        return len(self.script.shown)

    @property
    def objects(self) -> tuple[str, ...]:
        """The script's."""
        return self.script.objects

    def __iter__(self) -> Iterator[Seen]:
        camera = self.script.stage.camera
        for number, (k, slot) in enumerate(zip(self.script.shown, self.script.slots, strict=True)):
            stamp_ns = round(slot * 1e9 / RATE_HZ)
            frame = RgbdFrame(self._loop.color(k), self._loop.depth(k), camera, number, stamp_ns, 1)
            row = self._rows[k]
            yield Seen(frame, np.array(row["T_cam_obj"]), np.array(row["visib_fract"]))

    def _drawn(self) -> Iterator[tuple[np.ndarray, np.ndarray, dict[str, Any]]]:
        for k in progress(range(len(self.script.stage) - 1), f"drawing {self.script.name}"):
            yield kept_row(draw(self.script, k))


def draw(script: Script, k: int) -> Shot:
    """Frame k of a script's stage with the camera's faults that the script asks for."""
    shot = shoot(script.stage, k, 0, COLOR, STEREO)
    color, depth = shot.color, shot.depth
    if len(script.blurred) and script.blurred[k]:
        color = _smeared(script.stage, k)
    if len(script.holes) and script.holes[k]:
        depth = _with_holes(depth, k)
    if script.nearest_m > 0.0:
        depth = np.where(depth < script.nearest_m, np.float32(0.0), depth)
    return replace(shot, color=color, depth=depth)


def _smeared(stage: Stage, k: int) -> np.ndarray:
    """The picture (H, W, 3) uint8 of a shutter that is open all the time: the mean, in linear light, of
    pictures taken within the frame's time."""
    total: Float32 = np.zeros((stage.camera.height, stage.camera.width, 3), np.float32)
    for part in (np.arange(BLUR_SHOTS) + 0.5) / BLUR_SHOTS - 0.5:
        moved, T_cam_room = stage.poses(k, float(part))
        poses = np.repeat(np.array(moved)[:, None], 2, 1)
        instant = Stage(
            stage.meshes,
            stage.labelled,
            poses,
            np.repeat(T_cam_room[None], 2, 0),
            (stage.lights[k],) * 2,
            stage.camera,
        )
        color = shoot(instant, 0, int(1000 * (part + 1)), COLOR, None).color
        total += (color.astype(np.float32) / 255.0) ** 2.2
    return np.asarray(np.rint(255.0 * (total / BLUR_SHOTS) ** (1 / 2.2)), np.uint8)


def _with_holes(depth: Float32, k: int) -> Float32:
    """Depth (H, W) without the darkest HOLES of a blotchy field."""
    field = cv2.GaussianBlur(gaussian(np.random.default_rng([k, 60]), depth.shape), (0, 0), HOLE_PX)
    return np.where(field < np.quantile(field, HOLES), np.float32(0.0), depth)


def _key(script: Script) -> str:
    """Changes with whatever the pictures show."""
    stage = script.stage
    digest = hashlib.sha256(f"{VERSION} {stage.camera} {script.nearest_m}".encode())
    for array in (stage.T_room_mesh, stage.T_cam_room, script.holes, script.blurred):
        digest.update(np.round(array.astype(np.float64), 9).tobytes())
    for mesh in stage.meshes:
        digest.update(np.ascontiguousarray(mesh.vertices).tobytes() + mesh.texture.tobytes())
    for light in stage.lights:
        digest.update(
            np.round(np.array([*light.towards_room, light.key, light.sky, *light.gain]), 9).tobytes()
        )
    return digest.hexdigest()[:12]


def noisy(T_cam_obj: Float64, rng: np.random.Generator, shift_m: float, turn_rad: float) -> Float64:
    """A pose with normal errors of that RMS per axis, as a good single-frame estimate has them."""
    return se3.perturb(T_cam_obj, np.concatenate([rng.normal(0, shift_m, 3), rng.normal(0, turn_rad, 3)]))
