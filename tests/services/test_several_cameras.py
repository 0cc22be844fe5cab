"""Two cameras in one file: workers of their own, poses under their names, and both in the robot's frame."""

import json
import time

import numpy as np
import pytest

from huepose_protos import PoseClient
from huepose_services.runtime.running import pick
from tests.services.conftest import NAME, PLAYED, free_port_range, patient_pipeline, processes

pytestmark = [pytest.mark.live, pytest.mark.timeout(300)]

HALF = 0.5**0.5
MOUNTS = {
    "left": {"parent": "base_link", "translation": [1.0, 0.0, 0.5], "quaternion": [0.0, 0.0, HALF, HALF]},
    "right": {"parent": "base_link", "translation": [-1.0, 0.2, 0.5], "quaternion": [HALF, 0.0, 0.0, HALF]},
}
MOMENT_NS = 1_000_000
"""Time after the newest pose: the prediction starts from that pose, and hardly changes it."""
ROTATIONS = {
    "left": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "right": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}


def test_both_cameras_give_the_object_in_the_robots_frame(recording, tmp_path, printed):
    folder, _, truths = recording
    bus = {"base_port": free_port_range(40)}
    pipeline = patient_pipeline(folder / "bundles", folder / "scene", bus=bus)
    seen = pipeline.pop("camera") | {"rate": 4, "truth": False}
    pipeline["cameras"] = [{"name": name, **seen, "mount": mount} for name, mount in MOUNTS.items()]
    path = tmp_path / "pipeline.yaml"
    path.write_text(json.dumps(pipeline))
    assert "local/right" in printed(["validate", path])
    ends = [pick(path, name).endpoints[:2] for name in MOUNTS]  # cameras publish their mounts
    right = dict.fromkeys(MOUNTS, 0)
    with processes() as start, PoseClient([one for of_one in ends for one in of_one]) as both:
        start("up", path)
        deadline = time.monotonic() + 240.0
        with PoseClient(ends[0], camera="left") as left, PoseClient(ends[1], camera="right") as other:
            of = {"left": left, "right": other}
            while min(right.values()) < 5 and time.monotonic() < deadline:
                name = min(right, key=lambda one: right[one])
                pose = of[name].next(1.0)
                if pose is None or pose.state != "TRACKING":
                    continue
                assert pose.frame == f"{name}_color_optical"
                found = of[name].at(pose.capture_ns + pose.realtime_offset_ns + MOMENT_NS, NAME)
                if found is None or found.basis.frame_id != pose.frame_id or found.T_parent_obj is None:
                    continue
                T_cam_obj = truths[pose.frame_id % PLAYED].T_cam_obj
                position = ROTATIONS[name] @ T_cam_obj[:3, 3] + MOUNTS[name]["translation"]
                assert found.mount is not None
                assert found.mount.parent == "base_link"
                assert np.linalg.norm(found.T_parent_obj[:3, 3] - position) < 0.01
                right[name] += 1
            printer = start("poses", "--robot", "--config", path, "--pipeline", "left")
            printed = next((line.split() for line in printer.stdout if " m " in line), None)
            assert printed is not None, printer.communicate()[1]
            heard = {pose.frame for pose in iter(lambda: both.next(0.0), None)}
    assert min(right.values()) >= 5, f"poses in the robot's frame: {right}"
    assert heard == {"left_color_optical", "right_color_optical"}
    frame_id, position = int(printed[0]), np.array(printed[4:7], dtype=float)
    T_cam_obj = truths[frame_id % PLAYED].T_cam_obj
    assert position == pytest.approx(
        ROTATIONS["left"] @ T_cam_obj[:3, 3] + MOUNTS["left"]["translation"], abs=0.01
    )
