"""Poses for a program that acts on them: typed, the newest at once, at any time, and never silently stale.

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
from huepose_protos.keys import Keys, site_and_camera_of
from huepose_protos.local import Whereabouts, boot_id, pose_endpoints
from huepose_protos.messages import CameraMessage, Message, Mount, ObjectsMessage, PoseMessage
from huepose_protos.motion import PoseAt, carried, mount_at, pose_at
from huepose_protos.reach import endpoint_of, why_unreached

_KEPT, _TOLD = 64, 512
_WAITING = 1024
_LOOK_EVERY_S = 0.1
_ASK_TIMEOUT_S = 2.0
_FORGET_S = 60.0
_SETTLES_S = 1.0
"""A new client has its link, and the latest poses, after a fraction of this."""

Instance = tuple[str, str, int]
"""SITE/CAMERA, the object, the instance."""


@dataclass
class _Place:
    """Where a camera is while it is open: fixed, or, as it was told, at stamps of its clock. heard: when it
    last said so, time.monotonic()."""

    fixed: Mount | None = None
    told: deque[tuple[int, Mount]] = field(default_factory=lambda: deque(maxlen=_TOLD))
    heard: float = 0.0


class PoseClient(Client):
    """Subscribes to poses at a gateway or, on the pipeline's own machine, at `local.pose_endpoints()`.

    endpoints: `HOST`, `HOST:PORT`, `tcp/HOST:PORT` or `tls/HOST:PORT`; for TLS the files in PEM of
    `open_session`. None: on this machine where the pipeline of `site` and `camera` runs, which is looked up
    again every second. It may be made before the pipeline runs, and finds it again when it was gone; each
    time it asks for the latest poses. Where none come, `why_silent()` says what is in the way. Left open,
    it is closed at the program's end.
    site, camera: the only one whose poses are read, else all, each for itself: `pose.frame` says which
    camera's a pose is; where two sites have a camera of one name, make a client for each site. object: the
    only one that is of interest, else all. Can be used from several threads.
    Raises ValueError for endpoints or files that cannot be used and where several pipelines are meant,
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
        self._places: dict[int, _Place] = {}  # by camera epoch: names and stamps may come again
        self._made = time.monotonic()
        self._closed = threading.Event()
        self._asker = threading.Thread(target=self._ask_whoever_is_new, daemon=True)
        keys = Keys(site, camera)
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
        """To where the pipeline runs now."""
        self._endpoints = _endpoints_of(place)
        before, self._session = self._session, open_session(self._endpoints)
        before.close()
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        self._subscribe()

    def _ask_whoever_is_new(self) -> None:
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
        """stored: it is the latest that a gateway has, and may be old."""
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
            if camera.camera_epoch not in self._places:
                self._forget_old()
            place = self._places.setdefault(camera.camera_epoch, _Place())
            place.heard = time.monotonic()
            if camera.mount is None or camera.mount_ns is None:
                place.fixed = camera.mount
            elif not place.told or camera.mount_ns > place.told[-1][0]:
                place.told.append((camera.mount_ns, camera.mount))

    def _mount(self, camera_epoch: int, stamp_ns: int) -> tuple[Mount | None, bool]:
        """Where a camera is at a time of its own clock, and whether it is fixed there."""
        with self._changed:
            place = self._places.get(camera_epoch, _Place())
            fixed, told = place.fixed, list(place.told)
        return fixed or mount_at(told, stamp_ns), fixed is not None

    def _add(self, camera: str, pose: PoseMessage, arrived: float) -> None:
        instance = (camera, pose.object, pose.instance)
        with self._changed:
            if instance not in self._history:
                self._forget_old()
            history = self._history.setdefault(instance, deque(maxlen=_KEPT))
            if history and history[-1].camera_epoch != pose.camera_epoch:
                history.clear()
            if history and _says_again(pose, history[-1]):
                history.pop()  # the newest word about a frame is what holds of it
            elif history and pose.capture_ns <= history[-1].capture_ns:
                return  # asked for and heard as well
            history.append(pose)
            self._arrived[instance] = max(arrived, self._arrived.get(instance, arrived))
            if len(self._waiting) == _WAITING:
                self._waiting.popleft()
                self.missed += 1
            self._waiting.append(pose)
            self._changed.notify_all()

    def _forget_old(self) -> None:
        """Instances and cameras come and go; those that are long gone are not kept for ever."""
        long_ago = time.monotonic() - _FORGET_S
        for old in [instance for instance, arrived in self._arrived.items() if arrived < long_ago]:
            del self._arrived[old], self._history[old]
        for closed in [epoch for epoch, place in self._places.items() if place.heard < long_ago]:
            del self._places[closed]

    def why_silent(self) -> str:
        """Why no pose comes, in a sentence, as far as this can be found out here; may take seconds. Of a
        client that was just made it waits for a pose, up to a second, before it says that none comes."""
        if self._place is not None and (absence := self._place.absence()) is not None:
            return f"waiting for a pipeline: {absence}"
        with self._changed:
            new_s = self._made + _SETTLES_S - time.monotonic()
            self._changed.wait_for(lambda: self._arrived or self._closed.is_set(), max(0.0, new_s))
        if self.connected:
            with self._changed:
                last = max(self._arrived.values(), default=None)
            if last is None:
                return f"connected, but {self._why_none_is_seen()}: `huepose status` says why"
            return f"connected: the last pose came {time.monotonic() - last:.1f} s ago"
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

    def _why_none_is_seen(self) -> str:
        names = self.looked_for()
        if names is None:
            return "no tracker answers, or it is only starting"
        if not names:
            return "nothing is looked for"
        return f"of what is looked for ({', '.join(names)}) nothing is seen"

    def next(self, timeout_s: float | None = None) -> PoseMessage | None:
        """The next pose that was not returned yet; None after the timeout, or when the client is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed.is_set(), timeout_s)
            return self._waiting.popleft() if self._waiting else None

    def camera(self, timeout_s: float | None = None) -> CameraMessage | None:
        """What a camera said last: its intrinsics, and where it is on the robot. It says so once a second:
        waits for the first. None after the timeout, or when the client is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._camera_said or self._closed.is_set(), timeout_s)
            return self._camera_said

    def looked_for(self, timeout_s: float = _ASK_TIMEOUT_S) -> list[str] | None:
        """The names of the objects that are looked for now, seen or not yet; asks the tracker or the gateway.
        None where nobody answers in time."""
        replies = (reply for key in self._lists for reply in self._session.get(key, timeout=timeout_s))
        answers = [self._read(reply.ok) for reply in replies if reply.ok is not None]
        lists = [one for one in answers if isinstance(one, ObjectsMessage)]
        return sorted({entry.object for one in lists for entry in one.objects}) if lists else None

    def mount(self, pose: PoseMessage) -> Mount | None:
        """Where the camera was when it took the picture of a pose; None where that was not told."""
        return self._mount(pose.camera_epoch, pose.capture_ns)[0]

    def on_robot(self, pose: PoseMessage) -> PoseMessage | None:
        """The same message in the frame that its camera is mounted in (`motion.carried`); None where that was
        not told."""
        mount, still = self._mount(pose.camera_epoch, pose.capture_ns)
        return None if mount is None else carried(pose, mount, still)

    def __iter__(self) -> Iterator[PoseMessage]:
        """Every pose as it comes, until the client is closed."""
        while (pose := self.next()) is not None:
            yield pose

    def latest(
        self, object: str | None = None, instance: int | None = None, max_age_s: float = float("inf")
    ) -> PoseMessage | None:
        """The newest pose message of an instance; None where there is none, or it came longer ago. One that a
        gateway had stored counts as come when its picture was taken.

        Without an instance that of the object, without an object of all, that was heard last, by whichever
        camera."""
        with self._changed:
            which = self._which(object, instance)
            if which is None or time.monotonic() - self._arrived[which] > max_age_s:
                return None
            return self._history[which][-1]

    def silent_s(self, object: str | None = None, instance: int | None = None) -> float:
        """Seconds since the last message of an instance (see `latest`) came; infinite before the first."""
        with self._changed:
            which = self._which(object, instance)
            return float("inf") if which is None else time.monotonic() - self._arrived[which]

    def at(
        self, unix_ns: int | None = None, object: str | None = None, instance: int | None = None
    ) -> PoseAt | None:
        """Where an instance (see `latest`) was or is at a time, by default now; nanoseconds since 1970.

        Between two poses of the last two seconds it is interpolated; after the newest it is predicted by its
        velocity for up to 100 ms, with a covariance that grows. None where that says nothing: no pose, LOST,
        stale. Where the camera's place is configured, or told as it moves, `T_parent_obj` is the same in the
        robot's frame; None at a time for which it was not told (`motion.mount_at`).
        On another machine it is as right as the two wall clocks agree (NTP: some milliseconds)."""
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
        """Leave; whoever waits for a pose gets None."""
        self._closed.set()
        with self._changed:
            self._changed.notify_all()
        if self._asker.is_alive():
            self._asker.join()
        super().close()


def _says_again(pose: PoseMessage, last: PoseMessage) -> bool:
    """Whether a message says something new about the frame of the last one: that no newer one came, or what a
    correction changed."""
    same = pose.capture_ns == last.capture_ns and pose.publish_ns > last.publish_ns
    return same and (pose.state, pose.applied_correction_seq) != (last.state, last.applied_correction_seq)


def _offset_ns(pose: PoseMessage) -> int:
    """What to add to the pose's stamps for Unix time: of this machine's own clocks where it is the same one,
    so that a wall clock that was set in between does no harm."""
    if pose.clock_id == boot_id():
        return time.time_ns() - time.monotonic_ns()
    return pose.realtime_offset_ns


def _endpoints_of(place: Whereabouts) -> list[str]:
    return [] if place.port is None else pose_endpoints(place.port)
