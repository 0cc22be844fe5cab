"""The worker `ros2`: what may be acted on, on topics of ROS 2.

`/NAMESPACE/OBJECT/INSTANCE/pose` (PoseStamped), `/tf`, `/NAMESPACE/detections` (Detection3DArray) and
`/NAMESPACE/camera_info`. Messages of ROS have no word for a pose that is not to be acted on: only poses that
are `TRACKING` are published.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
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
from huepose_services.ros2.told import CameraTold
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config, Ros2Config
from huepose_services.runtime.work import Work

_TRY_MS, _AGAIN_S = 2000, 0.5
_LOOK_NS = SECOND


def make(bus: Bus, config: Config) -> Ros2Work:
    """The worker's work, its session open and all types known."""
    boxes = {name: bounds(model.mesh) for name, model in models.load(config).items()}
    for kind in (messages.POSE, messages.TRANSFORMS, messages.DETECTIONS, messages.CAMERA):
        messages.type_hash(kind)
    told = None if config.camera.tf is None else CameraTold(bus, config.camera.tf)
    return Ros2Work(bus, Router(config.ros2), config.ros2, boxes, told)


def bounds(mesh: Mesh) -> BoxM:
    """Of a mesh along its own axes."""
    low, high = (end.astype(float) for end in (mesh.vertices.min(0), mesh.vertices.max(0)))
    return BoxM(tuple((0.5 * (low + high)).tolist()), tuple((high - low).tolist()))


def open_ros_session(ros2: Ros2Config, waiting: Callable[[str], None] | None = None) -> zenoh.Session:
    """A session of its own towards the router of ROS 2. Waits until that is there, and says so once, by
    `waiting` or on standard error. Raises InputError for settings that zenoh does not take."""
    settings = {
        "mode": "client",
        "connect/endpoints": [ros2.connect],
        "connect/timeout_ms": _TRY_MS,
        "connect/exit_on_failure": True,
        "scouting/multicast/enabled": False,
    }
    try:
        config = configured(settings)
    except zenoh.ZError as error:
        raise InputError("ros2.connect", found=f"{ros2.connect}: {str(error)[:200]}") from None
    if (session := _opened(config)) is None:
        say = waiting or partial(print, file=sys.stderr, flush=True)
        say(without_router(ros2))
    while session is None:
        time.sleep(_AGAIN_S)
        session = _opened(config)
    return session


def _opened(config: zenoh.Config) -> zenoh.Session | None:
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        return None


def without_router(ros2: Ros2Config) -> str:
    """What to say while nobody answers."""
    return f"no router of ROS 2 answers at {ros2.connect}; `ros2 run rmw_zenoh_cpp rmw_zenohd` starts one"


class Router:
    """The node of ROS 2, once its router is there; waited for beside the work, which goes on."""

    def __init__(self, ros2: Ros2Config) -> None:
        self._ros2 = ros2
        self._session: zenoh.Session | None = None
        self._node: Node | None = None
        threading.Thread(target=self._open, daemon=True).start()

    def _open(self) -> None:
        session = open_ros_session(self._ros2, waiting=lambda text: None)
        self._node = Node(session, "huepose", self._ros2.domain, self._ros2.keys)
        self._session = session

    @property
    def connected(self) -> bool:
        """Whether it is there now."""
        return self._session is not None and bool(self._session.info.routers_zid())

    @property
    def node(self) -> Node | None:
        """The node, None until the router is there."""
        return self._node if self._session is not None else None

    def publish(self, topic: str, type_name: str, payload: bytes) -> None:
        """A message in CDR on a topic; into the void until the router is there."""
        if (node := self.node) is not None:
            node.publish(topic, type_name, payload)


class Ros2Work(Work):
    """Collects the poses of a frame and publishes them together. told: what tells the camera where it is."""

    def __init__(
        self,
        bus: Bus,
        router: Router,
        ros2: Ros2Config,
        boxes: Mapping[str, BoxM],
        told: CameraTold | None = None,
    ) -> None:
        self._bus, self._router, self._boxes, self._told = bus, router, boxes, told
        self._without, self._look_ns = without_router(ros2), now_ns() + _LOOK_NS
        self._root = f"/{ros2.namespace}"
        self._poses = bus.inbox.queue(bus.keys.poses)
        self._cameras = bus.inbox.queue(bus.keys.camera_info, wakes=False)
        self._connected: bool | None = None
        self._camera: CameraMessage | None = None
        self._frame: list[PoseMessage] = []

    def due_ns(self) -> int:
        """When the poses of a frame that are there go out, also if no other frame comes; or `told` is due."""
        told_ns = None if self._told is None else self._told.due_ns
        out_ns = self._out_ns if self._frame else None
        return min(ns for ns in (self._look_ns, told_ns, out_ns) if ns is not None)

    @property
    def _out_ns(self) -> int:
        return self._frame[0].publish_ns + SECOND // 100

    def step(self) -> None:
        """Publish the poses of each frame, and the camera; say where nobody takes them."""
        if now_ns() >= self._look_ns:
            self._look_ns = now_ns() + _LOOK_NS
            connected = self._router.connected
            self._bus.health.warn_while("router", None if connected else self._without)
            if connected != self._connected:
                self._connected = connected
                self._bus.log.say("the router of ROS 2 is there" if connected else self._without)
        if self._told is not None and (node := self._router.node) is not None:
            self._told.listen(node)
            self._told.step()
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
        if self._frame and now_ns() >= self._out_ns:
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
        self._router.publish(
            "/tf", messages.TRANSFORMS, messages.cdr(messages.transforms(poses, self._camera))
        )

    def _say(self, name: str, message: Any) -> None:
        self._router.publish(f"{self._root}/{name}", message.__msgtype__, messages.cdr(message))
