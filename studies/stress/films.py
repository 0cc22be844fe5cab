"""Rendered films of one object for some seconds, kept on disk, and recorded sequences in the same form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from huepose.datasets.fast_ycb import FastYcbSequence, object_of
from huepose.geometry import RgbdFrame, se3
from huepose.geometry.arrays import Float64, Rng
from huepose.model import ReferenceModel
from huepose.scenes.camera import COLOR, RATE_HZ, STEREO
from huepose.scenes.carried import FRAMES, staged
from huepose.scenes.frame import Shot, Stage, shoot
from huepose.scenes.loop_file import kept_loop
from huepose.support.errors import InputError
from studies.stress.objects import look_alike

VERSION = 1  # increase it if any pixel changes
AWAY = se3.make(np.eye(3), np.array([0.0, 0.0, -2.0]))
"""Behind the camera."""

ASIDE_M = 0.9
AWAY_AT = {"leaves": (FRAMES, 22, 36, 8), "put away": (120, 50, 70, 36)}
"""Films in which the object leaves the image and comes back: number of frames, the frames between which it is
away, and the number of frames for the distance ASIDE_M: thrown at 5 m/s, or carried at 1.1 m/s."""

SWAPPED = 30
"""From this frame on the look-alike is in the object's place."""

RESTS, LIFTED, SLIDES_M_S = 18, 32, 0.15
"""The object slides on the plain ground up to the first frame, and is carried from the second on; its speed
while it slides."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A frame with its truth: the object's T_cam_obj (4, 4), and its visible share, 0..1."""

    frame: RgbdFrame
    T_cam_obj: Float64
    visib_fract: float


@dataclass(frozen=True, eq=False)
class Film:
    """Frames of one object with the truth. kind: "carried", "swapped", "plain", "recorded", or a key of
    AWAY_AT; others (K, 4, 4): poses T_cam_mesh of the static things around it."""

    name: str
    kind: str
    object: str
    frames: tuple[Seen, ...]
    others: Float64


def rendered(
    cache: Path,
    kind: str,
    model: ReferenceModel,
    models: Mapping[str, ReferenceModel],
    seed: int,
    number: int,
) -> Film | None:
    """Film `number` of a seed, from disk if it was rendered before; None if the object has no look-alike."""
    rng = np.random.default_rng([seed, number])
    stage = _stage(kind, model, [m for m in models.values() if m is not model], rng)
    if stage is None:
        return None
    name = f"{seed}-{number:03d}-{kind}-{model.name}"
    path = cache / f"{name}-{VERSION}.loop"
    sensor, first = STEREO if number % 2 == 1 else None, seed * 1000 + number
    shots = (shoot(stage, i, first, COLOR, sensor) for i in range(_frames(kind)))
    loop, rows = kept_loop(path, lambda: map(Shot.kept, shots))
    frames = []
    for i, row in enumerate(rows):
        frame = RgbdFrame(loop.color(i), loop.depth(i), stage.camera, i, round(i * 1e9 / RATE_HZ), 1)
        frames.append(Seen(frame, np.array(row["T_cam_obj"][0]), row["visib_fract"][0]))
    others = [stage.T_room_mesh[k, 0] for k in range(2, len(stage.meshes))]
    return Film(name, kind, model.name, tuple(frames), np.array(others).reshape(-1, 4, 4))


def recorded(path: Path, models: Mapping[str, ReferenceModel]) -> Film:
    """A sequence in Fast-YCB's layout; its object counts as completely visible."""
    model = models[object_of(path)]
    offset = np.zeros(3) if model.frame_offset_m is None else model.frame_offset_m
    sequence, frames = FastYcbSequence(path, offset), []
    for k, i in enumerate(sequence.image_ids):
        T = sequence.truths(i)[0].T_cam_obj
        if T is None:
            raise InputError(path, found=f"no pose in frame {i}", expected="a label in every frame")
        frames.append(Seen(replace(sequence.frame(i), frame_id=k, epoch=1), T, 1.0))
    return Film(path.name, "recorded", model.name, tuple(frames), np.zeros((0, 4, 4)))


def _stage(kind: str, model: ReferenceModel, others: list[ReferenceModel], rng: Rng) -> Stage | None:
    stage = staged(model.mesh, [other.mesh for other in others], rng, _frames(kind))
    path = stage.T_room_mesh[0].copy()
    if kind in AWAY_AT:
        return _moved(stage, _leaving(path, model.mesh.centre, *AWAY_AT[kind][1:], rng))
    if kind == "swapped":
        other = look_alike(model.mesh)
        if other is None:
            return None
        coming = path.copy()
        coming[:SWAPPED], path[SWAPPED:] = AWAY, AWAY
        all_paths = np.concatenate([path[None], stage.T_room_mesh[1:], coming[None]])
        return replace(stage, meshes=(*stage.meshes, other), T_room_mesh=all_paths)
    if kind == "plain":
        ground = stage.meshes[1]
        plain = np.full((64, 64, 3), rng.integers(90, 256, 3), np.uint8)
        bare = replace(ground, texture=plain)
        stage = replace(stage, meshes=(stage.meshes[0], bare, *stage.meshes[2:]))
        return _moved(stage, _lifted(path, model, stage.T_room_mesh[1, 0], rng))
    return stage


def smooth(frames: int, begin: int, end: int, ramp: int) -> Float64:
    """0, rising to 1 within `ramp` frames before `begin`, and back to 0 after `end`."""
    k = np.arange(frames)
    s = np.clip(np.minimum((k - begin + ramp) / ramp, (end + ramp - k) / ramp), 0.0, 1.0)
    return np.asarray(s * s * (3 - 2 * s))


def _moved(stage: Stage, path: Float64) -> Stage:
    return replace(stage, T_room_mesh=np.concatenate([path[None], stage.T_room_mesh[1:]]))


def _frames(kind: str) -> int:
    return AWAY_AT[kind][0] if kind in AWAY_AT else FRAMES


def _leaving(path: Float64, centre_obj: Float64, left: int, back: int, ramp: int, rng: Rng) -> Float64:
    """The object leaves the image on one side and comes back from the other with another rotation."""
    frames = np.arange(len(path))
    away, middle = smooth(len(path), left, back, ramp), (left + back) // 2
    out, R_away = path.copy(), se3.rotation_exp(rng.normal(0, 1.0, 3))
    centres = path[:, :3, :3] @ centre_obj + path[:, :3, 3]
    centres[:, 0] += ASIDE_M * away * np.where(frames < middle, -1.0, 1.0)
    out[middle:, :3, :3] = out[middle:, :3, :3] @ R_away
    out[:, :3, 3] = centres - out[:, :3, :3] @ centre_obj
    return out


def _lifted(path: Float64, model: ReferenceModel, T_room_ground: Float64, rng: Rng) -> Float64:
    """The object slides on the ground with one face up, and is then picked up and carried away."""
    up, mesh = T_room_ground[:3, 2], model.mesh
    up = up if up[2] < 0 else -up
    axis, sign = int(rng.integers(3)), float(rng.choice([-1.0, 1.0]))
    side = np.zeros(3)
    side[axis] = sign
    x = np.cross(up, rng.normal(0, 1, 3))
    x /= np.linalg.norm(x)
    frame_room = np.stack([x, np.cross(up, x), up], -1)
    first = np.eye(3)[(axis + 1) % 3]
    second = np.cross(side, first)
    R = frame_room @ np.stack([first, second, side])
    height = float(-(mesh.vertices @ side).min())
    start = path[0, :3, :3] @ mesh.centre + path[0, :3, 3]
    ray = start / start[2]
    foot = ray * float(up @ T_room_ground[:3, 3]) / float(up @ ray)
    out = path.copy()
    for k in range(len(path)):
        centre = foot + x * SLIDES_M_S * (k - RESTS / 2) / RATE_HZ + up * (height + float(mesh.centre @ side))
        resting = se3.make(R, centre - R @ mesh.centre)
        share = float(np.clip((k - RESTS) / (LIFTED - RESTS), 0.0, 1.0))
        out[k] = se3.interpolate(resting, path[k], share * share * (3 - 2 * share))
    return out
