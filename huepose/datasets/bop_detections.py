"""Detections in the format of the BOP challenge: a JSON list of boxes with scores, as of CNOS.

https://bop.felk.cvut.cz/challenges/bop-challenge-2023/: `scene_id`, `image_id`, `category_id` (the object),
`bbox` (x, y, width, height, pixels), `score`; masks and times are not read.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from huepose.datasets import files
from huepose.geometry.arrays import Float64
from huepose.geometry.box import Box
from huepose.support.errors import InputError


@dataclass(frozen=True, eq=False)
class BopDetection:
    """A box of an object in an image, or its pose T_cam_obj (4, 4); score: higher is better."""

    object_id: int
    box: Box | None
    score: float
    T_cam_obj: Float64 | None = None


@dataclass(frozen=True)
class BopDetections:
    """Detections by (scene, image), in order of decreasing score."""

    by_image: Mapping[tuple[int, int], Sequence[BopDetection]]

    def of(self, scene: str, image: int) -> Sequence[BopDetection]:
        """The detections of an image; none if the scene's name is not a number."""
        return self.by_image.get((int(scene), image), ()) if scene.isdigit() else ()

    @staticmethod
    def ordered(found: Iterable[tuple[int, int, BopDetection]]) -> BopDetections:
        """From (scene, image, detection) in any order."""
        by_image: dict[tuple[int, int], list[BopDetection]] = {}
        for scene, image, one in sorted(found, key=lambda item: -item[2].score):
            by_image.setdefault((scene, image), []).append(one)
        return BopDetections(by_image)


def read_detections(path: Path | str) -> BopDetections:
    """Read a file. Raises InputError, naming the entry."""
    content = files.read_bytes(Path(path))
    try:
        entries = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(path, found=f"no valid JSON ({str(error)[:80]})") from None
    if not isinstance(entries, list):
        raise InputError(path, found=f"a JSON {type(entries).__name__}", expected="a list of detections")
    found = []
    for number, entry in enumerate(entries):
        where = f"{path}, entry {number}"
        scene, image, object_id = (
            int(files.numbers(entry, key, (), where)) for key in ("scene_id", "image_id", "category_id")
        )
        box = Box(*(float(v) for v in files.numbers(entry, "bbox", (4,), where)))
        score = float(files.numbers(entry, "score", (), where))
        found.append((scene, image, BopDetection(object_id, box, score)))
    return BopDetections.ordered(found)
