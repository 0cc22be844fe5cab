"""Write a sequence in the layout of Fast-YCB, as `datasets.fast_ycb` reads it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from huepose.datasets.ycb_objects import T_posecnn_obj
from huepose.geometry import Camera, se3
from huepose.geometry.arrays import Bool, Float, Float32, Float64, UInt8
from huepose.support.files import writing


@dataclass(frozen=True, eq=False)
class FastYcbFrame:
    """color (H, W, 3) uint8 RGB, depth (H, W) float32 m, the object's visible mask (H, W) and T_cam_obj."""

    color: UInt8
    depth: Float32
    mask: Bool
    T_cam_obj: Float64


def write_fast_ycb(
    folder: Path,
    name: str,
    frames: Iterable[FastYcbFrame],
    camera: Camera,
    rate_hz: float,
    frame_offset_m: Float | None,
    dope: Sequence[Float64 | None] | None = None,
) -> None:
    """Write a sequence of the object `name`; `gt/poses_ycb.txt` is written last, so that it says that all is
    there. frame_offset_m (3,): takes points of the PoseCNN frame to the reference model's, by default none;
    dope: poses for `dope/poses_ycb.txt`, None where nothing was found. Raises InputError."""
    T_obj_posecnn = se3.inverse(T_posecnn_obj(np.zeros(3) if frame_offset_m is None else frame_offset_m))
    rows = []
    with writing(folder):
        for part in ("rgb", "depth", "gt", "masks/gt", *(["dope"] if dope is not None else [])):
            (folder / part).mkdir(parents=True, exist_ok=True)
        size = np.array([camera.width, camera.height], "<u8").tobytes()
        for i, frame in enumerate(frames):
            _picture(folder / "rgb" / f"{i}.png", frame.color[..., ::-1])
            (folder / "depth" / f"{i}.float").write_bytes(size + frame.depth.astype("<f4").tobytes())
            _picture(folder / "masks" / "gt" / f"{name}_{i}.png", frame.mask.astype(np.uint8) * np.uint8(255))
            rows.append(_row(se3.compose(frame.T_cam_obj, T_obj_posecnn)))
        facts = {key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
        (folder / "cam_K.json").write_text(json.dumps(facts))
        (folder / "data.txt").write_text("".join(f"{i / rate_hz:.6f}\n" for i in range(len(rows))))
        if dope is not None:
            found = ["0 0 0 0 0 0 0" if T is None else _row(se3.compose(T, T_obj_posecnn)) for T in dope]
            (folder / "dope" / "poses_ycb.txt").write_text("\n".join(found) + "\n")
        (folder / "gt" / "poses_ycb.txt").write_text("\n".join(rows) + "\n")


def _row(T: Float64) -> str:
    """`x y z ax ay az angle`."""
    turn = se3.rotation_log(T[:3, :3])
    angle = float(np.linalg.norm(turn))
    return " ".join(f"{x:.9f}" for x in (*T[:3, 3], *(turn / max(angle, 1e-12)), angle))


def _picture(path: Path, picture: UInt8) -> None:
    path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(picture))[1].tobytes())
