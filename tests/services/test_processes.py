"""Real worker processes: the camera, its readers, the supervisor, the command line."""

import fcntl
import json
import os
import re
import signal
import socket
import time
from dataclasses import replace
from itertools import pairwise

import pytest

from huepose.model import save_model
from huepose_protos.client import Reader
from huepose_protos.local import endpoint, run_folder
from huepose_protos.messages import HealthMessage, TruthMessage
from huepose_services.cli.main import main
from huepose_services.runtime.run_folder import make_folder
from tests.services.conftest import STAMPS_NS

pytestmark = pytest.mark.live


def _messages(reader, kind, timeout_s=30.0):
    """All messages until the workers that were seen have ended."""
    got, deadline = [], time.monotonic() + timeout_s
    while time.monotonic() < deadline and not (reader.seen and not reader.live):
        message = reader.next(0.1)
        if isinstance(message, kind):
            got.append(message)
    return got


def test_a_recording_is_played_once_on_time_and_ends_the_pipeline(
    pipeline, huepose, base_port, tmp_path, monkeypatch
):
    """A subscriber that started first, in a folder without its file, finds the pipeline and ends with it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = pipeline(first_frame_s=2.0)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    printer = huepose("poses", "health/*", "--json")
    assert "waiting for a pipeline" in printer.stderr.readline()
    with Reader([endpoint(base_port)], "huepose/*/*/truth") as reader:
        process = huepose("up", path)
        # The first frame is sent repeatedly during its pause.
        truths = list({t.frame_id: t for t in _messages(reader, TruthMessage)}.values())
    out, err = process.communicate(timeout=15.0)
    assert process.returncode == 0, err
    assert "the recording has ended after 12 frames" in err
    assert [t.image for t in truths] == list(range(3, 15))
    assert [t.frame_id for t in truths] == list(range(3, 15))
    assert len({t.camera_epoch for t in truths}) == 1
    # The recorded intervals are kept in the timestamps exactly, after the pause on the first frame.
    stamps = [t.capture_ns for t in truths]
    gaps = [b - a for a, b in pairwise(stamps)]
    recorded = [b - a for a, b in pairwise(STAMPS_NS)]
    assert 1.99e9 < gaps[0] - recorded[0] < 3.0e9
    late = sum(a != b for a, b in zip(gaps[1:], recorded[1:], strict=True))
    assert late <= 2, "the schedule moves only if the machine is blocked"
    assert all(t.publish_ns >= t.capture_ns for t in truths)
    assert truths[3].objects[0].translation == (0.0, 0.0, 0.503)
    assert truths[3].objects[0].object_id == 5
    out, err = printer.communicate(timeout=15.0)
    assert printer.returncode == 0
    assert f"this is local/cam0, which runs from {path}" in err
    lines = [json.loads(line) for line in out.splitlines()]
    assert {line["worker"] for line in lines} == {"camera"}
    assert lines[-1]["state"] == "ended"
    assert lines[-1]["counters"]["frames"] == 12


@pytest.fixture
def python_recording(base_port, tmp_path, python_camera, recording):
    """A function that writes cam.py, which gives so many images, 0.1 s apart, and then runs `then`; and
    pipeline.yaml, which plays it once to a tracker. It gives the path of cam.py."""

    def write(pictures, then=""):
        python_camera("pass", every_s=0.1)
        path = tmp_path / "cam.py"
        path.write_text(path.read_text().replace("while True", f"for _ in range({pictures})") + then)
        (tmp_path / "pipeline.yaml").write_text(
            f"bundles: {recording[0] / 'bundles'}\nworkers: [camera, tracker]\n"
            f"bus: {{base_port: {base_port}}}\ncamera: {{source: python, path: cam.py, once: true}}\n"
        )
        return path

    return write


def test_a_recording_of_a_python_file_is_played_once_to_all_workers_and_ends_the_pipeline(
    huepose, base_port, tmp_path, python_recording
):
    """Twelve images, 0.1 s apart: the tracker takes longer to start, and still reads all of them."""
    python_recording(12)
    with Reader([endpoint(base_port), endpoint(base_port + 1)], "huepose/*/*/health/*") as reader:
        process = huepose("up", tmp_path / "pipeline.yaml")
        said = _messages(reader, HealthMessage, 60.0)
    _, err = process.communicate(timeout=15.0)
    assert process.returncode == 0, err
    assert "cam.py has ended after 12 images" in err
    last = {health.worker: health for health in said}
    assert last["camera"].counters["frames"] == 12
    assert last["tracker"].counters["frames"] == 12
    assert len({health.camera_epoch for health in said if health.frame_id is not None}) == 1


def test_a_recording_of_a_python_file_that_raises_is_not_restarted_and_ends_the_pipeline(
    huepose, tmp_path, python_recording
):
    path = python_recording(4, "    raise OSError('the disk is gone')\n")
    process = huepose("up", tmp_path / "pipeline.yaml")
    _, err = process.communicate(timeout=60.0)
    assert process.returncode == 1, err
    assert "cam.py has ended after 4 images" in err
    last = len(path.read_text().splitlines())
    assert err.count(f"OSError: the disk is gone, in cam.py, line {last};") == 1
    assert "the recording has ended, with an error" in err
    assert "starting camera again" not in err
    assert "is called again" not in err


def test_readers_that_leave_and_foreign_bytes_change_nothing_and_ctrl_c_ends_all_in_two_seconds(
    pipeline, huepose, base_port
):
    from huepose_services.runtime.session import open_reader_session

    path = pipeline(once=False, rate=30)
    process = huepose("up", path)
    printer = huepose("poses", "health/*", "--json", "--config", path)
    assert printer.stdout.readline()
    printer.stdout.close()
    assert printer.wait(15.0) == 0
    assert "Traceback" not in printer.stderr.read()
    camera = endpoint(base_port)
    with Reader([camera], "huepose/*/*/health/*") as reader:
        first = reader.next(30.0)
        session = open_reader_session([camera])
        time.sleep(0.3)
        for key in ("frame", "control", "health/tracker", "correction", "live/x"):
            session.put(f"huepose/local/cam0/{key}", b"\xc1" * 100)
        session.close()
        frames = first.counters.get("frames", 0)
        deadline = time.monotonic() + 15.0
        while (message := reader.next(5.0)) is not None:
            assert time.monotonic() < deadline
            if isinstance(message, HealthMessage) and message.counters.get("frames", 0) > frames + 20:
                break
        assert message.pid == first.pid
        assert process.poll() is None
        start = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.wait(5.0) == 0
        assert time.monotonic() - start < 2.0
    with pytest.raises(ProcessLookupError):
        os.kill(first.pid, 0)


def test_a_worker_that_is_killed_or_hangs_is_started_again_and_ends_with_its_supervisor(
    pipeline, huepose, base_port, wait_until
):
    path = pipeline(once=False, rate=30)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"restarts": {"hung_after_s": 0.5}}))
    process = huepose("up", path)
    with Reader([endpoint(base_port)], "huepose/*/*/health/*") as reader:
        first = reader.next(30.0)
        os.kill(first.pid, signal.SIGKILL)
        deadline = time.monotonic() + 30.0
        while (message := reader.next(30.0)) is not None and message.pid == first.pid:
            assert time.monotonic() < deadline
        os.kill(message.pid, signal.SIGSTOP)
        stopped = message.pid
        while (message := reader.next(30.0)) is not None and message.pid == stopped:
            assert time.monotonic() < deadline
        assert message.pid not in (first.pid, stopped)
        assert process.poll() is None
        process.kill()
        wait_until(lambda: not reader.live, 5.0)
    log = process.communicate(timeout=10.0)[1]
    assert "warn  huepose   camera killed by signal 9: starting it again in" in log
    assert "error huepose   camera has given no sign of life for 0." in log


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"path": "/nonexistent/scene"}, ["/nonexistent/scene", "no such folder"]),
        ({"rte": 30}, ["camera.rte", "Did you mean 'rate'?"]),
        ({"rate": "fast"}, ["camera.rate", "'fast'"]),
    ],
)
@pytest.mark.parametrize("verb", ["up", "run", "validate"])
def test_bad_input_is_a_paragraph_and_exit_code_2(pipeline, huepose, capsys, verb, change, parts):
    path = str(pipeline(**change))
    if verb == "run":  # the worker itself refuses it
        process = huepose("run", "camera", path)
        err = process.communicate(timeout=30.0)[1]
        assert process.returncode == 2
    else:
        assert main([verb, path]) == 2
        err = capsys.readouterr().err
    assert err.startswith(f"huepose {verb}: ")
    assert err.count("\n") == 1
    assert all(part in err for part in parts), err


@pytest.mark.parametrize("verb", ["up", "validate"])
@pytest.mark.parametrize("named", [True, False])
def test_a_damaged_reference_model_is_named_once_before_a_worker_starts(
    tea_box, tmp_path, pipeline, capsys, refused, verb, named
):
    model = tmp_path / "bundles" / "tea_box.huepose"
    save_model(tea_box, model)
    path = pipeline()
    objects = {"objects": [{"name": "tea_box"}]} if named else {"workers": ["camera", "tracker"]}
    path.write_text(json.dumps(json.loads(path.read_text()) | {"bundles": "bundles"} | objects))
    if verb == "validate":
        assert main([verb, str(path)]) == 0
        capsys.readouterr()
    whole = model.read_bytes()
    model.unlink()  # it may still be mapped
    model.write_bytes(whole[: len(whole) // 2])
    said = refused([verb, path])
    assert said.startswith(f"huepose {verb}: {model}: found a damaged or foreign file")
    assert said.count("\n") == 1


@pytest.mark.parametrize("verb", ["up", "validate"])
def test_a_method_whose_tables_the_reference_models_lack_is_refused_before_a_worker_starts(
    tea_box, tmp_path, pipeline, refused, verb
):
    path, bare = pipeline(), {"workers": ["camera", "estimator"], "bundles": "bundles"}
    data = json.loads(path.read_text()) | bare
    save_model(replace(tea_box, tables=None), tmp_path / "bundles" / "tea_box.huepose")
    path.write_text(json.dumps(data | {"estimator": {"method": "colorpair"}}))
    said = refused([verb, path])
    assert said.startswith(f"huepose {verb}: estimator.method: found colorpair, and no tables of the paper's")
    assert "in the reference models of tea_box; expected models with these tables. Make them again" in said
    assert "--method" not in said
    if verb == "validate":
        path.write_text(json.dumps(data))
        assert main([verb, str(path)]) == 0, "the method full needs none"
        path.write_text(json.dumps(data | {"workers": ["camera"], "estimator": {"method": "colorpair"}}))
        assert main([verb, str(path)]) == 0, "no estimator runs here"


@pytest.mark.parametrize("verb", [("up",), ("run", "camera")])
def test_a_port_in_use_is_a_paragraph_and_exit_code_2(pipeline, huepose, base_port, verb):
    with socket.socket(socket.AF_UNIX) as other, open(f"{make_folder()}/{base_port}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # as zenoh does
        other.bind(str(make_folder() / str(base_port)))
        other.listen()
        process = huepose(*verb, pipeline())
        out, err = process.communicate(timeout=30.0)
    assert process.returncode == 2
    assert f"port {base_port}" in err
    assert "bus.base_port" in err
    assert "Traceback" not in err


def test_an_unknown_worker_is_named(pipeline, refused):
    assert "worker 'cook'" in refused(["run", "cook", pipeline()])


def test_validate_describes_a_pipeline(pipeline, printed, base_port):
    out = printed(["validate", pipeline()])
    assert "huepose/local/cam0" in out
    assert f"in {run_folder()}: camera {base_port}" in out
    assert re.search("frames   (through shared memory|over the socket)", out)


def test_a_worker_that_keeps_dying_is_given_up(pipeline, huepose, base_port):
    path = pipeline(once=False, rate=30)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"restarts": {"limit": 0}}))
    process = huepose("up", path)
    with Reader([endpoint(base_port)], "huepose/*/*/health/*") as reader:
        os.kill(reader.next(30.0).pid, signal.SIGKILL)
    _, err = process.communicate(timeout=15.0)
    assert process.returncode == 1
    assert "camera killed by signal 9: given up" in err
