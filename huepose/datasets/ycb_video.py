"""A sequence of the YCB-Video data set as published: `N-color.png`, `-depth.png`, `-label.png`, `-meta.mat`.

`meta.mat` holds `factor_depth` (depth values in a metre), `intrinsic_matrix`, `cls_indexes` (ids as in BOP)
and `poses` 3x4xN in metres, in the model frame of PoseCNN: T_cam_bop = T_cam_posecnn Trans(-offset).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets import files
from huepose.datasets.types import GroundTruth
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.support.errors import InputError


class YcbVideoSequence:
    """One sequence folder (`0048`). frame_offsets_m: by object id, the translation (3,) that takes a point of
    the PoseCNN frame to the reference model's; labels of other ids have no pose (None)."""

    def __init__(self, path: Path | str, frame_offsets_m: Mapping[int, Float]) -> None:
        self.path = Path(path)
        self.name = files.folder_name(self.path)
        self._offsets = dict(frame_offsets_m)
        self._colors = files.numbered_files(self.path, "-color")
        if not self._colors:
            raise InputError(
                self.path, found="no image", expected="000001-color.png and so on, as YCB-Video is published"
            )

    @property
    def image_ids(self) -> tuple[int, ...]:
        """Numbers of the images on disk, ascending."""
        return tuple(self._colors)

    def stamp_ns(self, image: int) -> int:
        """The image number at 30 Hz: the set has no time stamps."""
        return files.stamp_at_30_hz(image)

    def _part(self, image: int, ending: str) -> Path:
        if image not in self._colors:
            raise InputError(self.path, found=f"no image {image}", expected="a number in `image_ids`")
        stem = self._colors[image].stem
        return self.path / f"{stem[: -len('-color')]}-{ending}"

    def _meta(self, image: int) -> tuple[dict[str, Any], Path]:
        from scipy.io import loadmat

        path = self._part(image, "meta.mat")
        files.read_bytes(path)
        try:
            return loadmat(path), path
        except Exception as error:
            raise InputError(path, found=f"no readable MATLAB file ({error})", fix="Copy it again.") from None

    def frame(self, image: int) -> RgbdFrame:
        """Colour and depth of an image. Raises InputError, naming the file."""
        meta, where = self._meta(image)
        color_path, depth_path = self._colors[image], self._part(image, "depth.png")
        color = files.read_color(color_path)
        depth = files.read_depth(depth_path, 1.0 / files.positive(meta, "factor_depth", where))
        files.same_size(color, color_path, depth, depth_path)
        K = files.numbers(meta, "intrinsic_matrix", (3, 3), where)
        camera = Camera.from_matrix(K, color.shape[1], color.shape[0])
        return RgbdFrame(color, depth, camera, frame_id=image, stamp_ns=self.stamp_ns(image))

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        """The labels of an image."""
        meta, where = self._meta(image)
        ids = np.asarray(files.field(meta, "cls_indexes", where)).ravel().astype(int)
        poses = files.numbers(meta, "poses", (3, 4, len(ids)), where) if len(ids) else np.empty((3, 4, 0))
        has_labels = self._part(image, "label.png").exists()
        truths = []
        for instance, object_id in enumerate(ids.tolist()):
            T_cam_obj = None
            if object_id in self._offsets:
                T_cam_posecnn = files.rigid(poses[:, :3, instance], poses[:, 3, instance], where)
                T_cam_obj = se3.compose(
                    T_cam_posecnn, se3.make(np.eye(3), -np.asarray(self._offsets[object_id]))
                )
            loader = partial(self._mask_of, image, object_id) if has_labels else None
            truths.append(GroundTruth(instance, T_cam_obj, object_id=object_id, mask_loader=loader))
        return tuple(truths)

    def _mask_of(self, image: int, object_id: int) -> Bool:
        return np.asarray(files.read_labels(self._part(image, "label.png")) == object_id)
