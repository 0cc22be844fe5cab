"""A tiny recorded scene, a camera that is a Python file, free ports, and pipelines as files."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.model.io import model_path, save_model
from huepose.onboarding import batch
from huepose.onboarding.reference import silent
from huepose.scenes.builtin import SyntheticScene
from huepose_protos.local import FOLDER, run_folder
from huepose_services.cli.main import BAD_INPUT, main
from huepose_services.runtime.config_file import parse_all
from huepose_services.runtime.run_folder import is_taken

NAME, PLAYED = "tea_box", 30
FRAMES = 12
STAMPS_NS = [1_000_000_000 + i * 30_000_000 + (i % 3) * 5_000_000 for i in range(FRAMES)]


@pytest.fixture(autouse=True)
def _same_run_folder():
    """A command sets the folder of the pipeline that it has found, for its whole process."""
    before = os.environ.get(FOLDER)
    yield
    os.environ.pop(FOLDER, None)
    if before is not None:
        os.environ[FOLDER] = before


@pytest.fixture
def scene(tmp_path):
    """A BOP scene of 12 frames of 64 x 48 pixels with uneven timestamps and one label; image 5 is red."""
    folder = tmp_path / "scene"
    (folder / "rgb").mkdir(parents=True)
    (folder / "depth").mkdir()
    cameras, labels = {}, {}
    for i in range(FRAMES):
        color = np.full((48, 64, 3), i, np.uint8)
        if i == 5:
            color[:] = (0, 0, 255)  # BGR
        cv2.imwrite(str(folder / "rgb" / f"{i + 3:06d}.png"), color)
        cv2.imwrite(str(folder / "depth" / f"{i + 3:06d}.png"), np.full((48, 64), 500 + i, np.uint16))
        K = [60.0, 0.0, 31.5, 0.0, 60.0, 23.5, 0.0, 0.0, 1.0]
        cameras[str(i + 3)] = {"cam_K": K, "depth_scale": 1.0, "timestamp_ns": STAMPS_NS[i]}
        R = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
        labels[str(i + 3)] = [{"cam_R_m2c": R, "cam_t_m2c": [0.0, 0.0, 500.0 + i], "obj_id": 5}]
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    (folder / "scene_gt.json").write_text(json.dumps(labels))
    return folder


_PORTS, _OWN = range(10_000, 17_000), 500
"""Tests listen at these: the kernel gives none of them to outgoing connections, and no pipeline has them by
default."""


@cache
def _own_ports() -> range:
    """Ports of this process alone, until it ends: tests run in other processes as well, and listen at free
    ports only seconds later."""
    for first in np.random.default_rng().permutation(_PORTS[::_OWN]):
        with socket.socket(socket.AF_UNIX) as held, suppress(OSError):
            held.bind(f"\0ports of the tests of huepose {first}")
            held.detach()
            return range(first, first + _OWN)
    raise RuntimeError("other tests hold all ports")


def free_port_range(count: int) -> int:
    """The first of `count` consecutive ports that are free, on the network and in the folder of sockets."""
    rng, own, folder = np.random.default_rng(), _own_ports(), run_folder()
    while True:
        base = int(rng.choice(own[: _OWN + 1 - count]))
        probes = [socket.socket() for _ in range(count)]
        try:
            for offset, probe in enumerate(probes):
                probe.bind(("127.0.0.1", base + offset))
            if not any(is_taken(folder, base + offset) for offset in range(count)):
                return base
        except OSError:
            continue
        finally:
            for probe in probes:
                probe.close()


@pytest.fixture
def base_port():
    return free_port_range(10)


@pytest.fixture
def pipeline(tmp_path, scene, base_port):
    """Writes a pipeline.yaml with the camera alone; keyword arguments go into its camera section."""

    def write(**camera):
        settings = {"source": "bop", "path": str(scene), "rate": "recorded", "once": True, "truth": True}
        settings |= {"first_frame_s": 0.2, **camera}
        path = tmp_path / "pipeline.yaml"
        data = {"workers": ["camera"], "camera": settings, "bus": {"base_port": base_port}}
        path.write_text(json.dumps(data))  # JSON is YAML
        return path

    return write


@pytest.fixture(scope="session")
def recording(tmp_path_factory, tea_box):
    """A second of the built-in scene with one object, as a BOP scene that repeats without a jump;
    with its folder, which also has the model, its mesh and labels."""
    folder = tmp_path_factory.mktemp("recording")
    mesh = tea_box.mesh
    save_model(replace(tea_box, object_id=1, tables=None), model_path(folder / "bundles", NAME))
    scene = SyntheticScene(seconds=1.0, objects={NAME: mesh})
    (folder / "scene" / "rgb").mkdir(parents=True)
    (folder / "scene" / "depth").mkdir()
    cameras, truths = {}, []
    for i, sample in enumerate(scene):
        rgb = np.ascontiguousarray(sample.frame.color[..., ::-1])
        cv2.imwrite(str(folder / "scene" / "rgb" / f"{i:06d}.png"), rgb)
        depth = np.rint(sample.frame.depth * 10_000).astype(np.uint16)
        cv2.imwrite(str(folder / "scene" / "depth" / f"{i:06d}.png"), depth)
        cameras[str(i)] = {"cam_K": scene.camera.K.ravel().tolist(), "depth_scale": 0.1}
        truths.append(sample.truths[0])
    assert len(truths) == PLAYED
    (folder / "scene" / "scene_camera.json").write_text(json.dumps(cameras))
    return folder, mesh, truths


def patient_pipeline(bundles, scene, **changes):
    """A pipeline that repeats a scene slowly, with long deadlines: its tests are not about delays on a busy
    machine."""
    return {
        "bundles": str(bundles),
        "objects": [{"name": NAME}],
        "camera": {"source": "bop", "path": str(scene), "rate": 8},
        "reinit": {"deadline_ms": 3000},
        "tracker": {"max_age_ms": 2000},
        "restarts": {"hung_after_s": 60},
        "bus": {"base_port": free_port_range(10)},
        **changes,
    }


@contextmanager
def processes():
    """A function that starts `huepose` processes; at the end, those that still run are ended."""
    processes = []

    def start(*arguments):
        command = [sys.executable, "-m", "huepose_services.cli.main", *map(str, arguments)]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1
        )
        processes.append(process)
        return process

    try:
        yield start
    finally:
        for process in processes:
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(5.0)
                except subprocess.TimeoutExpired:
                    process.kill()
            process.communicate()


@pytest.fixture
def onboards_here(monkeypatch):
    """Folders of meshes are onboarded in this process: a new one first imports and loads all it needs
    (`tests/onboarding/test_onboard.py` starts processes)."""

    def onboarded(jobs, bundles, _):
        for job in jobs:
            yield batch.onboard_one(job, bundles, silent)

    monkeypatch.setattr(batch, "onboard_many", onboarded)


@pytest.fixture
def same_handlers():
    """Restores the signal handlers after the test."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def heeds_ctrl_c():
    """For a process as it starts: it inherits an ignored SIGINT from a program that runs the tests."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def started_by(pid):
    """The child processes of a process."""
    try:
        return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def runs(pid):
    try:
        # A process that has ended stays listed until its new parent waits for it.
        return "(zombie)" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


@pytest.fixture
def huepose():
    """Starts `huepose` processes and ends those that a test left behind."""
    with processes() as start:
        yield start


def until(condition, timeout_s=10.0, act=lambda: time.sleep(0.02)):
    """The first true value of a condition; `act` is called until then."""
    deadline = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < deadline, "the condition did not hold in time"
        act()
    return found


def parse(text, path):
    """The configuration in a text of one camera; `path` names it in errors."""
    (config,) = parse_all(text, path)
    return config


Says = Callable[[Sequence[object]], str]


@pytest.fixture
def refused(capsys) -> Says:
    """A function of a command's words: its error output, after it has refused them."""

    def said(words):
        try:
            code = main([str(word) for word in words])
        except SystemExit as ended:  # by argparse
            code = ended.code
        assert code == BAD_INPUT
        return capsys.readouterr().err

    return said


@pytest.fixture
def printed(capsys) -> Says:
    """A function of a command's words: its output, after it has succeeded."""

    def said(words):
        assert main([str(word) for word in words]) == 0
        return capsys.readouterr().out

    return said


@pytest.fixture
def wait_until():
    return until


PYTHON_CAMERA = """import time

import numpy as np

from huepose import Camera, RgbdFrame


def frames():
    rng, focal = np.random.default_rng(0), 0.9375 * WIDTH
    while True:
        time.sleep(EVERY_S)
        color = rng.integers(60, 200, (3 * WIDTH // 4, WIDTH, 3), np.uint8)
        depth = np.full(color.shape[:2], 0.7, np.float32)
        stamp_ns = 0
        CHANGE
        camera = Camera(focal, focal, 0.5 * WIDTH - 0.5, 0.375 * WIDTH - 0.5, WIDTH, 3 * WIDTH // 4)
        yield RgbdFrame(color, depth, camera, stamp_ns=stamp_ns)
"""


@pytest.fixture
def python_camera(tmp_path):
    """Writes cam.py: a camera of coloured noise 0.7 m away; the statements `change` may change `color`,
    `depth`, `stamp_ns` and `focal`."""

    def write(change, width=64, every_s=0.02):
        text = PYTHON_CAMERA.replace("WIDTH", str(width)).replace("EVERY_S", str(every_s))
        (tmp_path / "cam.py").write_text(text.replace("CHANGE", change))

    return write
