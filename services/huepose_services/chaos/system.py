"""A pipeline on the built-in scene, as its operator and its subscribers see it: for soak tests and faults.

`huepose up` starts it in a temporary folder. Its messages are read over the bus as by any subscriber,
together with its log and its health. Its camera has the faults that it is ordered to have.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from huepose.evaluation.metrics import RECALL_FRACTION
from huepose.model import load_models
from huepose.scenes.builtin import SyntheticScene
from huepose.support.files import whole
from huepose_protos.client import Reader
from huepose_protos.keys import last
from huepose_protos.local import endpoint
from huepose_protos.messages import (
    CorrectionMessage,
    Estimates,
    HealthMessage,
    PoseMessage,
    TruthMessage,
    TruthObject,
)
from huepose_services.builtin import builtin_bundles
from huepose_services.camera.faulty import Orders
from huepose_services.convert import frame_key, optional_pose_from_wire, pose_of
from huepose_services.demo.score import Yardstick
from huepose_services.runtime.config import CHAIN, WORKERS
from huepose_services.runtime.run_folder import free_ports, free_tcp_port
from huepose_services.runtime.running import Pipeline, pick

_OLD_CORRECTIONS = 400

_UP_TIED_TO_PARENT = """
import sys
from huepose_services.runtime.tied import end_with
end_with(int(sys.argv[1]), ask_first=True)
from huepose_services.cli.main import main
sys.exit(main(["up", sys.argv[2]]))
"""
"""`huepose up` that ends with the process that started it, in whatever way that one ended."""


@dataclass(frozen=True)
class SeenPose:
    """A pose message as it arrived. `age_ms`, `late_ms`: milliseconds from capture to publication and to
    arrival; `error`: ADD over the diameter, None without pose or truth; `quality`: of the message."""

    at: float
    age_ms: float
    late_ms: float
    name: str
    instance: int
    frame: tuple[int, int]
    state: str
    error: float | None
    quality: float = 1.0


class LivePipeline:
    """A pipeline that runs as long as the `with` block. All times are time.monotonic() seconds."""

    def __init__(self, *, live: bool = False, slow: float = 1.0) -> None:
        """live: with a live camera with the faults of `order`; else the scene is played like a recording.
        slow: how many times fewer images a second, and how many times longer the time limits."""
        bundles = builtin_bundles(0)
        SyntheticScene(0)  # computed here if it is not in the cache
        self.slow, self.max_age_ms = slow, 300.0 * slow
        self._yardsticks = {
            name: Yardstick.of(model.eval_points, model.diameter_m, model.equivalents, at_most=500)
            for name, model in load_models(bundles).items()
        }
        self._folder = Path(tempfile.mkdtemp(prefix="huepose-live-"))
        self.path = self._folder / "pipeline.yaml"
        self.base_port = free_ports(len(WORKERS))
        self._orders = self._folder / "orders.json"
        self.workers = (*CHAIN, "gateway") if live else CHAIN
        self.gateway_port = free_tcp_port()
        camera = {"source": "synthetic", "truth": True, "rate": 30.0 / slow}
        if live:
            self.order()
            camera |= {"source": "faulty", "path": str(self._orders)}
        self.path.write_text(
            json.dumps(
                {
                    "workers": list(self.workers),
                    "camera": camera,
                    "tracker": {"max_age_ms": self.max_age_ms},
                    "reinit": {"deadline_ms": int(600 * slow)},
                    "gateway": {"listen": f"127.0.0.1:{self.gateway_port}"},
                    # Each fault is one death: no worker may be given up for its deaths in earlier faults.
                    "restarts": {"limit": 100, "hung_after_s": 2.0 * slow},
                    "bus": {"base_port": self.base_port},
                }
            )
        )
        self.poses: list[SeenPose] = []
        self.health: dict[str, HealthMessage] = {}
        self.health_log: list[tuple[float, HealthMessage]] = []
        self.estimates: list[float] = []
        self.truths: list[float] = []
        self.epochs: set[int] = set()
        """Camera epochs of this pipeline, from its ground truth messages."""
        self.corrections: deque[CorrectionMessage] = deque(maxlen=_OLD_CORRECTIONS)
        self._truth: dict[tuple[int, int, str], TruthObject] = {}
        self._stopping = False

    def __enter__(self) -> LivePipeline:
        with ExitStack() as opened:
            opened.callback(shutil.rmtree, self._folder, ignore_errors=True)
            log = opened.enter_context((self._folder / "log").open("w+"))
            command = [sys.executable, "-c", _UP_TIED_TO_PARENT, str(os.getpid()), str(self.path)]
            process = subprocess.Popen(command, stderr=log, stdout=log)
            opened.callback(process.wait, 10.0)
            opened.callback(process.send_signal, signal.SIGTERM)
            keys = ("pose/**", "truth", "health/*", "perception/estimates", "correction")
            self.reader = Reader(self.endpoints, *(f"huepose/*/*/{key}" for key in keys))
            opened.callback(self.reader.close)
            listener = threading.Thread(target=self._listen, daemon=True)
            listener.start()
            opened.callback(listener.join, 2.0)
            # From here on __exit__ closes what was opened; if this block ends before, it does so itself.
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping = True
        self._opened.close()

    @property
    def endpoints(self) -> list[str]:
        """Where the workers listen."""
        return [endpoint(self.base_port + place) for place in range(len(self.workers))]

    @property
    def pipeline(self) -> Pipeline:
        """The pipeline, as commands find it."""
        return pick(self.path)

    def order(self, **changes: object) -> None:
        """Set the camera's faults from now on; without changes: none."""
        with whole(self._orders) as part:
            part.write_bytes(msgspec.json.encode(msgspec.convert(changes, Orders)))

    def forget(self) -> None:
        """Forget the messages that came until now."""
        for seen in (self.poses, self.truths, self.estimates):
            seen.clear()

    @property
    def live(self) -> set[str]:
        """The workers whose liveliness tokens are there."""
        return {last(key) for key in list(self.reader.live)}

    def pids(self) -> dict[str, int]:
        """Process numbers of the workers, from their health."""
        return {worker: message.pid for worker, message in self.health.items()}

    def log(self) -> str:
        """All that was logged so far."""
        return (self._folder / "log").read_text()

    def _listen(self) -> None:
        while not self._stopping:
            message = self.reader.next(0.1)
            now = time.monotonic()
            if isinstance(message, PoseMessage):
                self._take_pose(message, now)
            elif isinstance(message, TruthMessage):
                self.truths.append(now)
                self.epochs.add(message.camera_epoch)
                for item in message.objects:
                    if item.object is not None:
                        self._truth[message.camera_epoch, message.frame_id, item.object] = item
                while len(self._truth) > 3000:
                    del self._truth[next(iter(self._truth))]
            elif isinstance(message, HealthMessage):
                self.health[message.worker] = message
                self.health_log.append((now, message))
            elif isinstance(message, Estimates):
                self.estimates.append(now)
            elif isinstance(message, CorrectionMessage):
                self.corrections.append(message)

    def _take_pose(self, pose: PoseMessage, now: float) -> None:
        error = None
        T_cam_obj = pose_of(pose)
        truth = self._truth.get((pose.camera_epoch, pose.frame_id, pose.object))
        if T_cam_obj is not None and truth is not None:
            T_true = optional_pose_from_wire(truth.translation, truth.quaternion)
            if T_true is not None:
                yardstick = self._yardsticks[pose.object]
                error = yardstick.add(T_cam_obj, T_true) / yardstick.diameter_m
        late_ms = (time.monotonic_ns() - pose.capture_ns) * 1e-6
        seen = (pose.object, pose.instance, frame_key(pose), pose.state, error, pose.quality)
        self.poses.append(SeenPose(now, pose.age_ms, late_ms, *seen))

    def tracking_now(self) -> set[str]:
        """Objects with a TRACKING pose in the last half second."""
        since = time.monotonic() - 0.5
        return {p.name for p in self.poses[-200:] if p.at > since and p.state == "TRACKING"}

    def wait_until_steady(self, objects: int, within_s: float, for_s: float = 2.0) -> bool:
        """Wait until all workers have reported that they work, and this many objects were TRACKING for for_s.
        Returns whether that happened."""
        start = time.monotonic()
        until, since = start + within_s, None
        while time.monotonic() < until:
            if self._all_work(start) and len(self.tracking_now()) >= objects:
                since = since or time.monotonic()
                if time.monotonic() - since > for_s:
                    return True
            else:
                since = None
            time.sleep(0.05)
        return False

    def _all_work(self, start: float) -> bool:
        """Whether each worker is there and has reported since `start` that it is ready: so its loop runs."""
        ready = {w for w, m in self.health.items() if m.publish_ns > start * 1e9 and m.state == "ready"}
        return len(self.live) == len(self.workers) and ready >= set(self.workers)


def gaps_s(poses: list[SeenPose], start: float, end: float) -> list[float]:
    """Times between frames with at least one pose message, from start to end."""
    at: dict[tuple[int, int], float] = {}
    for p in poses:
        if start <= p.at <= end:
            at.setdefault(p.frame, p.at)
    times = [start, *sorted(at.values()), end]
    return [float(gap) for gap in np.diff(times)]


def _is_wrong(pose: SeenPose) -> bool:
    return pose.state == "TRACKING" and pose.error is not None and pose.error >= RECALL_FRACTION


def wrong(poses: list[SeenPose]) -> int:
    """The number of TRACKING poses that are wrong."""
    return sum(map(_is_wrong, poses))


def may_be_wrong(poses: list[SeenPose]) -> int:
    """How many TRACKING poses may be wrong if the quality of each is its probability of being right: the
    probability of more is one in a thousand (Poisson, which is slightly wider than a sum of unequal
    chances)."""
    from scipy.stats import poisson  # imported here because that takes a second

    chances = [1.0 - p.quality for p in poses if p.state == "TRACKING" and p.error is not None]
    return int(poisson.ppf(0.999, sum(chances))) if chances else 0


def longest_wrong(poses: list[SeenPose]) -> int:
    """The most messages in a row of one instance that were TRACKING and wrong."""
    runs: dict[tuple[str, int, int], int] = {}
    longest = 0
    for p in poses:
        key = (p.name, p.instance, p.frame[0])
        runs[key] = runs.get(key, 0) + 1 if _is_wrong(p) else 0
        longest = max(longest, runs[key])
    return longest


def too_old(poses: list[SeenPose], max_age_ms: float) -> int:
    """The number of TRACKING poses that were older than the limit when published; 1 ms is allowed for
    encoding."""
    return sum(p.state == "TRACKING" and p.age_ms > max_age_ms + 1.0 for p in poses)
