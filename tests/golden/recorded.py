"""Questions about recorded and path-traced frames, which are no part of the project.

The environment variable HUEPOSE_DATA names a folder with

    models/                     YCB objects in millimetres: obj_NNNNNN.obj, models_info.json
    ycbv/, clutter/, hard/      BOP scenes: real YCB-Video frames, path-traced clutter, path-traced piles
    video/mustard0_a            a real video of a mustard bottle as a BOP scene

Single frames: two of each set, in the true boxes of eight of the objects where they are visible by
30 % or more, with both methods. Sequence: the video at every fifth frame, started at its first label.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from huepose import Correction, ObjectQuery, ReferenceModel, RgbdFrame
from huepose.datasets import files
from huepose.datasets.bop import BopScene
from huepose.datasets.types import GroundTruth
from huepose.onboarding import read_mesh
from tests.golden.answers import Answers
from tests.golden.asking import METHODS, Step, estimated, tracked
from tests.onboarded import onboarded

FILE = Path(__file__).parent / "recorded.json"
VARIABLE = "HUEPOSE_DATA"
IDS = (2, 3, 5, 7, 9, 17, 18, 19)
_FRAMES = {
    "ycbv": (("000001", 3), ("000002", 3)),
    "clutter": (("000001", 0), ("000003", 1)),
    "hard": (("000002", 0), ("000002", 5)),
}
_VIDEO, _VIDEO_ID, _EVERY = "video/mustard0_a", 5, 5


def missing() -> str | None:
    """Why the questions cannot be asked; None if they can."""
    folder = os.environ.get(VARIABLE)
    if not folder:
        return (
            f"because {VARIABLE} names no folder with recorded frames (tests/golden/recorded.py says which)"
        )
    wanted = ["models", *(f"{name}/{scene}" for name, asked in _FRAMES.items() for scene, _ in asked), _VIDEO]
    absent = [name for name in wanted if not (Path(folder) / name).is_dir()]
    return f"because {VARIABLE}={folder} has no folder {absent[0]}" if absent else None


def _folder() -> Path:
    return Path(os.environ[VARIABLE])


@cache
def model(number: int) -> ReferenceModel:
    """One of the objects, onboarded; its name is that of its file."""
    name = f"obj_{number:06d}"
    info = files.read_json(_folder() / "models" / "models_info.json").get(str(number))
    mesh = _folder() / "models" / f"{name}.obj"
    return onboarded(read_mesh(mesh, "mm"), name, object_id=number, info=info, paper=True)


def _shown(name: str) -> list[tuple[RgbdFrame, list[GroundTruth]]]:
    """The frames of a set, with the labels that are asked about."""
    frames = []
    for number, (scene, image) in enumerate(_FRAMES[name]):
        opened = BopScene(_folder() / name / scene)
        truths = [t for t in opened.truths(image) if t.object_id in IDS and t.visible and t.box_visib]
        # Numbered by their place in the list: two scenes may have an image of the same number.
        frames.append((replace(opened.frame(image), frame_id=number), truths))
    return frames


def _single(question: str, name: str, method: str) -> Answers:
    shown = _shown(name)
    models = {m.name: m for m in (model(t.object_id) for _, truths in shown for t in truths if t.object_id)}
    asked: list[tuple[RgbdFrame, Sequence[ObjectQuery]]] = [
        (frame, [ObjectQuery(model(t.object_id).name, t.box_visib, instance=t.instance) for t in truths])
        for frame, truths in shown
    ]
    return estimated(question, models, method, asked)


def _video(question: str) -> Answers:
    bottle, scene = model(_VIDEO_ID), BopScene(_folder() / _VIDEO)

    def steps() -> Iterator[Step]:
        for k, image in enumerate(scene.image_ids[::_EVERY]):
            frame = scene.frame(image)
            (truth,) = [t for t in scene.truths(image) if t.object_id == _VIDEO_ID]
            yield Step(frame, [Correction.first(bottle.name, truth.T_cam_obj, frame, 1.0)] if k == 0 else ())

    return tracked(question, {bottle.name: bottle}, steps())


QUESTIONS: Mapping[str, Callable[[str], Answers]] = {
    **{
        f"{name}, {method}": partial(_single, name=name, method=method)
        for name in _FRAMES
        for method in METHODS
    },
    "video, every fifth frame": _video,
}
"""The questions by name; each is called with its name."""
