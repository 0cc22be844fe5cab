"""A rendered camera on an arm that moves round a box on a table: the box is static in the robot's frame."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from huepose.geometry import se3
from huepose.model import ReferenceModel
from huepose.model.io import model_path, save_model
from huepose.rendering.render import render
from huepose_protos import PoseClient
from huepose_protos.client import Reader
from huepose_protos.messages import HealthMessage, Mount
from huepose_protos.motion import composed, mount_at, mount_of, rotation_matrix
from huepose_services.ros2.messages import TRANSFORMS
from huepose_services.runtime.config import CHAIN
from huepose_services.runtime.running import pick
from tests.conftest import CAMERA, table_top
from tests.services.conftest import free_port_range, patient_pipeline, processes, until
from tests.services.ros2.test_ros2 import read
from tests.services.sessions import listening

pytestmark = [pytest.mark.live, pytest.mark.pipeline, pytest.mark.timeout(400)]

FRAMES, GAP_NS = 60, 100_000_000
T_BASE_OBJ = se3.make(se3.rotation_exp(np.array([0.0, 0.0, 0.6])), np.array([0.0, 0.0, 0.075]))
HAND = {"parent": "tool0", "translation": [0.05, -0.02, 0.1], "quaternion": [0.0, 0.6, 0.0, 0.8]}
WITHIN_M = 0.002

_CAMERA = """
import threading, time
from pathlib import Path
import numpy as np
from huepose import Camera, RgbdFrame
from huepose_protos.mount_sender import MountSender

rendered = np.load("{folder}/rendered.npz")
color, depth, arm = rendered["color"], rendered["depth"], rendered["arm"]
camera = Camera(*rendered["camera"].tolist()[:4], 640, 480)
T0, GAP, STEP = time.monotonic_ns(), {gap}, {gap} // 5


def tell():
    # The arm measures its pose between two images, never at the time of one.
    with MountSender("base_link", base_port={port}) as sender:
        k = 0
        while not Path("{folder}/silent").exists():
            at = T0 + k * STEP + STEP // 3
            time.sleep(max(0.0, (at - time.monotonic_ns()) * 1e-9))
            sender.tell(arm[k % len(arm)], at)
            k += 1


def frames():
    threading.Thread(target=tell, daemon=True).start()
    k = (time.monotonic_ns() - T0) // GAP + 1
    while True:
        time.sleep(max(0.0, (T0 + k * GAP - time.monotonic_ns()) * 1e-9))
        yield RgbdFrame(color[k % {frames}], depth[k % {frames}], camera, stamp_ns=T0 + k * GAP)
        k += 1
"""


def camera_at(periods: float) -> np.ndarray:
    """T_base_cam: back and forth round the middle of the table by 17 degrees, up to 0.2 m/s."""
    rotation = se3.rotation_exp(np.array([0.0, 0.0, 0.3 * np.sin(2.0 * np.pi * periods)]))
    _, T_cam_table = table_top()
    return se3.make(rotation, np.zeros(3)) @ np.linalg.inv(T_cam_table)


def write_camera(folder: Path, model: ReferenceModel, port: int) -> None:
    """Writes the images, the poses of the arm, and the camera file that gives both."""
    table, _ = table_top()
    rendered = []
    for k in range(FRAMES):
        T_cam_base = np.linalg.inv(camera_at(k / FRAMES))
        rendered.append(render([(table, T_cam_base), (model.mesh, T_cam_base @ T_BASE_OBJ)], CAMERA))
    T_tool_cam = np.eye(4)
    T_tool_cam[:3, :3] = rotation_matrix(np.array(HAND["quaternion"]))
    T_tool_cam[:3, 3] = HAND["translation"]
    arm = [camera_at((k + 1 / 3) / (5 * FRAMES)) @ np.linalg.inv(T_tool_cam) for k in range(5 * FRAMES)]
    np.savez(
        folder / "rendered.npz",
        color=[p.color for p in rendered],
        depth=[p.depth for p in rendered],
        arm=arm,
        camera=[CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy],
    )
    text = _CAMERA.format(folder=folder, gap=GAP_NS, port=port, frames=FRAMES)
    (folder / "camera.py").write_text(text)


def off_m(T_base_obj: np.ndarray) -> float:
    """The largest distance of a corner of the box from its true position."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [0.045, 0.03, 0.075]
    return float(
        np.linalg.norm(se3.apply(T_base_obj, corners) - se3.apply(T_BASE_OBJ, corners), axis=1).max()
    )


def of_tf(move: Any) -> Mount:
    t, q = move.transform.translation, move.transform.rotation
    return mount_of(move.header.frame_id, np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w]))


def test_poses_and_the_tree_of_ros_2_are_right_until_the_arm_sends_no_more_poses(
    tea_box: ReferenceModel, tmp_path: Path
) -> None:
    port = free_port_range(20)
    save_model(tea_box, model_path(tmp_path / "bundles", "tea_box"))
    write_camera(tmp_path, tea_box, port)
    path = tmp_path / "pipeline.yaml"
    pipeline = patient_pipeline(
        "bundles",
        None,
        workers=[*CHAIN, "ros2"],
        camera={"source": "python", "path": "camera.py", "rate": 10, "moving": True, "mount": HAND},
        ros2={"connect": f"tcp/127.0.0.1:{port + 15}"},
        bus={"base_port": port},
    )
    path.write_text(json.dumps(pipeline))
    router = listening(f"tcp/127.0.0.1:{port + 15}", mode="router")
    tree: list[bytes] = []
    off: list[float] = []
    with zenoh.open(router) as ros, processes() as start, PoseClient(pick(path).endpoints[:2]) as client:
        ros.declare_subscriber("0/tf/**", lambda sample: tree.append(sample.payload.to_bytes()))
        start("up", path)
        end = time.monotonic() + 150.0
        while len(off) < 100 and time.monotonic() < end:
            pose = client.next(1.0)
            if pose is None or pose.state != "TRACKING":
                continue
            time.sleep(0.02)
            found = client.at(pose.capture_ns + pose.realtime_offset_ns + 1_000_000)
            if found is not None and found.T_parent_obj is not None:
                assert found.mount is not None
                assert found.mount.parent == "base_link"
                off.append(off_m(found.T_parent_obj))
        (tmp_path / "silent").touch()
        warned = ""
        with Reader(pick(path).endpoints[:2], "huepose/*/*/health/camera", "huepose/*/*/pose/**") as reader:
            end = time.monotonic() + 20.0
            while "camera.moving" not in warned and time.monotonic() < end:
                message = reader.next(1.0)
                warned += " ".join(message.warnings) if isinstance(message, HealthMessage) else ""
        time.sleep(1.0)
        last = until(lambda: client.latest(max_age_s=1.0))
        gone = client.at()
    assert len(off) >= 100, f"{len(off)} poses in the robot's frame"
    print(f"robot frame: median {np.median(off) * 1e3:.2f} mm, largest {max(off) * 1e3:.2f} of {len(off)}")
    assert max(off) < WITHIN_M
    assert "camera.moving" in warned, "the arm sends no more poses"
    assert last is not None, "in the camera's frame poses go on"
    assert gone is None or gone.T_parent_obj is None

    cameras: list[tuple[int, Mount]] = []
    objects: list[tuple[int, Mount]] = []
    for data in tree:
        for move in read(TRANSFORMS, data).transforms:
            at = move.header.stamp.sec * 1_000_000_000 + move.header.stamp.nanosec
            (objects if move.child_frame_id.startswith("tea_box") else cameras).append((at, of_tf(move)))
    cameras.sort(key=lambda one: one[0])
    placed = []
    for at, in_camera in objects:
        mount = mount_at(cameras, at)
        if mount is not None:
            both = composed(mount, in_camera)
            T_base_obj = np.eye(4)
            T_base_obj[:3, :3] = rotation_matrix(np.array(both.quaternion))
            T_base_obj[:3, 3] = both.translation
            placed.append(off_m(T_base_obj))
    assert {one.parent for _, one in cameras} == {"base_link"}
    assert len(placed) >= 100
    print(f"/tf: median {np.median(placed) * 1e3:.2f} mm, largest {max(placed) * 1e3:.2f} of {len(placed)}")
    assert max(placed) < WITHIN_M
