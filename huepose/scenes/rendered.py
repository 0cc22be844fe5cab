"""Rendered single frames of heaps and piles of objects, with labels: for calibration and to measure changes.

A frame shows a heap of some of the objects and of clutter on a printed table, taken by a hand-held colour and
stereo depth camera. The seed and the number of the frame determine it completely. What varies: the objects,
how close they are together, the focal length, the camera pose, the direction, colour and strength of light,
shadows, gloss, exposure, motion blur, noise of colour and depth. A pile is a heap that is denser, farther
away and in worse light, with depth that is lost as by real cameras; half of the piles are in an open box.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

import numpy as np

from huepose.datasets.bop_writer import BopWriter, Label
from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Float64, Rng
from huepose.scenes.camera import CAMERA, COLOR, STEREO
from huepose.scenes.frame import SHUTTER, Shot, Stage, shoot, silhouette
from huepose.scenes.heap import Heap, open_box, random_turn
from huepose.scenes.light import Light
from huepose.scenes.motion import AHEAD_ROOM, TABLE_M, UP_ROOM, upright
from huepose.scenes.room import clutter, room
from huepose.scenes.sensor import lost_in_bad_light, shifted
from huepose.support.errors import InputError
from huepose.support.progress import progress

HEAP_ROOM = -TABLE_M * UP_ROOM + 0.8 * AHEAD_ROOM
"""Centre of the heap on the table."""

T_ROOM_TABLE = se3.make(upright(0.0), HEAP_ROOM)

LARGEST_M = 0.45
"""Longest extent, along the mesh's own axes, of an object that fits on the table."""

_ROOMS = 8
"""Number of rooms in a set; its frames use them in turn."""

HEAP_PLACES, PILE_PLACES = 5, 24
"""Positions that are tried for each mesh; it takes the lowest. More positions make piles denser."""

BOXED, BOX_HALF_SIDE_M, BOX_HEIGHT_M = 0.5, (0.13, 0.2), (0.06, 0.13)
"""Share of the piles in an open box, and its size."""

MISALIGNED, SHIFT_PX = 0.25, 2
"""Share of the piles whose depth is shifted against colour, and the largest shift along each axis."""


@dataclass(frozen=True)
class SceneRanges:
    """Ranges of the uniform distributions that a frame is drawn from.

    objects, others: number of objects and of other meshes; spread_m: radius of the heap; distance_m,
    elevation_deg: of the camera from the heap; exposure: in stops; tint: natural logarithm of red and blue
    against green; key, sky, gloss: see `scenes.light.Light`; shake_px: motion during the exposure, in a third
    of the frames; subpixel: see `scenes.camera.StereoSensor`; pile: adds a second lamp, an open box around
    half of the heaps, depth that is shifted by up to 2 px against colour in a quarter of the frames, and
    depth that is lost in the dark and in glare."""

    objects: tuple[int, int] = (6, 9)
    others: tuple[int, int] = (2, 5)
    spread_m: tuple[float, float] = (0.14, 0.34)
    distance_m: tuple[float, float] = (0.55, 1.2)
    elevation_deg: tuple[float, float] = (25.0, 75.0)
    exposure: tuple[float, float] = (-1.3, 0.8)
    tint: tuple[float, float] = (-0.3, 0.3)
    key: tuple[float, float] = (0.25, 1.0)
    sky: tuple[float, float] = (0.15, 0.5)
    gloss: tuple[float, float] = (0.0, 0.35)
    shake_px: tuple[float, float] = (0.5, 4.0)
    subpixel: tuple[float, float] = (0.05, 0.13)
    pile: bool = False


PILES = SceneRanges(
    objects=(5, 9),
    others=(2, 6),
    spread_m=(0.1, 0.2),
    distance_m=(0.65, 1.5),
    exposure=(-3.3, 1.0),
    tint=(-0.8, 0.8),
    key=(0.3, 1.1),
    sky=(0.04, 0.35),
    gloss=(0.05, 0.6),
    shake_px=(1.0, 6.0),
    pile=True,
)
"""The ranges of piles."""


@dataclass(frozen=True, eq=False)
class RenderedFrame:
    """A frame with its ground truth. names: of the labelled objects, in the order of the labels; camera: its
    intrinsics."""

    shot: Shot
    names: tuple[str, ...]
    camera: Camera


def rendered_frame(
    meshes: Mapping[str, Mesh], seed: int, number: int, ranges: SceneRanges | None = None
) -> RenderedFrame:
    """Frame `number` of the set `seed`. The same arguments give the same pixels.

    Raises InputError for no mesh, or for one that is too large for a heap on the table."""
    ranges = ranges or SceneRanges()
    stage, names, rng, pile = heaped_stage(meshes, seed, number, ranges)
    depth_sensor = replace(STEREO, subpixel=rng.uniform(*ranges.subpixel))
    color_sensor = replace(
        COLOR, full_well=COLOR.full_well * rng.uniform(0.3, 1.2), blur_px=rng.uniform(0.4, 0.8)
    )
    # The middle of three frames, because the exposure extends into its neighbours.
    shot = shoot(stage, 1, int(rng.integers(2**31)), color_sensor, depth_sensor)
    if ranges.pile:
        depth = lost_in_bad_light(shot.depth, shot.color, pile)
        if pile.random() < MISALIGNED:
            right_px, down_px = pile.integers(-SHIFT_PX, SHIFT_PX + 1, 2)
            depth = shifted(depth, int(right_px), int(down_px))
        shot = replace(shot, depth=depth)
    return RenderedFrame(shot, names, stage.camera)


def heaped_stage(
    meshes: Mapping[str, Mesh], seed: int, number: int, ranges: SceneRanges
) -> tuple[Stage, tuple[str, ...], Rng, Rng]:
    """The heap of frame `number` of the set `seed` as a stage of three frames, of which the middle one is
    rendered; the names of its labelled objects; and the random generators of the frame and of the pile, for
    what is drawn after this.

    Raises InputError for no mesh, or for one that is too large for a heap on the table."""
    check_sizes(meshes)
    rng = np.random.default_rng([seed, number, 61])
    known = sorted(meshes)
    low, high = ranges.objects
    count = min(len(known), int(rng.integers(low, high + 1)))
    names = tuple(str(n) for n in rng.permutation(known)[:count])
    things = [meshes[name] for name in names]
    things += [clutter(rng) for _ in range(int(rng.integers(ranges.others[0], ranges.others[1] + 1)))]
    spread_m = rng.uniform(*ranges.spread_m)
    backdrop = list(_room(seed, number % _ROOMS))
    heap, pile = Heap(), np.random.default_rng([seed, number, 63])
    if ranges.pile and pile.random() < BOXED:
        half_side_m = pile.uniform(*BOX_HALF_SIDE_M)
        around = open_box(half_side_m, pile.uniform(*BOX_HEIGHT_M), pile)
        turn = se3.rotation_exp(np.array([0.0, 0.0, pile.uniform(0, 2 * np.pi)]))
        backdrop.append((around, T_ROOM_TABLE @ heap.drop(around, turn, np.zeros((1, 2)))))
        spread_m = 0.8 * half_side_m
    poses = _heaped(heap, things, spread_m, rng, PILE_PLACES if ranges.pile else HEAP_PLACES)
    camera, T_cam_room = _view(ranges, rng)
    stage = Stage(
        meshes=(*things, *(mesh for mesh, _ in backdrop)),
        labelled=count,
        T_room_mesh=np.repeat(np.array([*poses, *(T for _, T in backdrop)])[:, None], 3, axis=1),
        T_cam_room=_shaken(T_cam_room, camera, ranges, rng),
        lights=(_light(ranges, rng),) * 3,
        camera=camera,
        lamp=replace(_light(ranges, pile), sky=0.0) if ranges.pile else None,
    )
    return stage, names, rng, pile


def check_sizes(meshes: Mapping[str, Mesh], fix: str = "Leave it out with --objects.") -> None:
    """Raises InputError for no mesh, or, with `fix`, for one that is too large for a heap on the table."""
    if not meshes:
        raise InputError("rendered scene", found="no object", expected="one mesh or more")
    for name, mesh in meshes.items():
        side = float(np.ptp(mesh.vertices, axis=0).max())
        if side > LARGEST_M:
            raise InputError(
                f"object '{name}'",
                found=f"a largest side of {side:.2f} m",
                expected=f"at most {LARGEST_M:.2f} m, so that it fits on the table",
                fix=fix,
            )


@lru_cache(maxsize=_ROOMS)
def _room(seed: int, k: int) -> tuple[tuple[Mesh, Float64], ...]:
    """Room k of a set: table, wall and clutter at the back of the table."""
    rng = np.random.default_rng([seed, k, 62])
    return tuple(room(rng, n_clutter=int(rng.integers(2, 12))))


def _heaped(heap: Heap, things: list[Mesh], spread_m: float, rng: Rng, places: int) -> list[Float64]:
    """Poses T_room_mesh (4, 4) of meshes that are heaped up within the radius `spread_m`, roughly from
    large to small, each at the lowest of `places` random positions."""
    poses: list[Float64] = [np.eye(4)] * len(things)
    sizes = [float(np.ptp(mesh.vertices, axis=0).max()) * rng.uniform(0.6, 1.4) for mesh in things]
    for k in np.argsort(sizes)[::-1]:
        R = random_turn(things[k], rng)
        angle, share = rng.uniform(0, 2 * np.pi, places), np.sqrt(rng.uniform(0, 1, places))
        at = spread_m * share[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
        poses[int(k)] = T_ROOM_TABLE @ heap.drop(things[k], R, at)
    return poses


def _view(ranges: SceneRanges, rng: Rng) -> tuple[Camera, Float64]:
    """A camera, and its pose T_cam_room (4, 4): it looks at the heap from the front."""
    zoom = rng.uniform(0.9, 1.1)
    camera = replace(CAMERA, fx=CAMERA.fx * zoom, fy=CAMERA.fy * zoom)
    elevation, azimuth = np.radians(rng.uniform(*ranges.elevation_deg)), rng.uniform(-0.7, 0.7)
    right = np.cross(AHEAD_ROOM, UP_ROOM)
    level = -np.cos(azimuth) * AHEAD_ROOM + np.sin(azimuth) * right
    towards = np.cos(elevation) * level + np.sin(elevation) * UP_ROOM
    at = HEAP_ROOM + 0.04 * UP_ROOM + rng.normal(0, 0.04, 3)
    x = np.cross(-towards, UP_ROOM)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(-towards, x), -towards])
    R = se3.rotation_exp(np.array([0.0, 0.0, np.radians(rng.normal(0, 10.0))])) @ R
    return camera, se3.make(R, -R @ (at + rng.uniform(*ranges.distance_m) * towards))


def _shaken(T_cam_room: Float64, camera: Camera, ranges: SceneRanges, rng: Rng) -> Float64:
    """T_cam_room (3, 4, 4) one frame before, at, and one frame after: a third of the cameras rotate, the
    others are static."""
    shaken, angle = rng.random() < 1 / 3, rng.uniform(0, 2 * np.pi)
    turn = rng.uniform(*ranges.shake_px) / camera.fx / SHUTTER * (1.0 if shaken else 0.0)
    step = turn * np.array([np.cos(angle), np.sin(angle), 0.0])
    return np.array([se3.make(se3.rotation_exp(k * step), np.zeros(3)) @ T_cam_room for k in (-1, 0, 1)])


def _light(ranges: SceneRanges, rng: Rng) -> Light:
    angle = rng.uniform(0, 2 * np.pi)
    right = np.cross(AHEAD_ROOM, UP_ROOM)
    towards = UP_ROOM + rng.uniform(0.1, 1.6) * (np.cos(angle) * AHEAD_ROOM + np.sin(angle) * right)
    gain = 2.0 ** rng.uniform(*ranges.exposure) * np.exp(
        [rng.uniform(*ranges.tint), 0.0, rng.uniform(*ranges.tint)]
    )
    return Light(
        towards / np.linalg.norm(towards),
        rng.uniform(*ranges.key),
        rng.uniform(*ranges.sky),
        np.asarray(gain),
        rng.uniform(*ranges.gloss),
    )


VERSION = 1
"""Of the rendered images: raise it when the same seed gives other pixels."""


def write_rendered_set(
    folder: Path,
    meshes: Mapping[str, Mesh],
    object_ids: Mapping[str, int],
    frames: int,
    seed: int,
    ranges: SceneRanges | None = None,
    color_suffix: str = ".jpg",
) -> None:
    """Render frames 0 to `frames` - 1 of the set `seed` into a folder. Frames that are already there are
    kept.

    meshes: in metres, by name; object_ids: BOP ids by name. Raises InputError for a folder that holds
    something else, for no frames, or for meshes that are too large."""
    if frames < 1:
        raise InputError("--frames", found=str(frames), expected="1 or more")
    ranges = ranges or SceneRanges()
    check_sizes(meshes)
    facts = {
        "version": VERSION,
        "seed": seed,
        "objects": {name: object_ids[name] for name in sorted(meshes)},
        "ranges": asdict(ranges),
        "meshes": {name: sha256(meshes[name].content()).hexdigest()[:16] for name in sorted(meshes)},
    }
    writer = BopWriter(folder, facts, color_suffix)
    missing = [number for number in range(frames) if number not in writer.done]
    for number in progress(missing, f"rendering {folder.name}") if missing else ():
        frame, labels = rendered_frame(meshes, seed, number, ranges), []
        for k, (name, T) in enumerate(zip(frame.names, frame.shot.labels.T_cam_obj, strict=True)):
            count, box = silhouette(meshes[name], T, frame.camera)
            labels.append(Label(object_ids[name], T, np.asarray(frame.shot.owner == k), count, box))
        writer.add(number, frame.shot.color, frame.shot.depth, frame.camera, labels)
