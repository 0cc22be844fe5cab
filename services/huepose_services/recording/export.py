"""A recording as a BOP scene: `rgb`, `depth`, `scene_camera.json`, the poses in `poses.jsonl`, and, if the
truth is known, `scene_gt.json` and `scene_gt_info.json`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import msgspec

from huepose.support.errors import InputError
from huepose.support.files import whole, write_bytes, write_text, writing
from huepose.support.progress import progress
from huepose.support.words import counted
from huepose_protos import to_json
from huepose_protos.buffers import frame_images
from huepose_protos.keys import tail_of
from huepose_protos.messages import FrameHeader, PoseMessage, TruthMessage, TruthObject
from huepose_services.convert import pose_from_wire
from huepose_services.recording.parts import GIVEN
from huepose_services.recording.read import Event

_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


@dataclass(frozen=True)
class Exported:
    """How many frames were written, how many of them with labels, and how many had their labels left out."""

    frames: int
    labelled: int
    left_out: int

    @property
    def text(self) -> str:
        """The counts in words."""
        parts = [counted(self.frames, "frame")]
        if self.labelled or self.left_out:
            parts.append(f"the truth of {self.labelled}")
        if self.left_out:
            why = "in which an object has no pose, or neither name nor number"
            parts.append(f"that of {self.left_out} left out, {why}")
        return "; ".join(parts)


def export_bop(events: Iterable[Event], folder: Path) -> Exported:
    """Write a recording to a new or empty folder. Frames keep their numbers; if the camera was opened
    again, its numbers continue, and all poses name the first epoch. Labels name their objects; objects
    without a BOP number get free ones.

    If it is interrupted or fails, it empties the folder, or removes one that it made. Raises InputError for a
    folder that is not empty, or cannot be made, and for a full disk."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(folder, found="something there", expected="a new or empty folder")
    made = not folder.exists()
    with writing(folder):
        for name in ("rgb", "depth"):
            (folder / name).mkdir(parents=True)
    try:
        return _exported(events, folder)
    except BaseException:
        for path in list(folder.iterdir()):
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
        if made:
            folder.rmdir()
        raise


def _exported(events: Iterable[Event], folder: Path) -> Exported:
    cameras: dict[str, Any] = {}
    truths: dict[str, list[Any]] = {}
    details: dict[str, list[Any]] = {}
    # Image numbers are frame numbers plus an offset for each camera epoch.
    begins: dict[int, int] = {}
    following = 0
    left_out = set[str]()
    with whole(folder / "poses.jsonl") as part, part.open("w") as poses:
        for event in progress(events, f"{folder}: messages"):
            message = event.message
            if not isinstance(message, FrameHeader | PoseMessage | TruthMessage):
                continue
            if tail_of(event.key) == GIVEN:
                continue
            number = begins.setdefault(message.camera_epoch, following) + message.frame_id
            following = max(following, number + 1)
            if isinstance(message, FrameHeader):
                if str(number) not in cameras:
                    _write_images(folder, number, message, event.payload)
                    cameras[str(number)] = _camera(message)
            elif isinstance(message, PoseMessage):
                epoch = next(iter(begins))
                pose = msgspec.structs.replace(message, camera_epoch=epoch, frame_id=number)
                poses.write(to_json(pose) + "\n")
            elif all(_is_label(o) for o in message.objects):
                truths[str(number)], details[str(number)] = _labels(message)
            else:
                left_out.add(str(number))
    write_text(folder / "scene_camera.json", json.dumps(cameras))
    truths = {number: labels for number, labels in truths.items() if number in cameras}
    _number_objects([label for labels in truths.values() for label in labels])
    if truths:
        write_text(folder / "scene_gt.json", json.dumps(truths))
        write_text(folder / "scene_gt_info.json", json.dumps({n: details[n] for n in truths}))
    return Exported(len(cameras), len(truths), len(left_out & cameras.keys()))


def _write_images(folder: Path, number: int, header: FrameHeader, payload: bytes) -> None:
    color, depth = frame_images(header, payload)
    for name, image in (("rgb", cv2.cvtColor(color, cv2.COLOR_RGB2BGR)), ("depth", depth)):
        write_bytes(folder / name / f"{number:06d}.png", cv2.imencode(".png", image, _PNG)[1].tobytes())


def _camera(header: FrameHeader) -> dict[str, Any]:
    i = header.intrinsics
    return {
        "cam_K": [i.fx, 0.0, i.cx, 0.0, i.fy, i.cy, 0.0, 0.0, 1.0],
        # Millimetres for one step of depth.
        "depth_scale": i.depth_scale_m * 1000.0,
        "timestamp_ns": header.capture_ns,
    }


def _is_label(one: TruthObject) -> bool:
    return one.translation is not None and (one.object_id is not None or one.object is not None)


def _number_objects(labels: list[dict[str, Any]]) -> None:
    """Give numbers to objects that have only a name: BOP needs numbers."""
    highest = max((label["obj_id"] for label in labels if label["obj_id"] is not None), default=0)
    names = sorted({label["object"] for label in labels if label["obj_id"] is None})
    for label in labels:
        if label["obj_id"] is None:
            label["obj_id"] = highest + 1 + names.index(label["object"])


def _labels(message: TruthMessage) -> tuple[list[Any], list[Any]]:
    labels, details = [], []
    for o in sorted(message.objects, key=lambda one: one.instance):
        assert o.translation is not None
        assert o.quaternion is not None
        T_cam_obj = pose_from_wire(o.translation, o.quaternion)
        labels.append(
            {
                "cam_R_m2c": T_cam_obj[:3, :3].ravel().tolist(),
                "cam_t_m2c": [1000.0 * v for v in o.translation],
                "obj_id": o.object_id,
                "object": o.object,
            }
        )
        box = [-1, -1, -1, -1] if o.box is None else list(o.box)
        details.append({"visib_fract": o.visib_fract, "bbox_visib": box})
    return labels, details
