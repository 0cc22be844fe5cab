"""A recording's folder: a BOP scene (`rgb`, `depth`, `scene_camera.json`, `scene_gt.json`), and messages.

`poses.jsonl` holds pose messages, `messages.jsonl` the others with the ends of their keys, a JSON object a
line. A picture gets its name only when `scene_camera.json` knows it, and files are replaced at once, so
whatever ends the recording, what is there by name is whole.
"""

from __future__ import annotations

import json
import os
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.support.errors import InputError
from huepose.support.files import write_text
from huepose_protos import to_json
from huepose_protos.buffers import Array
from huepose_protos.keys import tail_of
from huepose_protos.messages import FrameHeader, Message, PoseMessage, TruthMessage

POSES, MESSAGES = "poses.jsonl", "messages.jsonl"
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
_HALF_WRITTEN = ".part"
# Frames that wait for the disk: more are dropped, so that memory is bounded.
_MAX_WAITING = 16


class SceneWriter:
    """Takes frames and messages; `commit()` makes them last. `dropped`: frames that came too fast.

    Raises InputError for a folder that cannot be made or that has something in it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(folder, found="something there", expected="a new or empty folder")
        try:
            for name in ("rgb", "depth"):
                (folder / name).mkdir(parents=True, exist_ok=True)
            self._poses = (folder / POSES).open("ab", buffering=0)
            self._messages = (folder / MESSAGES).open("ab", buffering=0)
        except OSError as error:
            raise InputError(folder, found=error.strerror or str(error), expected="a new folder") from None
        self.frames = self.dropped = self.bytes = 0
        self._pool = ThreadPoolExecutor(2, "png")
        self._waiting: list[tuple[int, Future[int]]] = []
        self._cameras: dict[str, Any] = {}
        self._truths: dict[str, list[Any]] = {}
        self._details: dict[str, list[Any]] = {}
        self._lines: dict[Any, list[str]] = {self._poses: [], self._messages: []}

    def frame(self, header: FrameHeader, color: Array, depth: Array) -> None:
        """A frame, whose number is that of its image."""
        if len(self._waiting) - sum(f.done() for _, f in self._waiting) >= _MAX_WAITING:
            self.dropped += 1
            return
        number, i = header.frame_id, header.intrinsics
        self._waiting.append((number, self._pool.submit(self._pictures, number, color, depth)))
        self._cameras[str(number)] = {
            "cam_K": [i.fx, 0.0, i.cx, 0.0, i.fy, i.cy, 0.0, 0.0, 1.0],
            # Millimetres for one step of depth.
            "depth_scale": i.depth_scale_m * 1000.0,
            "timestamp_ns": header.capture_ns,
        }

    def _pictures(self, number: int, color: Array, depth: Array) -> int:
        """Write both under names that nobody reads yet; returns their bytes."""
        total = 0
        for name, image in (("rgb", cv2.cvtColor(color, cv2.COLOR_RGB2BGR)), ("depth", depth)):
            _, png = cv2.imencode(".png", image, _PNG)
            self._path(name, number, _HALF_WRITTEN).write_bytes(png.tobytes())
            total += png.nbytes
        return total

    def _path(self, name: str, number: int, suffix: str = "") -> Path:
        return self.folder / name / f"{number:06d}.png{suffix}"

    def message(self, key: str, message: Message) -> None:
        """A message without pixels."""
        if isinstance(message, TruthMessage):
            self._truth(message)
        elif isinstance(message, PoseMessage):
            self._lines[self._poses].append(to_json(message) + "\n")
        else:
            self._lines[self._messages].append(
                f'{{"key":{json.dumps(tail_of(key))},"message":{to_json(message)}}}\n'
            )

    def _truth(self, message: TruthMessage) -> None:
        labels, details = [], []
        for o in sorted(message.objects, key=lambda one: one.instance):
            if o.translation is None or o.quaternion is None or o.object_id is None:
                return  # the layout has no place for half a label
            labels.append(
                {
                    "cam_R_m2c": _rotation(o.quaternion).ravel().tolist(),
                    "cam_t_m2c": [1000.0 * v for v in o.translation],
                    "obj_id": o.object_id,
                }
            )
            box = [-1, -1, -1, -1] if o.box is None else list(o.box)
            details.append({"visib_fract": o.visib_fract, "bbox_visib": box})
        self._truths[str(message.frame_id)] = labels
        self._details[str(message.frame_id)] = details

    def commit(self, wait: bool = False) -> float:
        """Make what is complete last; with `wait`, all that was given. Returns the seconds that it took.

        Raises OSError, when the disk is full for example; what was committed before stays whole."""
        started = time.monotonic()
        ready = [one for one in self._waiting if wait or one[1].done()]
        sizes = [future.result() for _, future in ready]
        kept = {str(number) for number, _ in ready} | {str(n) for n in self._written()}
        if ready:
            cameras = {number: c for number, c in self._cameras.items() if number in kept}
            write_text(self.folder / "scene_camera.json", json.dumps(cameras))
        for number, _ in ready:
            for name in ("depth", "rgb"):
                os.replace(self._path(name, number, _HALF_WRITTEN), self._path(name, number))
        self._waiting = [one for one in self._waiting if one not in ready]
        self.frames += len(ready)
        self.bytes += sum(sizes)
        for file, lines in self._lines.items():
            data = "".join(lines).encode()
            lines.clear()
            if data:
                self.bytes += file.write(data)
        if self._truths:
            for name, labels in (("scene_gt.json", self._truths), ("scene_gt_info.json", self._details)):
                write_text(self.folder / name, json.dumps({n: v for n, v in labels.items() if n in kept}))
        return time.monotonic() - started

    def _written(self) -> list[int]:
        waiting = {number for number, _ in self._waiting}
        return [int(number) for number in self._cameras if int(number) not in waiting]

    def close(self) -> None:
        """Commit the rest, and leave nothing half-written. Raises OSError."""
        try:
            self.commit(wait=True)
        finally:
            self._pool.shutdown()
            self._poses.close()
            self._messages.close()
            for part in self.folder.glob(f"*/*{_HALF_WRITTEN}"):
                part.unlink()


def _rotation(quaternion: tuple[float, float, float, float]) -> Array:
    from huepose.geometry import se3

    return se3.rotation_from_quaternion(np.array(quaternion))
