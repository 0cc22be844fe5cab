"""Questions that need nothing but the code: the built-in objects, rendered and onboarded here.

Single frames: two heaps with both methods, and three piles (`scenes.rendered`), in the true boxes of what
is visible by 30 % or more. Sequences: 25 frames of the built-in scene (`scenes.builtin`), started at the
true pose: every frame; every fifth frame; and one in which a board occludes everything for ten frames,
after which a correction arrives for a frame that is two frames old.

The frames are some whose answers stay within the tolerances when all kernels are compiled for a processor
without vector extensions (NUMBA_CPU_NAME=generic) and when NumPy does without them
(NPY_DISABLE_CPU_FEATURES=X86_V3). Of the others that were tried (heaps 0 to 6, piles 0 to 9) two poses
rotate by 0.75 degrees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from huepose import Correction, ObjectQuery, ReferenceModel, RgbdFrame
from huepose.geometry import Mesh
from huepose.scenes.camera import CAMERA, COLOR, STEREO
from huepose.scenes.frame import Shot, Stage, shoot
from huepose.scenes.plan import plan
from huepose.scenes.rendered import PILES, rendered_frame
from tests.golden.answers import Answers
from tests.golden.asking import Step, estimated, tracked
from tests.meshes import demo_objects
from tests.onboarded import onboarded

FILE = Path(__file__).parent / "builtin.json"
_SEED = 5
_RATE_HZ = 30.0
_LOOP_FRAMES = 240
_FRAMES = 25
_NUMBERS = {"heaps": (0, 3), "piles": (2, 7, 8)}
_OCCLUDED = range(8, 18)
_LATE = 18, 20
"""The frame that the late estimate is about, and the frame with which it arrives."""


@cache
def meshes() -> Mapping[str, Mesh]:
    """The built-in objects."""
    return demo_objects(_SEED)


@cache
def models() -> Mapping[str, ReferenceModel]:
    """Their reference models, with the tables of the colour-pair methods."""
    return {name: onboarded(mesh, name, paper=True) for name, mesh in meshes().items()}


@cache
def shown(kind: str) -> Sequence[tuple[RgbdFrame, Sequence[ObjectQuery]]]:
    """The frames of heaps or piles, with the queries about them."""
    frames = []
    for number in _NUMBERS[kind]:
        rendered = rendered_frame(meshes(), _SEED, number, PILES if kind == "piles" else None)
        frame = RgbdFrame(rendered.shot.color, rendered.shot.depth, rendered.camera, number)
        labels = rendered.shot.labels
        seen = zip(rendered.names, labels.box_visib, labels.visib_fract, strict=True)
        frames.append((frame, [ObjectQuery(name, box) for name, box, share in seen if box and share >= 0.3]))
    return frames


@cache
def stage() -> Stage:
    """The built-in scene, whose frames are rendered one by one."""
    return plan(meshes(), _SEED, _LOOP_FRAMES, CAMERA)


@cache
def shot(number: int) -> Shot:
    """A frame of the scene; the sequences have some in common."""
    return shoot(stage(), number, _SEED, COLOR, STEREO)


def frames(
    first: int, every: int, names: Sequence[str], occluded: range = range(0)
) -> Iterator[tuple[RgbdFrame, list[Correction]]]:
    """_FRAMES frames of the scene, with the true pose of each object as the first correction about it.
    Frames of these places in the sequence show a board, and have no corrections."""
    order = list(meshes())
    for k, i in enumerate(range(first, first + every * _FRAMES, every)):
        stamp_ns = round(i * 1e9 / _RATE_HZ)
        if k in occluded:
            size = CAMERA.height, CAMERA.width
            color, depth = np.full((*size, 3), 120, np.uint8), np.full(size, 0.35, np.float32)
            yield RgbdFrame(color, depth, CAMERA, i, stamp_ns), []
            continue
        frame = RgbdFrame(shot(i).color, shot(i).depth, CAMERA, i, stamp_ns)
        poses = shot(i).labels.T_cam_obj
        yield frame, [Correction.first(name, poses[order.index(name)], frame, 1.0) for name in names]


def sequence(question: str, first: int, every: int, names: Sequence[str]) -> Answers:
    """A sequence with corrections at its first frame only."""
    steps = (
        Step(frame, truth if k == 0 else ()) for k, (frame, truth) in enumerate(frames(first, every, names))
    )
    return tracked(question, {name: models()[name] for name in names}, steps)


def occluded(question: str, first: int, names: Sequence[str]) -> Answers:
    """All is occluded for ten frames; then a correction comes late."""

    def steps() -> Iterator[Step]:
        late: list[Correction] = []
        for k, (frame, truth) in enumerate(frames(first, 1, names, _OCCLUDED)):
            if k == _LATE[0]:
                late = [replace(correction, seq=2) for correction in truth]
            yield Step(frame, truth if k == 0 else late if k == _LATE[1] else ())

    return tracked(question, {name: models()[name] for name in names}, steps())


def _single(question: str, kind: str, method: str) -> Answers:
    return estimated(question, models(), method, shown(kind))


QUESTIONS: Mapping[str, Callable[[str], Answers]] = {
    "heaps, full": partial(_single, kind="heaps", method="full"),
    "heaps, colorpair": partial(_single, kind="heaps", method="colorpair"),
    "piles, full": partial(_single, kind="piles", method="full"),
    "every frame": partial(sequence, first=60, every=1, names=("tea_box", "corner_bracket")),
    "every fifth frame": partial(sequence, first=60, every=5, names=("soup_can", "parts_tray")),
    "hidden for a while": partial(occluded, first=120, names=("juice_bottle", "tea_box")),
}
"""The questions by name; each is called with its name."""
