"""The systemd units: their content, and systemd's own checks of them."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path, PurePosixPath

import pytest

from huepose_services.cli.main import main
from huepose_services.cli.units import units
from huepose_services.runtime.config import CHAIN, Config, ObjectConfig
from huepose_services.runtime.config_file import load, load_all
from huepose_services.runtime.config_perception import CameraConfig, DetectorConfig
from tests.disk import full_disk

ROOT = Path(__file__).parents[2]
SECURITY = ROOT / "deploy" / "security.sh"
LIVE = {
    "workers": [*CHAIN, "gateway", "viewer"],
    "camera": {"source": "oak"},
    "detector": {"kind": "yolo", "model": "net.onnx", "classes": {"mug": 0}},
    "bundles": "bundles",
    "objects": [{"name": "mug"}],
}


PIPELINES = {
    "synthetic": {"camera": {"truth": True}},
    "live": LIVE,
    "cameras": {"cameras": [{"name": "left"}, {"name": "right-2"}]},
}


HUEPOSE, CONFIG = PurePosixPath("/opt/huepose/.venv/bin/huepose"), PurePosixPath("/etc/huepose/pipeline.yaml")


needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None,
    reason="systemd-analyze (Debian: package systemd) is not installed",
)


def _units(config):
    return units([config], HUEPOSE, CONFIG, "huepose")


def _value(text, key):
    (value,) = re.findall(rf"^{key}=(.*)$", text, re.MULTILINE)
    return value


@pytest.fixture(params=["synthetic", "live", "cameras"])
def installed(request, tmp_path):
    """The units of the default pipeline, of one with a camera, a GPU network and outside readers, or with two
    cameras."""
    path = tmp_path / "pipeline.yaml"
    path.write_text(json.dumps(PIPELINES[request.param]))
    out = tmp_path / "units"
    command = Path(sys.executable).parent / "huepose"
    user = subprocess.run(["id", "-un"], capture_output=True, text=True, check=True).stdout.strip()
    arguments = ["units", path, "--out", out, "--user", user]
    subprocess.run([sys.executable, "-m", "huepose_services.cli.main", *map(str, arguments)], check=True)
    started = shlex.split(_value((out / "huepose@.service").read_text(), "ExecStart"))
    assert started[:3] == [str(command), "run", "%i"]
    return out


@needs_systemd
def test_systemd_has_no_complaint_about_the_units(installed):
    workers = re.findall(r"Wants=(.*)", (installed / "huepose.target").read_text())
    files = [str(installed / name) for name in ["huepose.target", *workers]]
    # Instances exist only through their template, beside which systemd looks for it.
    for worker in workers:
        (installed / worker).symlink_to("huepose@.service")
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", *files],
        capture_output=True,
        text=True,
        env={**os.environ, "SYSTEMD_UNIT_PATH": f"{installed}:"},
        timeout=60,
    )
    # An unknown key is only a warning there, with exit code 0.
    ours = [line for line in (done.stdout + done.stderr).splitlines() if "huepose" in line]
    assert ours == []
    assert done.returncode == 0


@needs_systemd
@pytest.mark.parametrize("live", [False, True])
def test_the_sandbox_of_every_worker_is_tight(live, tmp_path):
    """As the documentation says: 1.9 of 10; a little more for the gateway and the viewer, which other
    machines reach, and for the camera and a network's worker, which have devices."""
    path = ROOT / "pipeline.yaml"
    if live:
        path = tmp_path / "pipeline.yaml"
        path.write_text(json.dumps(LIVE))
    done = subprocess.run(
        ["bash", str(SECURITY), str(path)], capture_output=True, text=True, timeout=120, check=True
    )
    scores = {worker: float(score) for worker, score in re.findall(r"\| (\w+) \| ([\d.]+) \|", done.stdout)}
    assert set(scores) == set(LIVE["workers"] if live else CHAIN)
    more = {"camera", "detector", "gateway", "viewer"} if live else set()
    assert {worker for worker, score in scores.items() if score > 2.0} <= more
    assert max(scores.values()) <= 2.3, scores


def test_the_target_starts_the_workers_of_the_file():
    files = _units(Config(workers=("camera", "tracker")))
    assert re.findall(r"Wants=(.*)", files["huepose.target"]) == [
        "huepose@camera.service",
        "huepose@tracker.service",
    ]
    assert "Nice=-5" in files["huepose@camera.service.d/needs.conf"]


def test_the_workers_of_each_camera_have_the_names_that_run_accepts(tmp_path, monkeypatch):
    path = tmp_path / "pipeline.yaml"
    cameras = [{"name": "left", "source": "realsense"}, {"name": "right", "source": "bop", "path": "scene"}]
    path.write_text(json.dumps({"workers": ["camera", "tracker"], "bundles": "bundles", "cameras": cameras}))
    files = units(load_all(path), HUEPOSE, path, "huepose")
    wants = re.findall(r"Wants=huepose@(.*)\.service", files["huepose.target"])
    assert wants == ["left.camera", "left.tracker", "right.camera", "right.tracker"]
    assert "char-usb_device" in files["huepose@left.camera.service.d/needs.conf"]
    assert "char-usb_device" not in files["huepose@right.camera.service.d/needs.conf"]
    ran = []

    def run_worker(worker, config, file, of):
        ran.append((f"{config.camera.name}.{worker}", of))
        sys.exit()

    monkeypatch.setattr("huepose_services.runtime.worker.run_worker", run_worker)
    for worker in wants:
        with pytest.raises(SystemExit):
            main(["run", worker, str(path)])
    assert ran == [(worker, worker.split(".")[0]) for worker in wants]
    assert main(["run", "tracker", str(path)]) == 2  # the camera is not named


def test_restarts_and_watchdog_are_those_of_the_file():
    config = load(ROOT / "pipeline.yaml")
    files = _units(config)
    template = files["huepose@.service"]
    assert float(_value(template, "StartLimitIntervalSec")) == config.restarts.window_s
    assert int(_value(template, "StartLimitBurst")) == config.restarts.limit + 1
    for worker in ("camera", "tracker"):
        own = files[f"huepose@{worker}.service.d/needs.conf"]
        assert float(_value(own, "WatchdogSec")) == config.restarts.hung_after_s
    # A search for many objects on a busy board takes longer, and systemd's limit does not grow.
    assert float(_value(template, "WatchdogSec")) == 12 * config.restarts.hung_after_s
    assert float(_value(template, "TimeoutStartSec")) >= config.restarts.start_within_s
    assert _value(template, "RestartPreventExitStatus") == "2"
    assert _value(template, "ExecReload") == "/bin/kill -HUP $MAINPID"


@pytest.mark.parametrize(
    ("source", "devices", "network"),
    [("realsense", True, False), ("oak", True, True), ("python", True, True), ("synthetic", False, False)],
)
def test_a_camera_has_the_rights_of_its_source(source, devices, network):
    """What a file in Python opens may be on USB, a video device or in the network."""
    path = "/etc/huepose/cam.py" if source == "python" else None
    own = _units(Config(camera=CameraConfig(source=source, path=path)))["huepose@camera.service.d/needs.conf"]
    assert ("char-usb_device" in own and "char-video4linux" in own) == devices
    assert ("IPAddressDeny=\n" in own) == network


def test_only_workers_that_need_them_can_use_devices_and_the_network():
    config = Config(
        workers=(*CHAIN, "gateway"),
        camera=CameraConfig(source="realsense"),
        detector=DetectorConfig(kind="yolo", model="/net.onnx", classes={"mug": 0}),
        objects=[ObjectConfig(name="mug")],
    )
    files = _units(config)
    assert "PrivateDevices=yes" in files["huepose@.service"]
    assert "IPAddressDeny=any" in files["huepose@.service"]
    with_devices = {name for name, text in files.items() if "PrivateDevices=no" in text}
    assert with_devices == {"huepose@camera.service.d/needs.conf", "huepose@detector.service.d/needs.conf"}
    with_network = {name for name, text in files.items() if "IPAddressDeny=\n" in text}
    assert with_network == {"huepose@gateway.service.d/needs.conf"}
    assert not any(
        "network-online" in text for text in files.values()
    )  # each waits by itself for its network


def test_paths_with_blanks_and_percent_signs_stay_one_word():
    template = units([Config()], PurePosixPath("/opt/my apps/100%/huepose"), CONFIG, "huepose")[
        "huepose@.service"
    ]
    assert _value(template, "ExecStart") == f'"/opt/my apps/100%%/huepose" run %i {CONFIG}'


def test_paths_that_the_services_cannot_see_are_reported(tmp_path, capsys, monkeypatch):
    """In home folders and among temporary files they find neither reference models nor the program itself."""
    monkeypatch.setattr("huepose_services.cli.units._HIDDEN", (str(tmp_path / "home"), "/nowhere"))
    for folder in ("home", "etc"):
        (tmp_path / folder).mkdir()
    there = tmp_path / "etc" / "pipeline.yaml"
    there.write_text("bundles: ../home/bundles\nobjects: [{name: mug}]\n")
    assert main(["units", str(there), "--out", str(tmp_path / "units")]) == 0
    said = capsys.readouterr().err
    assert "these units cannot work, because services have no access to" in said
    assert said.splitlines()[1:] == [f"  bundles: {tmp_path}/home/bundles"]
    there.write_text("bundles: ../var/bundles\nobjects: [{name: mug}]\n")
    assert main(["units", str(there), "--out", str(tmp_path / "units")]) == 0
    assert capsys.readouterr().err == ""


def test_units_in_use_outlive_a_full_disk(tmp_path, capsys):
    given = ["units", str(ROOT / "pipeline.yaml"), "--out", str(tmp_path)]
    assert main(given) == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    capsys.readouterr()
    with full_disk():
        assert main([*given, "--user", "other"]) == 2
    assert "File too large" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_path_in_another_encoding_is_refused(tmp_path, capsys):
    there = tmp_path / "caf\udce9.yaml"
    there.write_text("bundles: bundles\nobjects: [{name: mug}]\n")
    assert main(["units", str(there), "--out", str(tmp_path / "units")]) == 2
    assert "a path that is not in UTF-8" in capsys.readouterr().err


def test_an_invalid_user_name_is_refused(tmp_path, capsys):
    assert main(["units", str(ROOT / "pipeline.yaml"), "--out", str(tmp_path), "--user", "bob smith"]) == 2
    assert "--user: found bob smith; expected a user name" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
