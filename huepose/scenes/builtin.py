"""The built-in scene: a closed loop of rendered RGB-D frames at 30 Hz with exact ground truth, from a seed.

Several printed objects move and rotate over a table with clutter. They pass in front of each other, and a bar
occludes parts of them now and then. The light moves; depth is as noisy as that of an active stereo camera.
The loop is rendered once (about 20 s on two cores) and kept on disk. It closes, so it can be played for ever.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from huepose.datasets.types import GroundTruth, Sample
from huepose.geometry import Box, Camera, Mesh, RgbdFrame
from huepose.geometry.arrays import Bool, Float32, Int32, UInt8
from huepose.scenes.camera import CAMERA, COLOR, RATE_HZ, STEREO, StereoSensor
from huepose.scenes.loop_file import kept_loop
from huepose.scenes.shapes import demo_objects
from huepose.support.errors import InputError
from huepose.support.files import cache_folder
from huepose.support.kept import kept
from huepose.support.progress import progress

# Planning and rendering are imported where they are used: a camera that plays the loop needs neither.
if TYPE_CHECKING:
    from huepose.scenes.frame import Shot, Stage

VERSION = 4  # of the rendered images: raise it when a change in any module used here changes a pixel
SECONDS = 8.0


@dataclass(frozen=True, eq=False)
class _MeshArrays:
    """The arrays of a mesh."""

    vertices: Float32
    faces: Int32
    uv: Float32
    texture: UInt8


@dataclass(frozen=True, eq=False)
class _Objects:
    """The objects of a seed."""

    tea_box: _MeshArrays
    soup_can: _MeshArrays
    juice_bottle: _MeshArrays
    corner_bracket: _MeshArrays
    parts_tray: _MeshArrays


def builtin_objects(seed: int) -> dict[str, Mesh]:
    """`demo_objects(seed)`, made once and kept in the cache folder: every worker of a pipeline needs them."""

    def made() -> _Objects:
        meshes = demo_objects(seed).items()
        return _Objects(**{name: _MeshArrays(m.vertices, m.faces, m.uv, m.texture) for name, m in meshes})

    found = kept(_Objects, f"scene-{seed}", made)
    return {field.name: Mesh(**vars(getattr(found, field.name))) for field in fields(_Objects)}


class SyntheticScene:
    """A closed loop of frames with ground truth, with the interface of a recorded scene. Indices go on beyond
    the loop: frame(len) shows the same as frame(0), with its own number and timestamp.

    meshes: the labelled objects by name; camera: its intrinsics; len(scene): number of frames in the loop.
    """

    def __init__(
        self,
        seed: int = 0,
        seconds: float = SECONDS,
        objects: Mapping[str, Mesh] | None = None,
        camera: Camera = CAMERA,
        depth_sensor: StereoSensor | None = STEREO,
        cache: Path | None = None,
    ) -> None:
        """Open the loop. If the cache folder (default `~/.cache/huepose`) has none, it is rendered first.

        objects: meshes in metres by name, default `builtin_objects(seed)`; without a depth sensor, depth
        is exact. Raises InputError for no object, for more objects than fit in view, for less than a second,
        or if the cache folder cannot be written.
        """
        if seconds < 1.0:
            raise InputError("synthetic scene", found=f"{seconds:g} s", expected="at least 1 s")
        self.meshes: dict[str, Mesh] = dict(builtin_objects(seed) if objects is None else objects)
        if not self.meshes:
            raise InputError("synthetic scene", found="no object", expected="one mesh or more")
        self.seed, self.camera, self.rate_hz = seed, camera, RATE_HZ
        self._n_frames, self._depth_sensor = round(seconds * RATE_HZ), depth_sensor
        self.path = (cache or cache_folder()) / f"scene-{seed}-{self._key()}.loop"
        self._loop, self._rows = kept_loop(self.path, self._computed)
        self.name, self.image_ids = f"synthetic-{seed}", tuple(range(len(self._loop)))

    def __len__(self) -> int:
        return len(self._loop)

    def __iter__(self) -> Iterator[Sample]:
        """All frames of the loop, once."""
        return (Sample(self.frame(i), self.truths(i), self.name, i) for i in self.image_ids)

    def stamp_ns(self, i: int) -> int:
        """Capture time of frame i from the start of the loop: i / 30 s."""
        return round(i * 1e9 / RATE_HZ)

    def frame(self, i: int) -> RgbdFrame:
        """Frame i."""
        k, at_ns = i % len(self), self.stamp_ns(i)
        return RgbdFrame(self._loop.color(k), self._loop.depth(k), self.camera, frame_id=i, stamp_ns=at_ns)

    def truths(self, i: int) -> tuple[GroundTruth, ...]:
        """The ground truth of frame i: one entry for each object, also for occluded ones; exact to
        float64."""
        k = i % len(self)
        row = self._rows[k]
        return tuple(
            GroundTruth(
                instance=n,
                object=name,
                T_cam_obj=np.array(row["T_cam_obj"][n]),
                visib_fract=row["visib_fract"][n],
                box_visib=None if row["box_visib"][n] is None else Box(*row["box_visib"][n]),
                mask_loader=partial(self._mask, k, n),
            )
            for n, name in enumerate(self.meshes)
        )

    @cached_property
    def stage(self) -> Stage:
        """All meshes and their motion."""
        from huepose.scenes.plan import plan

        return plan(self.meshes, self.seed, self._n_frames, self.camera)

    def _mask(self, i: int, k: int) -> Bool:
        from huepose.scenes.frame import visible_mask

        return visible_mask(self.stage, i, k)

    def _key(self) -> str:
        """Changes with anything that changes a pixel."""
        digest = hashlib.sha256()
        sensor = None if self._depth_sensor is None else asdict(self._depth_sensor)
        digest.update(json.dumps([VERSION, self.seed, self._n_frames, asdict(self.camera), sensor]).encode())
        for name, mesh in self.meshes.items():
            digest.update(name.encode() + mesh.content())
        return digest.hexdigest()[:12]

    def _computed(self) -> Iterator[tuple[np.ndarray, np.ndarray, dict[str, Any]]]:
        """Every frame in order, rendered by up to four threads (the kernels release the interpreter lock)."""
        from huepose.scenes.frame import shoot

        workers = max(1, min(4, os.cpu_count() or 1))
        with ThreadPoolExecutor(workers) as pool:
            ahead: list[Future[Shot]] = []
            for i in progress(range(self._n_frames), f"rendering the scene of seed {self.seed}, once"):
                take = partial(
                    shoot, self.stage, seed=self.seed, color_sensor=COLOR, depth_sensor=self._depth_sensor
                )
                while len(ahead) < 2 * workers and i + len(ahead) < self._n_frames:
                    ahead.append(pool.submit(take, i + len(ahead)))
                yield ahead.pop(0).result().kept()


def first_shot(objects: Mapping[str, Mesh]) -> Shot:
    """Frame 0 of `SyntheticScene(objects=objects)`, without rendering the others. Raises InputError."""
    from huepose.scenes.frame import shoot
    from huepose.scenes.plan import plan

    return shoot(plan(objects, 0, round(SECONDS * RATE_HZ), CAMERA), 0, 0, COLOR, STEREO)


def check_scene(objects: Mapping[str, Mesh], seed: int = 0) -> None:
    """Raises InputError if `SyntheticScene(seed, objects=objects)` has no room for them; renders nothing."""
    from huepose.scenes.plan import check_room

    check_room(objects, seed, round(SECONDS * RATE_HZ), CAMERA)
