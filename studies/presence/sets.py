"""The drawn frames that presence is fitted to, chosen on and reported on: three sets of other seeds, each of
objects that stand apart, of heaps and of piles. Some frames are made smaller, so that there is little to see
of an object, and in some there are specks of wrong depth, as cameras give where they mistake a pattern."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from huepose.datasets.bop import BopScene
from huepose.datasets.types import Sample
from huepose.geometry.arrays import Float32
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.onboarding.bop_folder import bop_models
from huepose.onboarding.meshes import read_mesh
from huepose.scenes.rendered import PILES, SceneRanges
from huepose.scenes.rendered_set import write_rendered_set

SetName = Literal["fit", "choose", "report"]

APART = SceneRanges(
    objects=(2, 5),
    others=(1, 6),
    spread_m=(0.25, 0.42),
    distance_m=(0.6, 1.5),
    elevation_deg=(20.0, 65.0),
    exposure=(-1.8, 1.0),
    tint=(-0.4, 0.4),
    gloss=(0.0, 0.6),
)

KINDS = {"apart": (APART, 7003), "heaps": (SceneRanges(), 7001), "piles": (PILES, 7002)}
"""From what ranges, and the seed of the first set."""

FRAMES: dict[SetName, tuple[int, ...]] = {
    "fit": (70, 50, 40),
    "choose": (40, 30, 24),
    "report": (32, 16, 12),
}
SEEDS_APART = 1000

SMALLER = (1.0, 0.5, 1.0, 0.35)
SPECKED = (False, False, True, True)
"""Of every four frames."""

SPECKS, SPECK_PX, SPECK_M, EMPTY_PX = (5, 20), (3, 10), (0.4, 6.0), 3
"""How many, how large, how far away, and what is without depth round each."""


def draw(name: SetName, models: Path, work: Path) -> list[Path]:
    """The scene folders of a set; what is there already is kept."""
    offset = SEEDS_APART * list(FRAMES).index(name)
    folders = [work / name / kind for kind in KINDS]
    known = bop_models(models, None)
    meshes = {m.name: read_mesh(m.mesh_path, "mm") for m in known}
    ids = {m.name: m.object_id for m in known}
    for folder, (ranges, seed), count in zip(folders, KINDS.values(), FRAMES[name], strict=True):
        write_rendered_set(folder, meshes, ids, count, seed + offset, ranges)
    return folders


def samples(folder: Path) -> Iterator[tuple[Sample, float]]:
    """The frames of a folder as they are used, and how much smaller each is than its labels."""
    scene = BopScene(folder)
    for k, image in enumerate(scene.image_ids):
        frame, smaller = scene.frame(image), SMALLER[k % len(SMALLER)]
        frame = smaller_frame(frame, smaller)
        if SPECKED[k % len(SPECKED)]:
            frame = replace(frame, depth=specked(frame.depth, np.random.default_rng(k)))
        yield Sample(frame, scene.truths(image), scene.name, image), smaller


def scaled(box: Box, scale: float) -> Box:
    """A box in the picture that is so much smaller."""
    return Box(scale * box.x, scale * box.y, scale * box.w, scale * box.h)


def smaller_frame(frame: RgbdFrame, scale: float) -> RgbdFrame:
    """The frame in a picture that is so much smaller."""
    if scale == 1.0:
        return frame
    camera = frame.camera.scaled(scale)
    size = camera.width, camera.height
    color = cv2.resize(frame.color, size, interpolation=cv2.INTER_AREA)
    depth = cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST)
    return RgbdFrame(np.asarray(color, np.uint8), np.asarray(depth, np.float32), camera)


def specked(depth: Float32, rng: np.random.Generator) -> Float32:
    """Depth (H, W) with specks of wrong readings, each with nothing round it."""
    depth = depth.copy()
    height, width = depth.shape
    for _ in range(int(rng.integers(*SPECKS))):
        h, w = (int(n) for n in rng.integers(*SPECK_PX, 2))
        v, u = int(rng.integers(EMPTY_PX, height - h)), int(rng.integers(EMPTY_PX, width - w))
        depth[v - EMPTY_PX : v + h + EMPTY_PX, u - EMPTY_PX : u + w + EMPTY_PX] = 0.0
        depth[v : v + h, u : u + w] = rng.uniform(*SPECK_M) * rng.normal(1.0, 0.002, (h, w))
    return depth
