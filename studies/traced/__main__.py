"""Frames by another renderer: MuJoCo drops the objects, Mitsuba traces paths of light, a stereo camera is
simulated.

    $(find .tools -name uv -type f | head -n 1) pip install --python .venv/bin/python mitsuba mujoco
    .venv/bin/python -m studies.traced --models MODELS_DIR --kind apart --frames 7 --seed 5000 --out OUT
    huepose eval perception --bop OUT --bundles bundles --json traced.json
    .venv/bin/python -m studies.traced --models MODELS_DIR --film bumped --frames 45 --seed 6000 --out FILM
    huepose eval track --bop FILM --bundles bundles --init estimate --json film.json

They use none of the library's own light, gloss, rooms, heaps, motions or sensors, so they show what is fitted
too closely to those. Nothing is fitted on such frames: they are for finding faults and for measurements. A
frame takes half a minute on two cores; a third of that with --llvm, if LLVM's library is found.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huepose.datasets.bop_writer import BopWriter, Label
from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Float32, Float64, Rng, UInt8
from huepose.onboarding.bop_folder import bop_models
from huepose.onboarding.meshes import read_mesh
from huepose.rendering.render import render
from huepose.scenes.frame import silhouette
from huepose.scenes.heap import open_box
from huepose.scenes.room import Placed, clutter
from huepose.support.progress import progress
from studies.traced.camera import camera_at, carried, measured, photographed
from studies.traced.light import traced
from studies.traced.room import room
from studies.traced.world import SPREAD_M, World

LEAST_LIGHT, LEAST_LABELS = 25, 3
"""A frame with a lower mean grey level, or with fewer labels, is rendered again from another seed: the camera
was inside something."""

Frame = tuple[UInt8, Float32, Camera, list[Label]]


@dataclass(frozen=True, eq=False)
class Stage:
    """Five to eight named objects and up to four other things, which fell to their poses, and the static
    things around them (`about`). numbers: of the objects and things in the world; target (3,): about the
    middle of the objects."""

    names: list[str]
    things: list[Mesh]
    numbers: list[int]
    world: World
    about: list[Placed]
    target: Float64

    @classmethod
    def of(cls, rng: Rng, kind: str, meshes: Mapping[str, Mesh]) -> Stage:
        """A random stage of a kind, a key of SPREAD_M."""
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
        """All meshes with their poses; `poses`: of the world's things. The named objects come first."""
        return [(m, poses[k]) for m, k in zip(self.things, self.numbers, strict=True)] + self.about


def frames(
    kind: str,
    seed: int,
    count: int,
    meshes: Mapping[str, Mesh],
    ids: Mapping[str, int],
    done: Collection[int],
) -> Iterator[tuple[int, Frame]]:
    """Single frames with their numbers, without those that are done."""
    for k in (k for k in range(count) if k not in done):
        for again in range(10):
            rng = np.random.default_rng(seed + k + 100_000 * again)
            stage = Stage.of(rng, kind, meshes)
            camera, T_world_cam = camera_at(rng, stage.target)
            frame = _rendered(rng, rng, stage, stage.world.poses(), camera, T_world_cam, ids, "independent")
            if frame[0].mean() >= LEAST_LIGHT and len(frame[3]) >= LEAST_LABELS:
                break
        yield k, frame


def film(
    kind: str,
    moving: str,
    seed: int,
    count: int,
    meshes: Mapping[str, Mesh],
    ids: Mapping[str, int],
    done: Collection[int],
) -> Iterator[tuple[int, Frame]]:
    """Frames at 30 Hz with their numbers, without those that are done. moving: "bumped", some things are
    pushed and come to rest elsewhere, or "carried", the camera moves."""
    rng = np.random.default_rng(seed)
    stage = Stage.of(rng, kind, meshes)
    camera, T_world_cam = camera_at(rng, stage.target)
    poses: Iterable[list[Float64]]
    if moving == "carried":
        eyes, poses = carried(rng, stage.target, T_world_cam, count), [stage.world.poses()] * count
    else:
        eyes, poses = [T_world_cam] * count, stage.world.film(rng, count)
    look = int(rng.integers(1 << 30))
    for k, (eye, at) in enumerate(zip(eyes, poses, strict=True)):
        if k not in done:
            same, other = np.random.default_rng(look), np.random.default_rng([seed, k])
            yield k, _rendered(same, other, stage, at, camera, eye, ids, "multijitter")


def _rendered(
    rng: Rng,
    noise: Rng,
    stage: Stage,
    poses: Sequence[Float64],
    camera: Camera,
    T_world_cam: Float64,
    ids: Mapping[str, int],
    sampler: str,
) -> Frame:
    """The frame of a stage. rng: for gloss, light and the camera's properties; noise: for what varies from
    frame to frame."""
    placed = stage.placed(poses)
    T_cam_world = se3.inverse(T_world_cam)
    in_camera = [(mesh, T_cam_world @ T) for mesh, T in placed]
    geometry = render(in_camera, camera, color=False)
    shown = [(mesh, T, rng.uniform()) for mesh, T in placed]
    color = photographed(rng, noise, traced(rng, noise, shown, camera, T_world_cam, sampler))
    labels = []
    for k, name in enumerate(stage.names):
        count, box = silhouette(stage.things[k], in_camera[k][1], camera)
        mask = np.asarray(geometry.object_index == k)
        if mask.any():
            labels.append(Label(ids[name], se3.orthonormalised(in_camera[k][1]), mask, count, box))
    return color, measured(rng, noise, geometry.depth, camera.fx), camera, labels


def main() -> None:
    """Render frame by frame; existing frames are kept."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--models", type=Path, required=True, metavar="DIR", help="BOP models folder")
    parser.add_argument("--kind", choices=list(SPREAD_M), default="apart")
    parser.add_argument("--film", choices=["bumped", "carried"], help="one film instead of single frames")
    parser.add_argument("--frames", type=int, default=7)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--llvm", action="store_true", help="three times as fast, if LLVM is installed")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="scene folder")
    a = parser.parse_args()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb" if a.llvm else "scalar_rgb")
    models = bop_models(a.models, None)
    meshes = {m.name: read_mesh(m.mesh_path, "mm") for m in progress(models, "reading meshes")}
    ids = {m.name: m.object_id for m in models}
    facts = {"study": "traced", "kind": a.kind, "seed": a.seed, "film": a.film}
    writer = BopWriter(a.out, facts)
    of = a.seed, a.frames, meshes, ids, writer.done
    rendering = frames(a.kind, *of) if a.film is None else film(a.kind, a.film, *of)
    left = len(set(range(a.frames)) - writer.done)
    for k, frame in progress(rendering, f"rendering {a.out.name}", left):
        writer.add(k, *frame)


if __name__ == "__main__":
    main()
