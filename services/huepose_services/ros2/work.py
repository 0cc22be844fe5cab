"""The worker `ros2`: poses as messages of ROS 2, and the camera's mount from the robot's transforms.

It publishes `/NAMESPACE/OBJECT_INSTANCE/pose` (PoseStamped), `/tf`, `/NAMESPACE/camera_info` and
`/NAMESPACE/detections` (Detection3DArray). Only poses that are `TRACKING` are published, because messages of
ROS cannot say that a pose must not be acted on. With `camera.tf` it also reads `/tf` and `/tf_static`.
"""

from __future__ import annotations

import sys
import threading
import time
from functools import partial
from typing import Any

import zenoh

from huepose.geometry.arrays import Float64
from huepose.support.errors import InputError
from huepose_protos.client import configured
from huepose_protos.messages import CameraMessage, MountMessage, PoseMessage
from huepose_services import models
from huepose_services.following import Follower
from huepose_services.ros2 import messages
from huepose_services.ros2.publisher import Node
from huepose_services.ros2.together import Together
from huepose_services.ros2.tree import Tree
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns, this_clock
from huepose_services.runtime.config import Config, Ros2Config
from huepose_services.runtime.config_perception import TfConfig
from huepose_services.runtime.inbox import Place
from huepose_services.runtime.work import Work

_TRY_MS, _AGAIN_S = 2000, 0.5
_LOOK_NS = SECOND
_STATIC_EVERY_NS = SECOND // 20
"""How often a mount is published that only static transforms give: it holds at any time."""
_LATE_NS = SECOND // 2
_MOST_NAMES = 12


def make(bus: Bus, config: Config) -> Ros2Work:
    """The ros2 worker's work, with all message types loaded."""
    bounds = {name: model.mesh.bounds.copy() for name, model in models.load(config).items()}
    follower = Follower(bus, lambda name: models.load_one(config, name).mesh.bounds.copy(), bounds)
    for kind in (messages.POSE, messages.TRANSFORMS, messages.DETECTIONS, messages.CAMERA):
        messages.type_hash(kind)
    mount = None if config.camera.tf is None else MountFromTf(bus, config.camera.tf)
    return Ros2Work(bus, Router(config.ros2), config.ros2, bounds, follower, mount)


def open_ros_session(ros2: Ros2Config, quiet: bool = False) -> zenoh.Session:
    """A session with the router of ROS 2. Waits for the router, and prints that once, unless `quiet`.
    Raises InputError for settings that zenoh does not accept."""
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
    if (session := _opened(config)) is None and not quiet:
        print(f"{without_router(ros2)}. Waiting for it; Ctrl-C ends", file=sys.stderr, flush=True)
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
    """The message while no router answers."""
    return f"no router of ROS 2 answers at {ros2.connect}; `ros2 run rmw_zenoh_cpp rmw_zenohd` starts one"


class Router:
    """Our node of ROS 2. A thread connects it to the router, however long that takes; the worker goes on."""

    node: Node | None = None
    """None until the router has answered."""

    def __init__(self, ros2: Ros2Config) -> None:
        threading.Thread(target=self._open, args=(ros2,), daemon=True).start()

    def _open(self, ros2: Ros2Config) -> None:
        self.node = Node(open_ros_session(ros2, quiet=True), "huepose", ros2.domain, ros2.keys)

    @property
    def connected(self) -> bool:
        """Whether the router is connected now."""
        return self.node is not None and self.node.connected

    def publish(self, topic: str, type_name: str, payload: bytes) -> None:
        """Publish a message in CDR on a topic; messages are dropped until the router has answered."""
        if self.node is not None:
            self.node.publish(topic, type_name, payload)


class MountFromTf:
    """Reads /tf and /tf_static, and publishes the pose of `tf.child` in `tf.parent` on the bus
    (`camera.tf`)."""

    def __init__(self, bus: Bus, tf: TfConfig) -> None:
        self._bus, self._tf = bus, tf
        self._tree = Tree(tf.parent, tf.child)
        self._topics: tuple[tuple[Place, bool], ...] = ()
        self._published_ns = now_ns()
        self._due_ns = 0

    def is_of(self, frame: str) -> bool:
        """Whether the robot itself publishes the pose of a frame. Then we must not, since a frame has one
        parent."""
        return frame == self._tf.child

    def listen(self, node: Node) -> None:
        """Subscribe, on the first call."""
        if not self._topics:
            static = node.listen(self._bus.inbox, "/tf_static", messages.TRANSFORMS, kept=True)
            moving = node.listen(self._bus.inbox, "/tf", messages.TRANSFORMS, kept=False)
            self._topics = (static, True), (moving, False)

    @property
    def due_ns(self) -> int | None:
        """When to publish the mount of a static camera again; None before `listen`."""
        return self._due_ns if self._topics else None

    def step(self) -> None:
        """Take the transforms that arrived and publish the newest mount; warn if there is none."""
        now, offset_ns = now_ns(), this_clock().realtime_offset_ns
        for place, static in self._topics:
            while (sample := place.take()) is not None:
                refuse = partial(self._bus.refuse, str(sample.key_expr))
                self._tree.take(messages.transforms_in(sample.payload.to_bytes(), refuse), static)
        if now < self._due_ns and not self._tree.moving:
            return
        self._due_ns = now + _STATIC_EVERY_NS
        newest = self._tree.newest(now + offset_ns)
        if newest is not None:
            self._published_ns, stamp_ns = now, newest[0] - offset_ns
            late_s = (now - stamp_ns) / SECOND
            self._bus.health.warn_while("tf late", None if abs(now - stamp_ns) < _LATE_NS else _late(late_s))
            if 0 < stamp_ns < now + _LATE_NS:
                message = MountMessage(publish_ns=now, capture_ns=stamp_ns, mount=newest[1])
                self._bus.put(self._bus.keys.mount, message)
        silent = now - self._published_ns > _LATE_NS
        self._bus.health.warn_while("tf", self._missing() if silent else None)

    def _missing(self) -> str:
        chain = f"{self._tf.child} in {self._tf.parent} (camera.tf)"
        if self._tree.connected:
            return f"nothing new was published on /tf about {chain} for half a second"
        names = self._tree.frames
        known = ", ".join(names[:_MOST_NAMES]) + (" ..." if len(names) > _MOST_NAMES else "") or "none"
        return f"/tf and /tf_static do not give the pose of {chain}; known frames: {known}"


def _late(seconds: float) -> str:
    when = f"{seconds:.1f} s ago" if seconds > 0 else f"{-seconds:.1f} s from now"
    return (
        f"the newest transforms of /tf have timestamps {when} by this computer's clock: the robot's clock "
        "must agree with it (chrony, PTP), and must not be that of a simulation"
    )


class Ros2Work(Work):
    """Publishes each pose at once; and /tf and detections of a frame when all its poses are there. bounds:
    the least and greatest coordinates (2, 3) of each object, metres; mount: of the camera, None without
    `camera.tf`."""

    def __init__(
        self,
        bus: Bus,
        router: Router,
        ros2: Ros2Config,
        bounds: dict[str, Float64],
        objects: Follower[Float64],
        mount: MountFromTf | None,
    ) -> None:
        self._bus, self._router, self._mount = bus, router, mount
        self._bounds, self._objects = bounds, objects
        self._no_router, self._look_ns = without_router(ros2), now_ns() + _LOOK_NS
        self._root, self._prefix = f"/{ros2.namespace}", ros2.frame_prefix
        self._poses = bus.inbox.queue(bus.keys.poses)
        self._cameras = bus.inbox.queue(bus.keys.camera_info, wakes=False)
        self._connected: bool | None = None
        self._camera: CameraMessage | None = None
        self._together = Together()

    def due_ns(self) -> int:
        """When to look for the router, to publish the mount, or to publish the collected poses, even if no
        other frame comes."""
        mount_ns = None if self._mount is None else self._mount.due_ns
        return min(ns for ns in (self._look_ns, mount_ns, self._together.due_ns) if ns is not None)

    def step(self) -> None:
        """Publish the poses, and the camera; warn while there is no router."""
        self._objects.keep_up(self._bounds)
        if now_ns() >= self._look_ns:
            self._look_ns = now_ns() + _LOOK_NS
            connected = self._router.connected
            self._bus.health.warn_while("router", None if connected else self._no_router)
            if connected != self._connected:
                self._connected = connected
                self._bus.log.say("the router of ROS 2 is connected" if connected else self._no_router)
        if self._mount is not None and (node := self._router.node) is not None:
            self._mount.listen(node)
            self._mount.step()
        while (camera := self._bus.take(self._cameras, CameraMessage)) is not None:
            self._camera = camera
            if camera.mount_ns is None:
                self._say("camera_info", messages.camera_info(camera, camera.publish_ns))
            if camera.mount is not None:
                self._transform([])
        while (pose := self._bus.take(self._poses, PoseMessage)) is not None:
            self._take(pose)
        out_ns = self._together.due_ns
        if out_ns is not None and now_ns() >= out_ns:
            self._publish()

    def _take(self, pose: PoseMessage) -> None:
        if self._together.ends_with(pose):
            self._publish()
        if pose.state == "TRACKING":
            self._say(messages.pose_topic(pose), messages.pose_stamped(pose))
            self._bus.health.count("poses")
        self._together.add(pose, now_ns())
        if self._together.complete:
            self._publish()

    def _publish(self) -> None:
        started, poses = now_ns(), self._together.take()
        self._transform(poses)
        self._say("detections", messages.detections(poses, self._bounds))
        self._bus.health.worked_on(started, poses[0])

    def _transform(self, poses: list[PoseMessage]) -> None:
        camera = self._camera
        if camera is not None and self._mount is not None and self._mount.is_of(camera.frame):
            camera = None
        if poses or camera is not None:
            message = messages.transforms(poses, camera, self._prefix)
            self._router.publish("/tf", messages.TRANSFORMS, messages.cdr(message))

    def _say(self, name: str, message: Any) -> None:
        self._router.publish(f"{self._root}/{name}", message.__msgtype__, messages.cdr(message))
