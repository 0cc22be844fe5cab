"""The worker `ros2`: what may be acted on, on topics of ROS 2.

`/NAMESPACE/OBJECT/INSTANCE/pose` (PoseStamped), `/tf`, `/NAMESPACE/detections` (Detection3DArray) and
`/NAMESPACE/camera_info`. Messages of ROS have no word for a pose that is not to be acted on: only poses that
are `TRACKING` are published.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import zenoh

from huepose.geometry import Mesh
from huepose.support.errors import InputError
from huepose_protos.client import configured
from huepose_protos.messages import CameraMessage, PoseMessage
from huepose_services import models
from huepose_services.ros2 import messages
from huepose_services.ros2.messages import BoxM
from huepose_services.ros2.publisher import Node
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config, Ros2Config
from huepose_services.runtime.work import Work


def make(bus: Bus, config: Config) -> Ros2Work:
    """The worker's work, its session open and all types known."""
    boxes = {name: bounds(model.mesh) for name, model in models.load(config).items()}
    for kind in (messages.POSE, messages.TRANSFORMS, messages.DETECTIONS, messages.CAMERA):
        messages.type_hash(kind)
    session = open_ros_session(config.ros2)
    return Ros2Work(bus, Node(session, "huepose", config.ros2.domain, config.ros2.keys), config.ros2, boxes)


def bounds(mesh: Mesh) -> BoxM:
    """Of a mesh along its own axes."""
    low, high = (end.astype(float) for end in (mesh.vertices.min(0), mesh.vertices.max(0)))
    return BoxM(tuple((0.5 * (low + high)).tolist()), tuple((high - low).tolist()))


def open_ros_session(ros2: Ros2Config) -> zenoh.Session:
    """A session of its own towards the router of ROS 2, which may come later. Raises InputError."""
    settings = {
        "mode": "client",
        "connect/endpoints": [ros2.connect],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "scouting/multicast/enabled": False,
    }
    try:
        return zenoh.open(configured(settings))
    except zenoh.ZError as error:
        raise InputError(
            "ros2.connect",
            found=f"{ros2.connect}: {' '.join(str(error).split())[:200]}",
            expected="the router of rmw_zenoh, tcp/localhost:7447 for example",
            fix="Start it: ros2 run rmw_zenoh_cpp rmw_zenohd.",
        ) from None


class Ros2Work(Work):
    """Collects the poses of a frame and publishes them together."""

    def __init__(self, bus: Bus, node: Node, ros2: Ros2Config, boxes: Mapping[str, BoxM]) -> None:
        self._bus, self._node, self._boxes = bus, node, boxes
        self._root = f"/{ros2.namespace}"
        self._poses = bus.inbox.queue(bus.keys.poses)
        self._cameras = bus.inbox.queue(bus.keys.camera_info, wakes=False)
        self._camera: CameraMessage | None = None
        self._frame: list[PoseMessage] = []

    def due_ns(self) -> int | None:
        """When the poses of a frame that are there go out, also if no other frame comes."""
        return None if not self._frame else self._frame[0].publish_ns + SECOND // 100

    def step(self) -> None:
        """Publish the poses of each frame, and the camera."""
        while (camera := self._bus.take(self._cameras, CameraMessage)) is not None:
            self._camera = camera
            if camera.mount_ns is None:
                self._say("camera_info", messages.camera_info(camera, camera.publish_ns))
            if camera.mount is not None:
                self._transform([])
        while (pose := self._bus.take(self._poses, PoseMessage)) is not None:
            if self._frame and pose.frame_id != self._frame[0].frame_id:
                self._publish()
            if pose.state == "TRACKING":
                self._frame.append(pose)
        if self._frame and now_ns() >= (self.due_ns() or 0):
            self._publish()

    def _publish(self) -> None:
        poses, self._frame = self._frame, []
        started = now_ns()
        for pose in poses:
            self._say(f"{pose.object}/{pose.instance}/pose", messages.pose_stamped(pose))
        self._transform(poses)
        self._say("detections", messages.detections(poses, self._boxes))
        self._bus.health.count("poses", len(poses))
        self._bus.health.worked_on(started, poses[0])

    def _transform(self, poses: list[PoseMessage]) -> None:
        self._node.publish("/tf", messages.TRANSFORMS, messages.cdr(messages.transforms(poses, self._camera)))

    def _say(self, name: str, message: Any) -> None:
        self._node.publish(f"{self._root}/{name}", message.__msgtype__, messages.cdr(message))
