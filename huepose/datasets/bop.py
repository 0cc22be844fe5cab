"""Scenes in the layout of the BOP benchmark: `rgb/`, `depth/`, `mask_visib/`, `scene_*.json`.

https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md: translations are millimetres,
`depth_scale` takes a depth value to millimetres, `cam_K` is per image. Beyond the format, `timestamp_ns`
in `scene_camera.json` is the capture time, and `object` in `scene_gt.json` the reference model's name.
Scenes without labels, label details or masks can be read, too.
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets import files
from huepose.datasets.types import GroundTruth
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAREST_M, Camera
from huepose.geometry.frame import RgbdFrame
from huepose.support.errors import InputError
from huepose.support.words import counted, listed

_HOLDS = (
    "The folder of a scene has rgb/000000.png ..., depth/000000.png ... (16 bit) and scene_camera.json: "
    '{"0": {"cam_K": [fx, 0, cx, 0, fy, cy, 0, 0, 1], "depth_scale": 1.0}, ...}, an entry for each image; '
    "depth_scale is millimetres per depth value"
)
"""Required content of a scene folder, in words."""


def _scenes_in(folder: Path) -> list[str]:
    """The scenes in a folder or its subfolders (`test/000048`), as relative paths."""
    cameras = [*folder.glob("*/scene_camera.json"), *folder.glob("*/*/scene_camera.json")]
    return sorted(str(path.parent.relative_to(folder)) for path in cameras)


def refuse_grey(scene: Path) -> None:
    """Raises InputError for a scene folder with grey images and none in colour."""
    if not (scene / "rgb").is_dir() and (scene / "gray").is_dir():
        raise InputError(
            scene,
            found="grey images, gray/ and no rgb/",
            expected="colour images in rgb/",
            fix="HuePose needs colour: use a data set with colour.",
        )


class BopScene:
    """One scene folder. `image_ids`: the images on disk, in numeric order; `name`: the folder's name."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        if not self.path.is_dir():
            raise InputError(
                self.path, found="no such folder", expected="a BOP scene folder", fix=f"{_HOLDS}."
            )
        if not (self.path / "rgb").is_dir() and (scenes := _scenes_in(self.path)):
            raise InputError(
                self.path,
                found=f"a folder of {counted(len(scenes), 'scene')}: {listed(scenes)}",
                expected=f"the folder of one scene, for example {self.path / scenes[0]}",
            )
        refuse_grey(self.path)
        self.name = files.folder_name(self.path)
        self._colors = files.numbered_files(self.path / "rgb")
        self._cameras = files.read_json(self.path / "scene_camera.json", f"{_HOLDS}.")
        self._labels = self._optional("scene_gt.json")
        self._details = self._optional("scene_gt_info.json")
        if not self._colors:
            raise InputError(
                self.path / "rgb", found="no image named by a number", expected="000000.png or .jpg"
            )

    def _optional(self, name: str) -> dict[str, Any]:
        path = self.path / name
        return files.read_json(path) if path.exists() else {}

    @property
    def image_ids(self) -> tuple[int, ...]:
        """Numbers of the images on disk, ascending."""
        return tuple(self._colors)

    @property
    def labelled(self) -> bool:
        """The scene has ground truth."""
        return bool(self._labels)

    def has_labels(self, image: int) -> bool:
        """Whether an image is labelled, possibly with no object."""
        return str(image) in self._labels

    def gaps(self) -> list[str]:
        """Missing images and camera entries, one sentence for each part of the folder; no image is read."""
        stems = [path.stem for path in self.path.glob("depth/*.png") if path.stem.isdecimal()]
        # A depth image has the name of its colour image.
        depths = {int(stem) for stem in stems if self._colors.get(int(stem), Path(stem)).stem == stem}
        numbers = {*self._colors, *depths}
        parts: dict[str, Collection[int]] = {"rgb/": self._colors, "depth/": depths}
        parts["scene_camera.json with cam_K and depth_scale"] = [n for n in numbers if self._has_camera(n)]
        return files.gaps(self.path, parts, numbers)

    def _camera_record(self, image: int) -> tuple[dict[str, Any], str]:
        path = self.path / "scene_camera.json"
        record, where = files.field(self._cameras, str(image), path), f"{path}, image {image}"
        if not isinstance(record, dict):
            raise InputError(where, found=repr(record)[:60], expected="an object with cam_K and depth_scale")
        return record, where

    def _has_camera(self, image: int) -> bool:
        record = self._cameras.get(str(image))
        return isinstance(record, dict) and {"cam_K", "depth_scale"} <= record.keys()

    def stamp_ns(self, image: int) -> int:
        """`timestamp_ns` if the scene has it, else the time of the image number at 30 Hz."""
        record, where = self._camera_record(image)
        if "timestamp_ns" not in record:
            return files.stamp_at_30_hz(image)
        stamp = record["timestamp_ns"]
        if not isinstance(stamp, int):
            raise InputError(where, found=f"timestamp_ns {stamp!r}", expected="whole nanoseconds")
        return stamp

    def frame(self, image: int) -> RgbdFrame:
        """Colour and depth of an image. Raises InputError, naming the file."""
        record, where = self._camera_record(image)
        if image not in self._colors:
            raise InputError(self.path / "rgb", found=f"no image {image}", expected="a number in `image_ids`")
        color_path = self._colors[image]
        depth_path = self.path / "depth" / f"{color_path.stem}.png"
        color = files.read_color(color_path)
        depth = files.read_depth(depth_path, files.positive(record, "depth_scale", where) / 1000.0)
        files.same_size(color, color_path, depth, depth_path)
        K = files.pinhole(files.numbers(record, "cam_K", (3, 3), where), where)
        camera = Camera.from_matrix(K, color.shape[1], color.shape[0])
        return RgbdFrame(color, depth, camera, frame_id=image, stamp_ns=self.stamp_ns(image))

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        """The labels of an image; empty if it has none. Raises InputError."""
        if self._farthest_mm is not None and self._farthest_mm < 1000.0 * NEAREST_M:
            raise InputError(
                self.path / "scene_gt.json",
                found=f"no object farther from the camera than {self._farthest_mm:.3g} mm",
                expected="cam_t_m2c in millimetres",
                fix="If your positions are in metres, multiply them by 1000.",
            )
        labels = self._entries(self._labels, image, "scene_gt.json")
        details = self._entries(self._details, image, "scene_gt_info.json")
        if details and len(details) != len(labels):
            raise InputError(
                self.path / "scene_gt_info.json",
                found=f"{len(details)} entries for image {image}",
                expected=f"{len(labels)} as in scene_gt.json",
                fix="Both files must come from the same scene.",
            )
        return tuple(
            self._truth(image, i, label, details[i] if details else {}) for i, label in enumerate(labels)
        )

    @cached_property
    def _farthest_mm(self) -> float | None:
        """Distance of the farthest label from the camera; None if no label has a position other than 0."""
        distances = []
        for label in (
            one for of_image in self._labels.values() if isinstance(of_image, list) for one in of_image
        ):
            with suppress(InputError):  # raised again when this label is read
                distances.append(float(np.linalg.norm(files.numbers(label, "cam_t_m2c", (3,), ""))))
        return max(distances, default=0.0) or None

    def _entries(self, records: dict[str, Any], image: int, name: str) -> list[dict[str, Any]]:
        entries = records.get(str(image), [])
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise InputError(
                f"{self.path / name}, image {image}", found=repr(entries)[:60], expected="a list of objects"
            )
        return entries

    def _truth(self, image: int, instance: int, label: dict[str, Any], detail: dict[str, Any]) -> GroundTruth:
        where = f"{self.path / 'scene_gt.json'}, image {image}, instance {instance}"
        R = files.numbers(label, "cam_R_m2c", (3, 3), where)
        t_m = files.numbers(label, "cam_t_m2c", (3,), where) / 1000.0
        where_detail = f"{self.path / 'scene_gt_info.json'}, image {image}, instance {instance}"
        visib, box = None, None
        if detail.get("visib_fract") is not None:
            visib = float(files.numbers(detail, "visib_fract", (), where_detail))
        if detail.get("bbox_visib") is not None:
            box = Box(*(float(v) for v in files.numbers(detail, "bbox_visib", (4,), where_detail)))
        mask_path = self.path / "mask_visib" / f"{image:06d}_{instance:06d}.png"
        return GroundTruth(
            instance=instance,
            T_cam_obj=files.rigid(R, t_m, where),
            object_id=int(files.numbers(label, "obj_id", (), where)),
            object=name if isinstance(name := label.get("object"), str) else None,
            visib_fract=visib,
            box_visib=box if box is not None and box.w > 0 and box.h > 0 else None,
            mask_loader=partial(files.read_mask, mask_path) if mask_path.exists() else None,
        )
