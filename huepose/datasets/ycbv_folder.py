"""YCB-Video in BOP's layout (`test/`, `test_targets_bop19.json`), and what is missing in a download.

If the folder has the list of targets, only its images count.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from huepose.datasets import files
from huepose.datasets.bop import BopScene, refuse_grey
from huepose.datasets.types import GroundTruth, Scene, SomeImages
from huepose.geometry.frame import RgbdFrame
from huepose.support.errors import InputError

Targets = Mapping[tuple[int, int], Mapping[int, int]]
"""By (scene, image) and object id: number of instances in the list of targets."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """Which of the listed images are on disk. asked: number of listed images by scene; there: how many of
    these are on disk; targets, targets_there: the same for labels, by object id; listed: the file with the
    list, None if there is none."""

    asked: Mapping[int, int]
    there: Mapping[int, int]
    targets: Mapping[int, int] = field(default_factory=dict)
    targets_there: Mapping[int, int] = field(default_factory=dict)
    listed: str | None = None

    def lines(self) -> list[str]:
        """The coverage in words; one line if nothing is missing."""
        if self.listed is None:
            return [
                f"no list of test images: all {sum(self.there.values())} images of "
                f"{len(self.there)} scenes are evaluated"
            ]
        total, found = sum(self.asked.values()), sum(self.there.values())
        labels = f"{sum(self.targets_there.values())} of {sum(self.targets.values())} labels"
        lines = [f"{found} of {total} images of {self.listed} are there, {labels}"]
        gone = [f"{scene:06d}" for scene in sorted(self.asked) if not self.there.get(scene)]
        if gone:
            lines.append(f"missing scenes: {', '.join(gone)}")
        part = [
            f"{scene:06d} ({n - self.there[scene]} of {n})"
            for scene, n in sorted(self.asked.items())
            if 0 < self.there.get(scene, 0) < n
        ]
        if part:
            lines.append(f"missing images: {', '.join(part)}")
        return lines


@dataclass(frozen=True, eq=False)
class YcbvFolder:
    """scenes: limited to the images that count; coverage: what is missing; models: folder of textured meshes,
    None if there is none; info: models_info.json of the meshes for the errors, or None."""

    scenes: tuple[Scene, ...]
    coverage: Coverage
    models: Path | None
    info: Path | None


def open_ycbv(path: Path | str) -> YcbvFolder:
    """Find scenes and models in a download. Raises InputError for a folder with another layout."""
    root = Path(path)
    if not root.is_dir():
        raise InputError(root, found="no such folder", expected="a download of YCB-Video")
    folder = next((d for d in (root / "test", root) if any(d.glob("*/scene_camera.json"))), None)
    if folder is None:
        names = ", ".join(sorted(p.name for p in root.iterdir())[:8]) or "nothing"
        raise InputError(
            root,
            found=names,
            expected="test/NNNNNN/scene_camera.json, as in BOP's YCB-Video",
            fix="Unpack BOP's archive (ycbv_test_bop19.zip), and give the folder that holds it.",
        )
    there = {
        int(p.name): BopScene(p)
        for p in sorted(folder.iterdir())
        if p.name.isdigit() and (p / "scene_gt.json").exists() and (p / "rgb").is_dir()
    }
    if not there:
        for scene in sorted(folder.iterdir()):
            refuse_grey(scene)
        raise InputError(
            folder, found="no scene with rgb/ and scene_gt.json", expected="test/000048 and so on"
        )
    listed = root / "test_targets_bop19.json"
    return YcbvFolder(
        *_chosen(there, read_targets(listed) if listed.exists() else None, listed.name),
        _first(root, ("models", "models_fine", "models_eval")),
        _first(root, ("models_eval/models_info.json", "models/models_info.json")),
    )


def read_targets(path: Path) -> Targets:
    """`test_targets_bop19.json`: a list of scene_id, im_id, obj_id, inst_count. Raises InputError."""
    content = files.read_bytes(path)
    try:
        entries = json.loads(content)
        targets: dict[tuple[int, int], dict[int, int]] = {}
        for entry in entries:
            key = int(entry["scene_id"]), int(entry["im_id"])
            targets.setdefault(key, {})[int(entry["obj_id"])] = int(entry["inst_count"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            path, found=f"{type(error).__name__}: {error}", expected="scene_id, im_id, obj_id, inst_count"
        ) from None
    return targets


def _chosen(
    there: Mapping[int, Scene], targets: Targets | None, listed: str
) -> tuple[tuple[Scene, ...], Coverage]:
    """The scenes limited to the listed images, and the coverage."""
    if targets is None:
        found = {n: len(scene.image_ids) for n, scene in there.items()}
        return tuple(there.values()), Coverage(found, found)
    asked, found = Counter(scene for scene, _ in targets), Counter[int]()
    labels, labels_there = Counter[int](), Counter[int]()
    scenes: list[Scene] = []
    for number in sorted(asked):
        wanted = {image: objects for (scene, image), objects in targets.items() if scene == number}
        on_disk = set(there[number].image_ids) if number in there else set()
        for image, objects in wanted.items():
            labels.update(objects)
            if image in on_disk:
                found[number] += 1
                labels_there.update(objects)
        if found[number]:
            scenes.append(TargetImages(there[number], {i: wanted[i] for i in sorted(wanted) if i in on_disk}))
    if not scenes:
        raise InputError(
            ", ".join(f"{n:06d}" for n in there),
            found=f"no image that {listed} asks for",
            expected=f"some of its {len(targets)} images",
            fix="Give the folder of the test images.",
        )
    return tuple(scenes), Coverage(asked, found, labels, labels_there, listed)


class TargetImages:
    """A scene limited to the listed images, and to the labels of the listed objects."""

    def __init__(self, scene: Scene, wanted: Mapping[int, Mapping[int, int]]) -> None:
        """wanted: by image and object id, the number of labels."""
        self._scene, self._wanted = scene, wanted
        self.name, self.image_ids = scene.name, tuple(wanted)
        self.stamp_ns = scene.stamp_ns

    def frame(self, image: int) -> RgbdFrame:
        """Colour and depth."""
        return self._scene.frame(image)

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        """The labels of the listed objects: of each object the most visible ones, as many as listed."""
        truths, left = self._scene.truths(image), dict(self._wanted[image])
        chosen = set[int]()
        for truth in sorted(truths, key=lambda t: -(t.visib_fract or 0.0)):
            if truth.object_id is not None and left.get(truth.object_id, 0) > 0:
                left[truth.object_id] -= 1
                chosen.add(truth.instance)
        return tuple(t for t in truths if t.instance in chosen)


def spread(scenes: Sequence[Scene], count: int) -> tuple[Scene, ...]:
    """About `count` images: the same share of every scene, evenly spaced, at least one per scene.

    In a scene of YCB-Video all images show the same objects, so the images are also spread evenly over
    objects."""
    total = sum(len(scene.image_ids) for scene in scenes)
    chosen: list[Scene] = []
    for scene in scenes:
        n = len(scene.image_ids)
        few = min(n, max(1, round(count * n / total)))
        images = [scene.image_ids[int((k + 0.5) * n / few)] for k in range(few)]
        chosen.append(SomeImages(scene, images))
    return tuple(chosen)


def _first(root: Path, names: Sequence[str]) -> Path | None:
    return next((root / name for name in names if (root / name).exists()), None)
