"""What happens in each hard moment: who is where, in what light, and which pictures are dropped or spoilt.

A script is a stage of the synthetic camera (`huepose.scenes.frame`) with a list of what is shown of it
when. All begin with a second in which nothing is hard and end with one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Bool, Float64
from huepose.scenes import textures
from huepose.scenes.charts import blocks
from huepose.scenes.frame import Stage
from huepose.scenes.light import Light, random_light
from huepose.scenes.room import room
from huepose.scenes.shapes import demo_objects, printed

CAMERA = Camera(500.0, 500.0, 199.5, 149.5, 400, 300)
RATE_HZ = 30.0
SECOND = 30
FRAMES = 5 * SECOND
NEVER: Bool = np.zeros(0, bool)


@dataclass(frozen=True, eq=False)
class Script:
    """stage: its labelled meshes are the objects `objects`; shown, slots (K,): which frame of the stage is
    shown in which thirtieth of a second; holes, blurred (N,) bool or empty: frames of the stage that lose
    60 % of their depth, or are exposed for the whole frame time; nearest_m: no depth under this distance;
    decoys: which other meshes of the stage can be taken for which object: (object, number of the mesh)."""

    name: str
    objects: tuple[str, ...]
    stage: Stage
    shown: tuple[int, ...]
    slots: tuple[int, ...]
    holes: Bool = field(default_factory=lambda: NEVER)
    blurred: Bool = field(default_factory=lambda: NEVER)
    nearest_m: float = 0.0
    decoys: tuple[tuple[str, int], ...] = ()


@lru_cache(maxsize=1)
def meshes() -> Mapping[str, Mesh]:
    """The objects of all moments by name, metres: box, can and bottle."""
    demo = demo_objects(0)
    names = {"box": "tea_box", "can": "soup_can", "bottle": "juice_bottle"}
    return {name: demo[source] for name, source in names.items()}


@lru_cache(maxsize=1)
def _room() -> tuple[tuple[Mesh, Float64], ...]:
    return tuple(room(np.random.default_rng(5), 8))


def carried(frames: int, phase: float = 0.0, place: tuple[float, float, float] = (0.0, 0.0, 0.62)) -> Float64:
    """Poses (N, 4, 4) of an object in a hand: about 0.15 m/s and 70 degrees a second, about a place."""
    out = np.tile(np.eye(4), (frames, 1, 1))
    for k in range(frames):
        t = k / RATE_HZ + phase
        turn = se3.rotation_exp(
            0.9 * np.array([np.sin(1.1 * t), np.sin(0.8 * t + 1.0), np.sin(0.9 * t + 2.0)])
        )
        sway = np.array([0.05 * np.sin(2.1 * t), 0.03 * np.sin(2.9 * t + 0.5), 0.03 * np.sin(1.7 * t)])
        out[k] = se3.make(turn @ se3.rotation_exp(np.array([1.5, 0.0, 0.4])), np.asarray(place) + sway)
    return out


def _stage(
    objects: Mapping[str, Mesh],
    paths: list[Float64],
    lights: list[Light],
    others: list[tuple[Mesh, Float64]],
    views: Float64 | None = None,
) -> Stage:
    """The objects, other moving things, and the room, from a camera at rest or with poses `views` (N, 4, 4),
    T_cam_room. One frame more than is shown: a stage closes."""
    n = len(paths[0])
    views = np.tile(np.eye(4), (n, 1, 1)) if views is None else views
    standing = _room()
    moving = [*paths, *(path for _, path in others)]
    still = [np.broadcast_to(T, (n, 4, 4)) for _, T in standing]
    all_paths = np.array([*moving, *still])
    all_paths = np.concatenate([all_paths, all_paths[:, -1:]], 1)
    return Stage(
        (*objects.values(), *(mesh for mesh, _ in others), *(mesh for mesh, _ in standing)),
        len(objects),
        all_paths,
        np.concatenate([views, views[-1:]]),
        (*lights, lights[-1]),
        CAMERA,
    )


def scripted(name: str, mesh: str, path: Float64, **more: Any) -> Script:
    """A script of one object in even light."""
    n = len(path)
    others = more.pop("others", [])
    lights = more.pop("lights", [random_light(np.random.default_rng(9))] * n)
    views = more.pop("views", None)
    stage = _stage({mesh: meshes()[mesh]}, [path], lights, others, views)
    fields = {"shown": tuple(range(n)), "slots": tuple(range(n)), **more}
    return Script(name, (mesh,), stage, **fields)


def printed_board(width_m: float, height_m: float) -> Mesh:
    """A board of 16 mm."""
    rng = np.random.default_rng(12)
    charts = blocks(
        [-width_m / 2, width_m / 2],
        [-height_m / 2, height_m / 2],
        [-0.008, 0.008],
        np.ones((1, 1, 1), bool),
        0.1,
    )
    return printed(
        charts, [textures.sticker("BOARD", 1)] * len(charts), textures.palette(0.07, rng), rng, 256
    )


def smooth(frames: int, begin: int, end: int, ramp: int = 6) -> Float64:
    """0, rising to 1 within `ramp` frames before `begin`, and back to 0 after `end`."""
    k = np.arange(frames)
    s = np.clip(np.minimum((k - begin + ramp) / ramp, (end + ramp - k) / ramp), 0.0, 1.0)
    return np.asarray(s * s * (3 - 2 * s))


HIDDEN_FROM, SEEN_FROM = 60, 90
"""Frames at which what hides the object has come, and at which it goes."""


def curtain(side_m: float) -> tuple[Mesh, Float64]:
    """A board that hides everything in the middle of the image for a second."""
    share = smooth(FRAMES, HIDDEN_FROM, SEEN_FROM)
    path = np.tile(np.eye(4), (FRAMES, 1, 1))
    path[:, :3, 3] = np.stack([0.45 * (1 - share), np.zeros(FRAMES), np.full(FRAMES, 0.40)], 1)
    return printed_board(side_m, side_m), path


def palm(path: Float64) -> tuple[Mesh, Float64]:
    """Something held against an object on a path (N, 4, 4): it hides 80 % of it for a second, and moves with
    it."""
    share, own = smooth(FRAMES, HIDDEN_FROM, SEEN_FROM), np.tile(np.eye(4), (FRAMES, 1, 1))
    own[:, :3, 3] = path[:, :3, 3] + np.stack([0.02 + 0.3 * (1 - share), 0 * share, -0.1 + 0 * share], 1)
    return printed_board(0.088, 0.2), own


def night(frames: range, gain: tuple[float, float, float]) -> list[Light]:
    """The light of each frame: in these a dim, warm one from the other side."""
    day = random_light(np.random.default_rng(9))
    towards = day.towards_room * np.array([-1.0, 1.0, 1.0])
    dim = replace(day, towards_room=towards, gain=day.gain * np.array(gain))
    return [dim if k in frames else day for k in range(FRAMES)]


def covered() -> Script:
    """A board hides the object wholly for a second; it moves on meanwhile."""
    return scripted("covered for 1 s", "box", carried(FRAMES), others=[curtain(0.24)])


def elsewhere() -> Script:
    """The object leaves the image on one side and returns on the other, turned."""
    path = carried(FRAMES)
    away = smooth(FRAMES, 60, 84, 10)
    side = np.where(np.arange(FRAMES) < 72, -1.0, 1.0)
    path[:, 0, 3] += 0.42 * away * side
    turned = se3.rotation_exp(np.array([0.0, 1.2, 0.0]))
    path[72:, :3, :3] = path[72:, :3, :3] @ turned
    return scripted("leaves, returns elsewhere", "bottle", path)


def hand() -> Script:
    """Something held against the object hides 80 % of it for a second, moving with it."""
    path = carried(FRAMES)
    return scripted("80 % behind a hand for 1 s", "box", path, others=[palm(path)])


def light() -> Script:
    """The light is switched to a dim, warm one from the other side, and back."""
    lights = night(range(60, 105), (0.5, 0.36, 0.24))
    return scripted("light switched twice", "can", carried(FRAMES), lights=lights)


def blur() -> Script:
    """Shaken at up to 1.1 m/s in dim light: exposed for the whole frame time, so smeared over 30 pixels."""
    path = carried(FRAMES)
    shake = smooth(FRAMES, 55, 95, 10) * 0.06 * np.sin(np.arange(FRAMES) / RATE_HZ * 18.0)
    path[:, 0, 3] += shake
    dim = np.zeros(FRAMES + 1, bool)
    dim[45:106] = True
    return scripted("motion blur", "bottle", path, blurred=dim)


def frozen() -> Script:
    """The camera repeats one picture 20 times, and goes on where things are then."""
    shown = tuple(60 if 60 <= k < 80 else k for k in range(FRAMES))
    return scripted("20 identical frames", "box", carried(FRAMES), shown=shown)


def pause() -> Script:
    """No frames for 300 ms."""
    kept = tuple(k for k in range(FRAMES) if not 60 <= k < 69)
    return scripted("300 ms without frames", "can", carried(FRAMES), shown=kept, slots=kept)


def crossing() -> Script:
    """Two identical boxes cross, one behind the other, and come back."""
    t = np.arange(FRAMES) / FRAMES
    a, b = carried(FRAMES, 0.0, (0.0, 0.0, 0.58)), carried(FRAMES, 2.0, (0.0, 0.01, 0.78))
    swing = 0.13 * np.cos(2 * np.pi * t)
    a[:, 0, 3] = swing
    b[:, 0, 3] = -1.2 * swing
    mesh = meshes()["box"]
    lights = [random_light(np.random.default_rng(9))] * FRAMES
    stage = _stage({"box": mesh, "box_2": mesh}, [a, b], lights, [])
    every = tuple(range(FRAMES))
    return Script("two identical objects cross", ("box", "box"), stage, every, every)


def spinning() -> Script:
    """A can turns about its own axis at 150 degrees a second, so that only the texture moves."""
    tilt, place = se3.rotation_exp(np.array([1.9, 0.2, 0.3])), np.array([0.0, 0.0, 0.6])
    step = np.array([0.0, 0.0, np.radians(150.0) / RATE_HZ])
    path = np.array([se3.make(tilt @ se3.rotation_exp(step * k), place) for k in range(FRAMES)])
    return scripted("symmetric object turns", "can", path)


def holes() -> Script:
    """60 % of the depth is lost in blotches for two seconds."""
    spoiled = np.zeros(FRAMES + 1, bool)
    spoiled[50:110] = True
    return scripted("60 % of depth lost", "box", carried(FRAMES), holes=spoiled)


def near() -> Script:
    """The object comes nearer than the sensor can measure, for a second."""
    path = carried(FRAMES)
    path[:, 2, 3] -= 0.28 * smooth(FRAMES, 65, 90, 12)
    return scripted("nearer than minimum depth", "can", path, nearest_m=0.45)


def border() -> Script:
    """The image's border cuts the object in half for a second and a half."""
    path = carried(FRAMES)
    path[:, 0, 3] += 0.25 * smooth(FRAMES, 60, 105, 12)
    return scripted("cut by the border", "box", path)


MOMENTS: Mapping[str, Callable[[], Script]] = {
    f.__name__: f
    for f in (
        covered, elsewhere, hand, light, blur, frozen, pause, crossing, spinning, holes, near, border
    )
}  # fmt: skip
