"""Frames of another renderer: MuJoCo lets objects fall, Mitsuba follows the light, a stereo camera errs.

    $(find .tools -name uv -type f | head -n 1) pip install --python .venv/bin/python mitsuba mujoco
    .venv/bin/python -m studies.traced --models MODELS_DIR --kind apart --frames 7 --seed 5000 --out OUT
    huepose eval perception --bop OUT --bundles bundles --json traced.json
    .venv/bin/python -m studies.traced --models MODELS_DIR --film bumped --frames 45 --seed 6000 --out FILM
    huepose eval track --bop FILM --bundles bundles --init estimate --json film.json

Nothing of the library's own light, gloss, rooms, heaps, motions or sensors is in them, so they show what is
fitted to those. Nothing is fitted on such frames: they are for finding faults and for measuring. A frame
takes half a minute of two processors; a third of it with --llvm, where LLVM's library is found.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.datasets.bop_writer import BopWriter, Label
from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Float, Float32, Float64, UInt8
from huepose.onboarding.bop_folder import bop_models
from huepose.onboarding.meshes import read_mesh
from huepose.rendering.render import corner_normals, render
from huepose.scenes.frame import silhouette
from huepose.scenes.heap import open_box
from huepose.scenes.room import Placed, clutter, sheet
from huepose.scenes.textures import clouds
from huepose.support.progress import progress

Rng = np.random.Generator

WIDTH, HEIGHT = 640, 480
SPREAD_M = {"apart": 0.26, "heap": 0.17, "pile": 0.10}
"""Radius of the circle over which objects fall; in every second pile into an open box."""

SAMPLES, BOUNCES = {"independent": 40, "multijitter": 9}, 7
"""Of a pixel, by Mitsuba's sampler: single frames by the first, films by the second, which needs fewer."""

LEAST_LIGHT, LEAST_LABELS = 25, 3
"""Mean grey level, and labels, under which a frame is drawn anew: the camera stood in something."""

STEP_S, STEPS = 0.002, 1600
HZ, START_S = 30, 0.3
"""Of a film; so long nothing is pushed in it."""

PUSHED, PUSHES_A_SECOND, PUSH_M_S, PUSH_UP_M_S, PUSH_RAD_S = 0.6, 1.5, 0.4, 1.2, 5.0
"""Share of the things that are pushed, and how often; standard deviations of the velocity along the ground
and of the angular velocity, and the most upwards."""

WALK_M_S, SWAY_M, SWAY_RAD = (0.15, 0.5), 0.006, 0.012
"""A camera that is carried moves so fast about what it looks at, and so much off its way."""

HULL_POINTS = 400
"""Points of a mesh whose convex hull falls."""


def surface(rng: Rng, pixels: int = 512) -> UInt8:
    """A plain, wooden, stained or checked picture."""
    a, b = (rng.uniform(30, 245, 3).astype(np.float32) for _ in range(2))
    out: Float
    kind = rng.choice(["plain", "wood", "stone", "checks"], p=[0.35, 0.3, 0.2, 0.15])
    share = clouds(rng, pixels, pixels, pixels / 4, 5)[..., None]
    if kind == "plain":
        out = a + 12.0 * (share - 0.5)
    elif kind == "wood":
        short = clouds(rng, pixels // 16, pixels, pixels / 16, 5)
        grain = cv2.resize(short, (pixels, pixels), interpolation=cv2.INTER_CUBIC)[..., None]
        out = rng.uniform(90, 220) * np.array([1.0, 0.72, 0.5]) * (0.75 + 0.4 * grain)
    elif kind == "stone":
        out = (0.3 * a + 0.1 * b + 90.0) * (0.7 + 0.5 * share)
    else:
        cell = np.arange(pixels) // int(rng.integers(8, 128))
        out = np.where(((cell[:, None] + cell) % 2)[..., None] == 1, a, b) * (0.9 + 0.2 * share)
    return np.clip(out, 0, 255).astype(np.uint8)


class World:
    """Things that fell on z = 0 or into a bin, by their convex hulls."""

    def __init__(self, rng: Rng, things: Sequence[Mesh], spread_m: float, bin_: Mesh | None) -> None:
        import mujoco

        self._model = mujoco.MjModel.from_xml_string(_falling(rng, things, spread_m, bin_))
        self._state = mujoco.MjData(self._model)
        self._bodies = [self._model.body(f"b{k}").id for k in range(len(things))]
        self._go(STEPS)

    def poses(self) -> list[Float64]:
        """Of all things (4, 4), now."""
        at = self._state
        return [se3.make(at.xmat[i].reshape(3, 3), at.xpos[i].copy()) for i in self._bodies]

    def film(self, rng: Rng, frames: int) -> Iterator[list[Float64]]:
        """The poses in each frame, while some things are pushed now and then."""
        moving = np.flatnonzero(rng.uniform(size=len(self._bodies)) < PUSHED)
        done = 0
        for k in range(frames):
            yield self.poses()
            for j in moving:
                if k >= START_S * HZ and rng.uniform() < PUSHES_A_SECOND / HZ:
                    push = [*rng.normal(0, PUSH_M_S, 2), rng.uniform(0, PUSH_UP_M_S)]
                    self._state.qvel[6 * j : 6 * j + 6] = [*push, *rng.normal(0, PUSH_RAD_S, 3)]
            until = round((k + 1) / HZ / STEP_S)
            self._go(until - done)
            done = until

    def _go(self, steps: int) -> None:
        import mujoco

        for _ in range(steps):
            mujoco.mj_step(self._model, self._state)


def _falling(rng: Rng, things: Sequence[Mesh], spread_m: float, bin_: Mesh | None) -> str:
    """MuJoCo's description of things in the air, one above the other."""
    meshes, bodies, places = "", "", list[Float64]()
    for k, mesh in enumerate(things):
        v = mesh.vertices
        some = np.concatenate(
            [v[rng.choice(len(v), min(HULL_POINTS, len(v)), False)], v[v.argmin(0)], v[v.argmax(0)]]
        )
        meshes += f'<mesh name="m{k}" vertex="{" ".join(f"{x:.5f}" for x in some.ravel())}"/>'
        for _ in range(40):
            angle, away = rng.uniform(0, 2 * np.pi), spread_m * np.sqrt(rng.uniform())
            place = away * np.array([np.cos(angle), np.sin(angle)])
            if spread_m < SPREAD_M["apart"] or all(np.linalg.norm(place - p) > 0.12 for p in places):
                break
        places.append(place)
        height = 0.12 + (0.02 if spread_m == SPREAD_M["apart"] else 0.11) * k
        turn = rng.normal(size=4)
        bodies += (
            f'<body name="b{k}" pos="{place[0]:.4f} {place[1]:.4f} {height:.4f}" '
            f'quat="{" ".join(f"{x:.5f}" for x in turn / np.linalg.norm(turn))}"><freejoint/>'
            f'<geom type="mesh" mesh="m{k}" density="500" friction="0.8 0.02 0.01" condim="6"/></body>'
        )
    walls = ""
    if bin_ is not None:
        x, y, z = np.ptp(bin_.vertices, axis=0) / 2.0
        for half, at in (
            ((0.006, y), (x, 0)),
            ((0.006, y), (-x, 0)),
            ((x, 0.006), (0, y)),
            ((x, 0.006), (0, -y)),
        ):
            walls += f'<geom type="box" size="{half[0]} {half[1]} {z}" pos="{at[0]} {at[1]} {z}"/>'
    return (
        f'<mujoco><option timestep="{STEP_S}" integrator="implicitfast"/><asset>{meshes}</asset><worldbody>'
        f'<geom type="plane" size="2 2 0.1" friction="0.9 0.02 0.02" condim="6"/>{walls}{bodies}'
        "</worldbody></mujoco>"
    )


def camera_at(rng: Rng, target: Float64) -> tuple[Camera, Float64]:
    """A camera and T_world_cam (4, 4): it looks at about a point, from 0.5 to 1.5 m, by its focal length."""
    focal = float(rng.choice([540.0, 615.0, 1066.0]))
    cx, cy = (np.array([WIDTH, HEIGHT]) - 1) / 2 + rng.normal(0, 6, 2)
    away = rng.uniform(0.55, 1.05) * (focal / 615.0) ** 0.6
    up, round_ = np.radians(rng.uniform(22, 68)), rng.uniform(0, 2 * np.pi)
    eye = target + away * np.array([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)])
    z = target + rng.normal(0, 0.04, 3) - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1]) / np.linalg.norm(np.cross(z, [0, 0, 1]))
    roll = se3.rotation_exp(np.array([0, 0, np.radians(rng.normal(0, 6))]))
    turn = np.stack([x, np.cross(z, x), z], 1) @ roll
    return Camera(focal, focal, float(cx), float(cy), WIDTH, HEIGHT), se3.make(turn, eye)


def carried(rng: Rng, target: Float64, T_world_cam: Float64, frames: int) -> list[Float64]:
    """The poses (4, 4) of a camera that is carried about what it looks at, with a hand that is not still."""
    away = np.linalg.norm(T_world_cam[:3, 3] - target)
    about = np.array([rng.normal(0, 0.3), rng.normal(0, 0.3), rng.choice([-1.0, 1.0])])
    about *= rng.uniform(*WALK_M_S) / away / np.linalg.norm(about)
    sway = [np.stack([clouds(rng, 4, frames, 20.0, 2)[0] - 0.5 for _ in range(3)], 1) for _ in range(2)]
    out = []
    for k in range(frames):
        turn = se3.rotation_exp(about * (k / HZ))
        place = target + turn @ (T_world_cam[:3, 3] - target) + SWAY_M * sway[0][k]
        out.append(se3.make(turn @ T_world_cam[:3, :3] @ se3.rotation_exp(SWAY_RAD * sway[1][k]), place))
    return out


def room(rng: Rng) -> list[Placed]:
    """A table at z = 0, floor, walls, ceiling, and open boxes that stand and hang about."""
    wide, deep = 2.0 * rng.uniform(0.4, 0.8, 2)
    table = sheet(wide, deep, surface(rng))
    turn = se3.rotation_exp(np.array([0, 0, rng.uniform(0, 2 * np.pi)]))
    out: list[Placed] = [(table, se3.make(turn, np.zeros(3)))]
    floor, ceiling = sheet(8, 8, surface(rng)), sheet(8, 8, surface(rng))
    out.append((floor, se3.make(np.eye(3), np.array([0, 0, -0.75]))))
    out.append((ceiling, se3.make(se3.rotation_exp(np.array([np.pi, 0, 0])), np.array([0, 0, 1.9]))))
    upright = se3.rotation_exp(np.array([np.pi / 2, 0, 0]))
    for k in range(4):
        about = se3.rotation_exp(np.array([0, 0, k * np.pi / 2])) @ turn
        wall = sheet(8, 4, surface(rng))
        out.append((wall, se3.make(about @ upright, about @ np.array([0, rng.uniform(1.2, 3.2), 0.5]))))
    for _ in range(int(rng.integers(2, 9))):
        angle, away, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 2.2), rng.uniform(0.16, 0.8)
        height = -0.75 + size / 2 if rng.uniform() < 0.6 else rng.uniform(-0.3, 0.4)
        place = np.array([away * np.cos(angle), away * np.sin(angle), height])
        chest = open_box(0.15, 0.2, rng)
        out.append((replace(chest, vertices=chest.vertices * np.float32(5.0 * size)), se3.make(turn, place)))
    return out


def kelvin(temperature: float) -> Float64:
    """Linear colour (3,) of a lamp of a colour temperature: Planck's law at three wavelengths, green 1."""
    waves = np.array([610e-9, 550e-9, 465e-9])
    power = waves**-5.0 / (np.exp(0.014388 / (waves * temperature)) - 1.0)
    white = waves**-5.0 / (np.exp(0.014388 / (waves * 6500.0)) - 1.0)
    out = power / white
    return np.asarray(out / out[1])


def traced(
    rng: Rng,
    noise: Rng,
    scene: Sequence[tuple[Mesh, Float64, float]],
    camera: Camera,
    T_world_cam: Float64,
    sampler: str,
) -> Float32:
    """Linear light (H, W, 3) of meshes with poses (4, 4) and gloss, 0..1, under one to three lamps and an
    even sky, less most of the colour of the first lamp."""
    import mitsuba as mi

    parts: dict[str, Any] = {}
    for k, (mesh, T, gloss) in enumerate(scene):
        parts[f"mesh{k}"] = _part(
            mi, mesh, T, rng.uniform(0.12, 0.7) + 0.25 * (1.0 - gloss), rng.uniform(0.2, 0.6)
        )
    first = rng.uniform(2700, 7000)
    sky = kelvin(rng.uniform(3000, 7500)) * rng.uniform(0.05, 0.6)
    parts["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": sky.tolist()}}
    to = mi.ScalarTransform4f
    for k in range(int(rng.integers(1, 4))):
        angle, away, side = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1.1), float(rng.uniform(0.04, 0.4))
        place = [away * np.cos(angle), away * np.sin(angle), rng.uniform(0.8, 1.8)]
        light = (
            kelvin(first if rng.uniform() < 0.6 else rng.uniform(2500, 8000))
            * rng.uniform(0.5, 1.5)
            / side**2
        )
        parts[f"lamp{k}"] = {
            "type": "rectangle",
            "to_world": to().look_at(origin=place, target=[0, 0, 0], up=[0.3, 1, 0.1])
            @ to().scale([side, side, 1]),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": light.tolist()}},
        }
    # Mitsuba's camera has x to the left and y up.
    seen = T_world_cam @ np.diag([-1.0, -1.0, 1.0, 1.0])
    parts["sensor"] = {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
        "principal_point_offset_x": -(camera.cx - (camera.width - 1) / 2) / camera.width,
        "principal_point_offset_y": -(camera.cy - (camera.height - 1) / 2) / camera.height,
        "to_world": to(seen.tolist()),
        "sampler": {"type": sampler},
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
        },
    }
    whole = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": BOUNCES}, **parts})
    seed: Any = int(noise.integers(1 << 30))
    light = np.array(mi.render(whole, spp=SAMPLES[sampler], seed=seed))[..., :3]
    return np.asarray(
        np.minimum(light, 1.5 * np.quantile(light, 0.997)) / kelvin(first) ** rng.uniform(0.4, 1.0),
        np.float32,
    )


def _part(mi: Any, mesh: Mesh, T: Float64, roughness: float, specular: float) -> Any:
    """A mesh for Mitsuba, its corners apart so that each has a normal and a place in the texture."""
    material = {
        "type": "principled",
        "base_color": {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(mesh.texture))},
        "roughness": float(np.clip(roughness, 0.1, 0.95)),
        "specular": float(specular),
    }
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", "material": material})
    corners = se3.apply(T, mesh.vertices[mesh.faces].reshape(-1, 3))
    out = mi.Mesh(
        "mesh",
        len(corners),
        len(mesh.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    values = mi.traverse(out)
    values["vertex_positions"] = corners.astype(np.float32).ravel()
    values["vertex_normals"] = (corner_normals(mesh).reshape(-1, 3) @ T[:3, :3].T).astype(np.float32).ravel()
    values["vertex_texcoords"] = mesh.uv.astype(np.float32).ravel()
    values["faces"] = np.arange(len(corners), dtype=np.uint32)
    values.update()
    return out


def photographed(rng: Rng, noise: Rng, light: Float32) -> UInt8:
    """A picture (H, W, 3) of light: exposure, white balance, saturation, contrast, blur, edges, noise."""
    level = np.quantile(light.mean(-1), rng.uniform(0.5, 0.8))
    out = light * (rng.uniform(0.28, 0.5) / max(float(level), 1e-6)) * np.exp(rng.normal(0, 0.06, 3))
    grey = out.mean(-1, keepdims=True)
    out = np.maximum(grey + (out - grey) * rng.uniform(0.85, 1.25), 0.0)
    out = np.clip(
        np.where(out <= 0.0031308, 12.92 * out, 1.055 * np.maximum(out, 1e-6) ** (1 / 2.4) - 0.055), 0, 1
    )
    out = out + rng.uniform(0.0, 0.6) * out * (1 - out) * (2 * out - 1)
    out = cv2.GaussianBlur(out.astype(np.float32), (0, 0), rng.uniform(0.35, 0.9))
    out = out + rng.uniform(0.0, 0.9) * (out - cv2.GaussianBlur(out, (0, 0), 1.2))
    out = out + noise.normal(size=out.shape) * rng.uniform(0.003, 0.014)
    return np.asarray(np.clip(255.0 * out, 0, 255), np.uint8)


def measured(rng: Rng, noise: Rng, depth: Float32, focal: float) -> Float32:
    """What a stereo camera measures of depth (H, W): noise of disparity in patches, borders that are grown
    over, nothing where the other camera does not see, and holes."""
    baseline_m = rng.uniform(0.045, 0.08)
    disparity = np.where(depth > 0, focal * baseline_m / np.maximum(depth, 1e-3), 0.0).astype(np.float32)
    height, width = depth.shape
    rows, columns = np.mgrid[:height, :width]
    other = np.clip(np.rint(columns - disparity).astype(int) + 200, 0, width + 199)
    nearest = np.zeros((height, width + 200), np.float32)
    np.maximum.at(nearest, (rows, other), disparity)
    lost = nearest[rows, other] > disparity + 1.0
    error = cv2.GaussianBlur(noise.normal(size=depth.shape).astype(np.float32), (0, 0), rng.uniform(0.8, 2.2))
    grown = cv2.medianBlur(disparity, 5) if rng.uniform() < 0.6 else disparity
    disparity = grown + error / error.std() * np.float32(rng.uniform(0.06, 0.2))
    edge = cv2.morphologyEx(disparity, cv2.MORPH_GRADIENT, np.ones((3, 3))) > 1.5
    lost |= edge & (noise.uniform(size=depth.shape) < 0.4)
    lost |= clouds(noise, height, width, 40.0, 4) > rng.uniform(0.85, 1.0)
    out = np.where(
        (disparity > 0.5) & ~lost & (depth > 0), focal * baseline_m / np.maximum(disparity, 0.5), 0.0
    )
    return np.where(out < 6.0, out, 0.0).astype(np.float32)


Frame = tuple[UInt8, Float32, Camera, list[Label]]


@dataclass(frozen=True, eq=False)
class Stage:
    """Five to eight named objects and up to four other things, which fell where they lie, and what stands
    about. numbers: of the objects and things in the world; target (3,): about where the objects are."""

    names: list[str]
    things: list[Mesh]
    numbers: list[int]
    world: World
    about: list[Placed]
    target: Float64

    @classmethod
    def of(cls, rng: Rng, kind: str, meshes: Mapping[str, Mesh]) -> Stage:
        """One of that kind."""
        some = rng.choice(sorted(meshes), min(int(rng.integers(5, 9)), len(meshes)), False)
        names = [str(name) for name in some]
        others = [clutter(rng) for _ in range(int(rng.integers(0, 5)))]
        bin_ = (
            open_box(rng.uniform(0.14, 0.22), rng.uniform(0.1, 0.25), rng)
            if kind == "pile" and rng.uniform() < 0.5
            else None
        )
        things = [*(meshes[name] for name in names), *others]
        order = rng.permutation(len(things))
        world = World(rng, [things[k] for k in order], SPREAD_M[kind], bin_)
        numbers = np.argsort(order).tolist()
        about = room(rng)
        if bin_ is not None:
            about.append((bin_, se3.make(np.eye(3), np.array([0, 0, -float(bin_.vertices[:, 2].min())]))))
        lie = world.poses()
        at = [lie[k][:3, 3] for k in numbers[: len(names)]]
        near = [p for p in at if np.linalg.norm(p[:2]) < 0.5 and p[2] > -0.05]
        return cls(names, things, numbers, world, about, np.mean(near, axis=0) if near else np.zeros(3))

    def placed(self, poses: Sequence[Float64]) -> list[Placed]:
        """All meshes, where the world has its things at these poses; the named objects first."""
        return [(m, poses[k]) for m, k in zip(self.things, self.numbers, strict=True)] + self.about


def frame(seed: int, kind: str, meshes: Mapping[str, Mesh], ids: Mapping[str, int]) -> Frame:
    """Colour, depth in metres, camera and labels of a frame."""
    rng = np.random.default_rng(seed)
    stage = Stage.of(rng, kind, meshes)
    camera, T_world_cam = camera_at(rng, stage.target)
    return _drawn(rng, rng, stage, stage.world.poses(), camera, T_world_cam, ids, "independent")


def film(
    seed: int,
    kind: str,
    moving: str,
    frames: int,
    meshes: Mapping[str, Mesh],
    ids: Mapping[str, int],
    done: Collection[int] = (),
) -> Iterator[tuple[int, Frame]]:
    """Frames at 30 Hz, but those that are done, with their numbers: some things are `bumped` and come to lie
    elsewhere, or the camera is `carried`."""
    rng = np.random.default_rng(seed)
    stage = Stage.of(rng, kind, meshes)
    camera, T_world_cam = camera_at(rng, stage.target)
    eyes = [T_world_cam] * frames
    poses = iter([stage.world.poses()] * frames)
    if moving == "carried":
        eyes = carried(rng, stage.target, T_world_cam, frames)
    else:
        poses = stage.world.film(rng, frames)
    look = int(rng.integers(1 << 30))
    for k, (eye, at) in enumerate(zip(eyes, poses, strict=True)):
        if k not in done:
            same, other = np.random.default_rng(look), np.random.default_rng([seed, k])
            yield k, _drawn(same, other, stage, at, camera, eye, ids, "multijitter")


def _drawn(
    rng: Rng,
    noise: Rng,
    stage: Stage,
    poses: Sequence[Float64],
    camera: Camera,
    T_world_cam: Float64,
    ids: Mapping[str, int],
    sampler: str,
) -> Frame:
    """A stage as a camera sees it. rng: of gloss, light and what the camera is; noise: of what varies from
    frame to frame."""
    placed = stage.placed(poses)
    T_cam_world = se3.inverse(T_world_cam)
    seen = [(mesh, T_cam_world @ T) for mesh, T in placed]
    geometry = render(seen, camera, color=False)
    shown = [(mesh, T, rng.uniform()) for mesh, T in placed]
    color = photographed(rng, noise, traced(rng, noise, shown, camera, T_world_cam, sampler))
    labels = []
    for k, name in enumerate(stage.names):
        count, box = silhouette(stage.things[k], seen[k][1], camera)
        mask = np.asarray(geometry.object_index == k)
        if mask.any():
            labels.append(Label(ids[name], se3.orthonormalised(seen[k][1]), mask, count, box))
    return color, measured(rng, noise, geometry.depth, camera.fx), camera, labels


def main() -> None:
    """Draw, frame by frame; what is there stays."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--models", type=Path, required=True, metavar="DIR", help="BOP models folder")
    parser.add_argument("--kind", choices=list(SPREAD_M), default="apart")
    parser.add_argument("--film", choices=["bumped", "carried"], help="one film instead of single frames")
    parser.add_argument("--frames", type=int, default=7)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--llvm", action="store_true", help="three times as fast, where LLVM is installed")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="scene folder")
    a = parser.parse_args()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb" if a.llvm else "scalar_rgb")
    models = bop_models(a.models, None)
    meshes = {m.name: read_mesh(m.mesh_path, "mm") for m in progress(models, "reading meshes")}
    ids = {m.name: m.object_id for m in models}
    facts = {"study": "traced", "kind": a.kind, "seed": a.seed, "film": a.film}
    writer = BopWriter(a.out, facts)
    if a.film is not None:
        frames = film(a.seed, a.kind, a.film, a.frames, meshes, ids, writer.done)
        for _ in progress(range(a.frames - len(writer.done)), f"drawing {a.out.name}"):
            k, drawn = next(frames)
            writer.add(k, *drawn)
        return
    for k in progress([k for k in range(a.frames) if k not in writer.done], f"drawing {a.out.name}"):
        for again in range(10):
            drawn = frame(a.seed + k + 100_000 * again, a.kind, meshes, ids)
            if drawn[0].mean() >= LEAST_LIGHT and len(drawn[3]) >= LEAST_LABELS:
                break
        writer.add(k, *drawn)


if __name__ == "__main__":
    main()
