"""One pipeline on two computers without a common clock; the cable between them delays, loses and is cut.

Each is a network namespace; the second computer has a monotonic clock and a boot id of its own."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

from huepose_protos.client import Reader
from huepose_protos.local import FOLDER, endpoint
from huepose_protos.messages import Estimates, HealthMessage, ObjectsMessage, PoseMessage, TruthMessage
from huepose_services.authority import Authority
from huepose_services.runtime.config import WORKERS

CAMERAS, OTHERS = "10.9.0.1", "10.9.0.2"
_AHEAD_S = 100_000
_BOOT = "/proc/sys/kernel/random/boot_id"
_HUEPOSE = f"{sys.executable} -m huepose_services.cli.main"
_PIPELINE = f"""
workers: [camera, tracker, reinit, detector, segmenter, estimator]
camera: {{truth: true}}
hosts: {{desk: [detector, segmenter, estimator]}}
link: {{connect: "{CAMERAS}:7448"}}
"""


def _why_not():
    if os.geteuid() != 0 or not Path("/dev/net/tun").exists() or shutil.which("ip") is None:
        return "network namespaces and a tap device need root, /dev/net/tun and iproute2"
    tried = subprocess.run(["unshare", "-n", "-T", "-m", "--monotonic", "1", "true"], capture_output=True)
    return None if tried.returncode == 0 else f"no namespaces here: {tried.stderr.decode().strip()}"


pytestmark = [
    pytest.mark.live,
    pytest.mark.pipeline,
    pytest.mark.timeout(400),
    pytest.mark.skipif(_why_not() is not None, reason=str(_why_not())),
]


class TwoHosts:
    """Two folders, two namespaces, a cable, and the messages at the camera's computer."""

    def __init__(self, folder, cable):
        self.folder, self._cable = folder, cable
        endpoints = [endpoint(17447 + place, folder / "run_robot") for place in range(len(WORKERS))]
        tails = ("pose/**", "health/*", "objects", "truth", "perception/estimates")
        self.reader = Reader(endpoints, *(f"huepose/*/*/{tail}" for tail in tails))
        self.answers, self.poses, self.health, self.searching = [], [], {}, {}
        self.truth, self.errors_m = {}, []

    def order(self, *orders):
        """Sends commands to the cable; gives the bytes sent each way so far."""
        self._cable.stdin.write("".join(f"{order}\n" for order in orders))
        self._cable.stdin.flush()
        return [self._cable.stdout.readline() for _ in orders][-1].split()

    def look(self, seconds, until=lambda: False):
        """Listens for some seconds, or until a condition holds; gives whether it holds."""
        end = time.monotonic() + seconds
        while not (holds := until()) and (left := end - time.monotonic()) > 0:
            self._take(self.reader.next(min(left, 0.2)))
        return holds

    def _take(self, message):
        if isinstance(message, PoseMessage):
            self.poses.append((1e-9 * message.publish_ns, message))
            there = self.truth.get(message.frame_id, {}).get(message.object)
            if there is not None and message.state == "TRACKING":
                self.errors_m.append(float(np.linalg.norm(np.subtract(message.translation, there))))
        elif isinstance(message, Estimates):
            self.answers.append((message.publish_ns - message.capture_ns) * 1e-9)
        elif isinstance(message, HealthMessage):
            self.health[message.worker] = message
        elif isinstance(message, ObjectsMessage):
            self.searching = {entry.object: entry.searching for entry in message.objects}
        elif isinstance(message, TruthMessage):
            self.truth[message.frame_id] = {o.object: o.translation for o in message.objects}

    def tracked(self, for_s=1.0):
        """The objects that were TRACKING lately."""
        since = time.monotonic() - for_s
        # From the newest on: this is asked for each message, and must not take longer than they come apart.
        late = takewhile(lambda one: one[0] > since, reversed(self.poses))
        return {m.object for _, m in late if m.state == "TRACKING"}

    def longest_gap_s(self, since):
        """The longest time without a pose message."""
        now = time.monotonic()
        while self.reader.pending:  # what came while this process was not run
            self._take(self.reader.next(0.0))
        said = (said for said, _ in self.poses if since < said < now)
        return float(np.diff([since, *sorted(said), now]).max())


@contextmanager
def _process(command, **more):
    with subprocess.Popen(command, text=True, **more) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(8.0)
            except subprocess.TimeoutExpired:
                process.kill()


@contextmanager
def _namespaces(*names):
    for name in names:
        subprocess.run(["ip", "netns", "add", name], check=True)
    try:
        yield names
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", name], check=False)


@contextmanager
def two_hosts(folder):
    """A running pipeline on two computers."""
    made = Authority.make(folder / "robot" / "secure", [CAMERAS], 30)
    made.add("desk", 30)
    (folder / "desk" / "secure").mkdir(parents=True)
    for name in ("authority.pem", "desk.pem", "desk.key"):
        shutil.copy(made.folder / name, folder / "desk" / "secure")
    (folder / "boot").write_text("01234567-89ab-cdef-0123-456789abcdef\n")
    for host in ("robot", "desk"):
        (folder / host / "pipeline.yaml").write_text(_PIPELINE)
    robot, desk = (f"huepose-{os.getpid()}-{host}" for host in ("robot", "desk"))
    cable = [sys.executable, Path(__file__).with_name("cable.py")]
    cable += [robot, f"{CAMERAS}/24", desk, f"{OTHERS}/24"]
    of_desk = f"mount --bind {folder}/boot {_BOOT} && exec {_HUEPOSE} up --host desk"
    other = ["unshare", "-T", "-m", "--monotonic", str(_AHEAD_S), "sh", "-c", of_desk]

    @contextmanager
    def up(namespace, host, command):
        environment = os.environ | {FOLDER: str(folder / f"run_{host}")}
        command = ["ip", "netns", "exec", namespace, *command]
        with (
            (folder / f"{host}.log").open("w") as log,
            _process(command, cwd=folder / host, env=environment, stdout=log, stderr=log) as process,
        ):
            yield process

    with _namespaces(robot, desk), _process(cable, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as wire:
        assert wire.stdout.readline() == "there\n"
        with up(desk, "desk", other) as second, up(robot, "robot", [*_HUEPOSE.split(), "up"]) as first:
            hosts = TwoHosts(folder, wire)
            with hosts.reader:
                yield hosts
            for process in (first, second):
                process.send_signal(signal.SIGTERM)
            assert [process.wait(10.0) for process in (first, second)] == [0, 0]


def _reset(folder, name):
    """A command that runs beside the test, which goes on reading messages."""
    environment = os.environ | {FOLDER: str(folder / "run_robot")}
    return _process([*_HUEPOSE.split(), "objects", "reset", name], env=environment)


def test_tracking_goes_on_alone_while_the_cable_is_cut_and_is_corrected_afterwards(tmp_path):
    with two_hosts(tmp_path) as hosts:
        assert hosts.look(120.0, lambda: len(hosts.tracked()) == 5), "not all five objects were found"
        # Answers have the time of the camera's clock, whatever that of the other computer says.
        hosts.order("delay 20", "loss 0.005")
        hosts.answers.clear()
        assert hosts.look(30.0, lambda: len(hosts.answers) >= 5)
        assert all(0.0 < age_s < 10.0 for age_s in hosts.answers)
        assert hosts.health["estimator"].age_ms is None
        assert not hosts.health["uplink"].warnings
        # Cut: there is a warning, tracking goes on, a lost object stays lost.
        hosts.order("cut")
        cut = time.monotonic()
        with _reset(tmp_path, "tea_box") as reset:
            assert hosts.look(8.0, lambda: "desk has sent nothing" in str(hosts.health["uplink"].warnings))
            hosts.look(10.0)
            assert reset.poll() == 0
        assert hosts.longest_gap_s(cut) < 1.0
        assert len(hosts.tracked(2.0)) == 4
        assert hosts.searching["tea_box"] == 1
        # Mended: everything recovers by itself.
        hosts.answers.clear()
        hosts.order("delay 0", "loss 0", "mend")
        assert hosts.look(15.0, lambda: len(hosts.answers) > 0)
        assert hosts.look(30.0, lambda: len(hosts.tracked()) == 5)
        assert hosts.look(5.0, lambda: not hosts.health["uplink"].warnings)
        assert len(hosts.errors_m) > 100
        assert max(hosts.errors_m) < 0.05
