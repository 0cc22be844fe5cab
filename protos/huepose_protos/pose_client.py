"""Poses for a program that acts on them: typed, the newest one, or the pose at any time; never an old one as
if it were current.

>>> with PoseClient("tcp/127.0.0.1:7447") as client:        # doctest: +SKIP
...     for pose in client:                                 # every pose, as it comes
...         print(pose.object, pose.state, pose.translation)
...     now = client.at(object="tea_box")                   # where it is now
...     if now is not None and now.state == "TRACKING":
...         move_to(now.T_cam_obj, now.covariance)
"""

from __future__ import annotations

import ssl
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import zenoh

from huepose_protos.client import Client, open_session
from huepose_protos.fields import is_name
from huepose_protos.keys import Keys, site_and_camera_of
from huepose_protos.local import Whereabouts, boot_id, pose_endpoints
from huepose_protos.messages import CameraMessage, Message, Mount, ObjectsMessage, PoseMessage
from huepose_protos.motion import PoseAt, carried, mount_at, pose_at
from huepose_protos.reach import endpoint_of, why_unreached

_KEPT, _KEPT_MOUNTS = 512, 512
_KEPT_NS = 2_200_000_000
"""Poses are kept for two seconds and a gap between two of them, also at a camera's highest rate, 240 Hz."""
_WAITING = 1024
_LOOK_EVERY_S = 0.1
_ASK_TIMEOUT_S = 2.0
_FORGET_S = 60.0
_SETTLES_S = 1.0
"""A new client is connected and has the latest poses after a fraction of this."""

Instance = tuple[str, str, int]
"""SITE/CAMERA, the object, the instance."""


@dataclass
class _Mounts:
    """The mount of a camera epoch: fixed, or, if the camera moves, with timestamps of its clock. heard: when
    the last message came, time.monotonic()."""

    fixed: Mount | None = None
    timed: deque[tuple[int, Mount]] = field(default_factory=lambda: deque(maxlen=_KEPT_MOUNTS))
    heard: float = 0.0


class PoseClient(Client):
    """Subscribes to poses at a gateway or, on the pipeline's own machine, at `local.pose_endpoints()`.

    endpoints: `HOST`, `HOST:PORT`, `tcp/HOST:PORT` or `tls/HOST:PORT`; for TLS with the PEM files of
    `open_session`. None: the pipeline of `site` and `camera` on this machine, which is looked up again every
    second. The client may be made before the pipeline runs, and connects again when it restarts; each time
    it asks for the latest poses. If no poses come, `why_silent()` says why. A client that is left open is
    closed when the program ends.
    site, camera: read the poses of this one only, else of all, each kept separately. `pose.frame` names the
    camera of a pose; if cameras of two sites have the same name, make one client for each site. object: read
    the poses of this object only, else of all. Several threads may use one client.
    Raises ValueError for names, endpoints or files that cannot be used and if several pipelines match,
    FileNotFoundError for a missing file.

    `missed`: poses that were dropped because the iterator was not read for too long (`latest` and `at` always
    know the newest)."""

    def __init__(
        self,
        endpoints: str | Sequence[str] | None = "tcp/127.0.0.1:7447",
        *,
        site: str = "*",
        camera: str = "*",
        object: str | None = None,
        authority: Path | str | None = None,
        certificate: Path | str | None = None,
        key: Path | str | None = None,
    ) -> None:
        self.missed = 0
        self._changed = threading.Condition()
        self._waiting: deque[PoseMessage] = deque()
        self._history: dict[Instance, deque[PoseMessage]] = {}
        self._arrived: dict[Instance, float] = {}
        self._camera_said: CameraMessage | None = None
        self._mounts: dict[int, _Mounts] = {}  # by camera epoch: names and timestamps may come again
        self._made = time.monotonic()
        self._closed = threading.Event()
        self._asker = threading.Thread(target=self._ask_new_peers, daemon=True)
        keys, self._object = Keys(site, camera), object
        if object is not None and not is_name(object):
            raise ValueError(f"PoseClient: object {object!r} is not a name of a-z, 0-9, _ and -")
        inside = keys.poses if object is None else keys.poses.replace("**", f"{object}/*")
        self._outside = (keys.outside(inside), keys.outside(keys.camera_info))
        self._expressions = (inside, keys.camera_info, *self._outside)
        self._lists = (keys.objects, keys.outside(keys.objects))
        self._place: Whereabouts | None = None
        if endpoints is None:
            self._place = Whereabouts(site, camera)
            endpoints = _endpoints_of(self._place)
        elif not endpoints:
            raise ValueError("PoseClient: no endpoints; give a gateway's HOST, or local.pose_endpoints()")
        given = [endpoints] if isinstance(endpoints, str) else list(endpoints)
        self._endpoints = [endpoint_of(one, tls=authority is not None) for one in given]
        self._files = authority, certificate, key
        super().__init__(open_session(given, *self._files))
        self._subscribe()
        self._asker.start()

    def _subscribe(self) -> None:
        for expression in self._expressions:
            self._listen(self._session.declare_subscriber, expression, self._on_sample)

    def _follow(self, place: Whereabouts) -> None:
        """Connect to where the pipeline runs now."""
        self._endpoints = _endpoints_of(place)
        before, self._session = self._session, open_session(self._endpoints)
        before.close()
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        self._subscribe()

    def _ask_new_peers(self) -> None:
        known: set[str] = set()
        while not self._closed.wait(_LOOK_EVERY_S):
            if self._place is not None and self._place.has_moved():
                self._follow(self._place)
            peers = {str(zid) for zid in self._session.info.peers_zid()}
            if peers - known:
                for expression in self._outside:
                    self._session.get(expression, self._on_reply, timeout=_ASK_TIMEOUT_S)
            known = peers

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._on_sample(reply.ok, stored=True)

    def _read(self, sample: zenoh.Sample) -> Message | None:
        return self._decoded(str(sample.key_expr), sample.payload.to_bytes())

    def _on_sample(self, sample: zenoh.Sample, stored: bool = False) -> None:
        """stored: the sample is the latest that a gateway keeps, and may be old."""
        message = self._read(sample)
        if isinstance(message, PoseMessage):
            age_ns = time.time_ns() - _offset_ns(message) - message.capture_ns if stored else 0
            arrived = time.monotonic() - 1e-9 * max(0, age_ns)
            self._add(site_and_camera_of(str(sample.key_expr)), message, arrived)
        elif isinstance(message, CameraMessage):
            self._add_camera(message)

    def _add_camera(self, camera: CameraMessage) -> None:
        with self._changed:
            self._camera_said = camera
            self._changed.notify_all()
            if camera.camera_epoch not in self._mounts:
                self._forget_old()
            mounts = self._mounts.setdefault(camera.camera_epoch, _Mounts())
            mounts.heard = time.monotonic()
            if camera.mount is None or camera.mount_ns is None:
                mounts.fixed = camera.mount
            elif not mounts.timed or camera.mount_ns > mounts.timed[-1][0]:
                mounts.timed.append((camera.mount_ns, camera.mount))

    def _mount(self, camera_epoch: int, stamp_ns: int) -> tuple[Mount | None, bool]:
        """The mount of a camera at a time of its own clock, and whether the camera is fixed."""
        with self._changed:
            mounts = self._mounts.get(camera_epoch, _Mounts())
            fixed, timed = mounts.fixed, list(mounts.timed)
        return fixed or mount_at(timed, stamp_ns), fixed is not None

    def _add(self, camera: str, pose: PoseMessage, arrived: float) -> None:
        instance = (camera, pose.object, pose.instance)
        with self._changed:
            if instance not in self._history:
                self._forget_old()
            history = self._history.setdefault(instance, deque(maxlen=_KEPT))
            if history and history[-1].camera_epoch != pose.camera_epoch:
                history.clear()
            if history and _is_update(pose, history[-1]):
                history.pop()  # the newest message about a frame counts
            elif history and pose.capture_ns <= history[-1].capture_ns:
                return  # it came twice, as an answer and by itself
            history.append(pose)
            while pose.capture_ns - history[0].capture_ns > _KEPT_NS:
                history.popleft()
            self._arrived[instance] = max(arrived, self._arrived.get(instance, arrived))
            if len(self._waiting) == _WAITING:
                self._waiting.popleft()
                self.missed += 1
            self._waiting.append(pose)
            self._changed.notify_all()

    def _forget_old(self) -> None:
        """Drop instances and cameras of which nothing came for long."""
        long_ago = time.monotonic() - _FORGET_S
        for old in [instance for instance, arrived in self._arrived.items() if arrived < long_ago]:
            del self._arrived[old], self._history[old]
        for closed in [epoch for epoch, mounts in self._mounts.items() if mounts.heard < long_ago]:
            del self._mounts[closed]

    def why_silent(self) -> str:
        """Why no pose comes, in a sentence, as far as this machine can find out; may take seconds. A client
        that was just made first waits for a pose for up to a second."""
        if self._place is not None and (absence := self._place.absence()) is not None:
            return f"waiting for a pipeline: {absence}"
        with self._changed:
            new_s = self._made + _SETTLES_S - time.monotonic()
            self._changed.wait_for(lambda: self._arrived or self._closed.is_set(), max(0.0, new_s))
        if self.connected:
            with self._changed:
                last = max(self._arrived.values(), default=None)
                age_s = time.monotonic() - (last or 0.0)
            why, stopped = self._why_none_is_seen()
            if last is None:
                return f"connected, but {why}: `huepose status` says why"
            return f"connected: the last pose came {age_s:.1f} s ago" + (f"; {why}" if stopped else "")
        authority, certificate, key = self._files
        try:
            context = ssl.create_default_context(cafile=authority)
            shown = None
            if authority and certificate and key:
                context.load_cert_chain(certificate, key)
                shown = authority, certificate, key
        except OSError as error:
            return f"authority, certificate and key cannot be used: {getattr(error, 'reason', None) or error}"
        return why_unreached(self._endpoints, context, shown)

    def _why_none_is_seen(self) -> tuple[str, bool]:
        """In words, and whether it is certain that no pose comes: nothing that this client reads is searched
        for."""
        names = self.looked_for()
        if names is None:
            return "no tracker answers, or it is still starting", False
        if not names:
            return "no object is searched for", True
        if self._object is not None and self._object not in names:
            return f"{self._object} is not searched for, only {', '.join(names)}", True
        if self._object is not None:
            return f"{self._object} is not seen", False
        return f"none of the objects that are searched for ({', '.join(names)}) is seen", False

    def next(self, timeout_s: float | None = None) -> PoseMessage | None:
        """The next pose that was not returned yet; None after the timeout, or when the client is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed.is_set(), timeout_s)
            return self._waiting.popleft() if self._waiting else None

    def camera(self, timeout_s: float | None = None) -> CameraMessage | None:
        """The newest message of a camera: its intrinsics, and its mount on the robot. One comes every second:
        waits for the first. None after the timeout, or when the client is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._camera_said or self._closed.is_set(), timeout_s)
            return self._camera_said

    def looked_for(self, timeout_s: float = _ASK_TIMEOUT_S) -> list[str] | None:
        """The names of the objects that are searched for now, seen or not yet; asks the tracker or the
        gateway. None if neither answers in time."""
        replies = (reply for key in self._lists for reply in self._session.get(key, timeout=timeout_s))
        answers = [self._read(reply.ok) for reply in replies if reply.ok is not None]
        lists = [one for one in answers if isinstance(one, ObjectsMessage)]
        return sorted({entry.object for one in lists for entry in one.objects}) if lists else None

    def mount(self, pose: PoseMessage) -> Mount | None:
        """The camera's mount when it took the image of a pose; None if it is not known."""
        return self._mount(pose.camera_epoch, pose.capture_ns)[0]

    def on_robot(self, pose: PoseMessage) -> PoseMessage | None:
        """The same message in the frame that its camera is mounted in (`motion.carried`); None if the mount
        is not known."""
        mount, still = self._mount(pose.camera_epoch, pose.capture_ns)
        return None if mount is None else carried(pose, mount, still)

    def __iter__(self) -> Iterator[PoseMessage]:
        """Every pose as it comes, until the client is closed."""
        while (pose := self.next()) is not None:
            yield pose

    def latest(
        self, object: str | None = None, instance: int | None = None, max_age_s: float = float("inf")
    ) -> PoseMessage | None:
        """The newest pose message of an instance; None if there is none, or it came more than max_age_s ago.
        For a message that a gateway had stored, the time at which its image was taken counts instead.

        Without an instance: of the object's instances; without an object: of all objects; from whichever
        camera, the one that was heard last."""
        with self._changed:
            which = self._which(object, instance)
            if which is None or time.monotonic() - self._arrived[which] > max_age_s:
                return None
            return self._history[which][-1]

    def silent_s(self, object: str | None = None, instance: int | None = None) -> float:
        """Seconds since the last message of an instance (see `latest`) came, without repetitions; infinite
        before the first."""
        with self._changed:
            which = self._which(object, instance)
            return float("inf") if which is None else time.monotonic() - self._arrived[which]

    def at(
        self, unix_ns: int | None = None, object: str | None = None, instance: int | None = None
    ) -> PoseAt | None:
        """The pose of an instance (see `latest`) at a time, by default now; nanoseconds since 1970.

        Between two poses of the last two seconds it is interpolated; after the newest it is predicted with
        its velocity for up to 100 ms, with a covariance that grows. None if there is no pose then, it is
        LOST, or the newest is too old. If the camera's mount is configured, or given as the camera moves,
        `T_parent_obj` is the pose in the robot's frame; None at a time without a mount (`motion.mount_at`).
        On another machine it is as accurate as the two wall clocks agree (NTP: some milliseconds)."""
        with self._changed:
            which = self._which(object, instance)
            poses = [] if which is None else list(self._history[which])
        if not poses:
            return None
        unix_ns = time.time_ns() if unix_ns is None else unix_ns
        stamp_ns = unix_ns - _offset_ns(poses[-1])
        found, (mount, _) = pose_at(poses, stamp_ns), self._mount(poses[-1].camera_epoch, stamp_ns)
        return None if found is None else replace(found, mount=mount)

    def _which(self, object: str | None, instance: int | None) -> Instance | None:
        known = [key for key in self._history if object in (None, key[1]) and instance in (None, key[2])]
        return max(known, key=lambda key: self._arrived[key], default=None)

    def close(self) -> None:
        """Disconnect; whoever waits for a pose gets None."""
        self._closed.set()
        with self._changed:
            self._changed.notify_all()
        if self._asker.is_alive():
            self._asker.join()
        super().close()


def _is_update(pose: PoseMessage, last: PoseMessage) -> bool:
    """Whether a message changes what the last one said about the same frame: its state, because no newer
    frame came, or what a correction changed."""
    same = pose.capture_ns == last.capture_ns and pose.publish_ns > last.publish_ns
    return same and (pose.state, pose.applied_correction_seq) != (last.state, last.applied_correction_seq)


def _offset_ns(pose: PoseMessage) -> int:
    """What to add to the pose's timestamps for Unix time. On the same machine this is read from its clocks
    now, so that a wall clock that was set in between does no harm."""
    if pose.clock_id == boot_id():
        return time.time_ns() - time.monotonic_ns()
    return pose.realtime_offset_ns


def _endpoints_of(place: Whereabouts) -> list[str]:
    return [] if place.port is None else pose_endpoints(place.port)
