"""Answers on disk: how they are written, read and compared.

Tolerances. On one machine the same code gives the same numbers. Another processor or another build of a
library rounds otherwise, which moves a refined pose by far less than a millimetre and changes no decision
unless it was a tie. So a pose may move by 1 mm and 0.5 degrees, which is a tenth of what counts as wrong for
an object of 10 cm, and a quality by 0.02. What is found, and every state, must be the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huepose import RgbdFrame
from huepose.datasets import files
from huepose.evaluation.result_files import write_json
from huepose.geometry import se3

TOLERANCE_MM, TOLERANCE_DEG, TOLERANCE_QUALITY = 1.0, 0.5, 0.02

TOLERANCE_GREY, TOLERANCE_DEPTH_MM = 0.2, 0.5
"""Of the means of a whole image: beyond them it shows something else than when the answers were written."""

Key = tuple[str, int, str]


@dataclass(frozen=True, eq=False)
class Answer:
    """One object in one frame of one question; T_cam_obj (4, 4) or None without a pose."""

    question: str
    frame: int
    object: str
    state: str
    quality: float
    T_cam_obj: np.ndarray | None

    @property
    def key(self) -> Key:
        """What identifies the answer."""
        return self.question, self.frame, self.object


@dataclass(frozen=True)
class ImageMeans:
    """A frame in four numbers: the means of its colours, 0..255, and of its depth in millimetres."""

    question: str
    frame: int
    rgb: tuple[float, float, float]
    depth_mm: float

    @staticmethod
    def of(question: str, frame: RgbdFrame) -> ImageMeans:
        """The means of a frame of a question."""
        red, green, blue = (float(mean) for mean in frame.color.mean((0, 1)))
        return ImageMeans(question, frame.frame_id, (red, green, blue), float(1000.0 * frame.depth.mean()))


@dataclass(frozen=True, eq=False)
class Answers:
    """All answers, and the means of the images that they are about."""

    answers: Sequence[Answer]
    images: Sequence[ImageMeans]

    def of(self, question: str) -> Answers:
        """The part of one question."""
        return Answers(
            [a for a in self.answers if a.question == question],
            [p for p in self.images if p.question == question],
        )


def together(parts: Iterable[Answers]) -> Answers:
    """The answers to several questions."""
    parts = list(parts)
    return Answers([a for p in parts for a in p.answers], [v for p in parts for v in p.images])


def write(path: Path, answers: Answers) -> None:
    """Write one answer per line."""
    rows = [
        {
            "question": a.question,
            "frame": a.frame,
            "object": a.object,
            "state": a.state,
            "quality": round(a.quality, 5),
            "xyz_m": None if a.T_cam_obj is None else np.round(a.T_cam_obj[:3, 3], 6),
            "xyzw": None
            if a.T_cam_obj is None
            else np.round(se3.quaternion_from_rotation(a.T_cam_obj[:3, :3]), 6),
        }
        for a in answers.answers
    ]
    shown = [
        {
            "question": p.question,
            "frame": p.frame,
            "rgb": np.round(p.rgb, 3),
            "depth_mm": round(p.depth_mm, 3),
        }
        for p in answers.images
    ]
    write_json(path, {"answers": rows, "pictures": shown})


def read(path: Path) -> Answers:
    """What `write` wrote. Raises InputError for a file that is missing or broken."""
    record = files.read_json(path, "Make it with `python -m tests.golden.write`.")
    return Answers(
        [
            Answer(row["question"], row["frame"], row["object"], row["state"], row["quality"], _pose(row))
            for row in files.field(record, "answers", path)
        ],
        [
            ImageMeans(row["question"], row["frame"], tuple(row["rgb"]), row["depth_mm"])
            for row in files.field(record, "pictures", path)
        ],
    )


def _pose(row: Mapping[str, Any]) -> np.ndarray | None:
    if row["xyz_m"] is None:
        return None
    return se3.make(se3.rotation_from_quaternion(np.array(row["xyzw"])), np.array(row["xyz_m"]))


def differences(expected: Answers, got: Answers) -> list[str]:
    """What is beyond the tolerances, in words: only of images if these differ, else of answers."""
    return _images(expected, got) or _answers(expected, got)


def _images(expected: Answers, got: Answers) -> list[str]:
    new = {(p.question, p.frame): p for p in got.images}
    found = []
    for old in expected.images:
        other = new.get((old.question, old.frame))
        if other is None:
            found.append(f"{old.question}, frame {old.frame}: not asked any more")
            continue
        grey = max(abs(a - b) for a, b in zip(old.rgb, other.rgb, strict=True))
        depth_mm = abs(old.depth_mm - other.depth_mm)
        if not (grey <= TOLERANCE_GREY and depth_mm <= TOLERANCE_DEPTH_MM):
            found.append(
                f"{old.question}, frame {old.frame}: another image (mean colours differ by {grey:.2f}, "
                f"mean depth by {depth_mm:.2f} mm), so its answers say nothing about the vision"
            )
    return found


def _answers(expected: Answers, got: Answers) -> list[str]:
    new = {a.key: a for a in got.answers}
    known = {a.key for a in expected.answers}
    found = [f"{key[0]}, frame {key[1]}, {key[2]}: not expected" for key in new if key not in known]
    for old in expected.answers:
        where = f"{old.question}, frame {old.frame}, {old.object}"
        other = new.get(old.key)
        if other is None:
            found.append(f"{where}: no answer")
            continue
        if old.state != other.state:
            found.append(f"{where}: state {old.state} before, {other.state} now")
        if not abs(old.quality - other.quality) <= TOLERANCE_QUALITY:
            found.append(f"{where}: quality {old.quality:.3f} before, {other.quality:.3f} now")
        moved = distance(old.T_cam_obj, other.T_cam_obj)
        if moved is None:
            if (old.T_cam_obj is None) != (other.T_cam_obj is None):
                found.append(f"{where}: {'no ' if old.T_cam_obj is None else 'a '}pose before, not so now")
        elif not (moved[0] <= TOLERANCE_MM and moved[1] <= TOLERANCE_DEG):
            found.append(f"{where}: the pose moved by {moved[0]:.2f} mm and {moved[1]:.2f} degrees")
    return found


def distance(a: np.ndarray | None, b: np.ndarray | None) -> tuple[float, float] | None:
    """Millimetres and degrees between two poses; None unless there are both."""
    if a is None or b is None:
        return None
    return 1000.0 * float(np.linalg.norm(a[:3, 3] - b[:3, 3])), float(np.degrees(se3.rotation_angle(a, b)))


def largest(expected: Answers, got: Answers) -> str:
    """How far apart the answers are that both have, in words."""
    new = {a.key: a for a in got.answers}
    pairs = [(a, new[a.key]) for a in expected.answers if a.key in new]
    moved = [m for a, b in pairs if (m := distance(a.T_cam_obj, b.T_cam_obj)) is not None]
    mm, deg = (max((m[k] for m in moved), default=0.0) for k in (0, 1))
    quality = max((abs(a.quality - b.quality) for a, b in pairs), default=0.0)
    states = sum(a.state != b.state for a, b in pairs)
    return (
        f"{len(pairs)} answers, poses apart by at most {mm:.3g} mm and {deg:.3g} degrees, qualities by at "
        f"most {quality:.3g}, {states} states differ"
    )
