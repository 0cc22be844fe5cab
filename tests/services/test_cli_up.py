"""How `huepose up` stops the workers of several cameras, and what it says of a new one."""

import argparse
import json
import signal
import threading

import pytest

from huepose_services.cli import up
from huepose_services.runtime import prepare, reload, running, supervisor


def test_the_workers_of_all_cameras_are_stopped_at_the_same_time(tmp_path, monkeypatch):
    together = threading.Barrier(3)

    class Ended(supervisor.Supervisor):
        def start(self):
            self.exit_code = 0

        def stop(self):
            together.wait(5.0)

    monkeypatch.setattr(supervisor, "Supervisor", Ended)
    monkeypatch.setattr(prepare, "prepare", lambda config: None)
    monkeypatch.setattr(reload, "asked_again", lambda: lambda: False)
    monkeypatch.setattr(up, "catch_stop_signals", lambda: lambda: False)
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path / "run"))
    path = tmp_path / "pipeline.yaml"
    path.write_text(json.dumps({"cameras": [{"name": name} for name in ("left", "right", "top")]}))
    assert up.call(argparse.Namespace(config=path, host=None)) == 0


def test_a_camera_that_is_added_to_the_file_is_reported_as_waiting(tmp_path, monkeypatch, capsys):
    path = tmp_path / "pipeline.yaml"

    def write(*names):
        path.write_text(json.dumps({"cameras": [{"name": name} for name in names]}))

    class Ended(supervisor.Supervisor):
        def start(self):
            write("left", "right", "top")

        def poll(self, timeout_s=0.1):
            self.exit_code = 0

    monkeypatch.setattr(supervisor, "Supervisor", Ended)
    monkeypatch.setattr(prepare, "prepare", lambda config: None)
    monkeypatch.setattr(reload, "asked_again", lambda: lambda: True)
    monkeypatch.setattr(up, "catch_stop_signals", lambda: lambda: False)
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path / "run"))
    write("left", "right")
    assert up.call(argparse.Namespace(config=path, host=None)) == 0
    said = capsys.readouterr().err
    assert "cameras that wait for the next start: top" in said
    assert said.count("wait for the next start") == 1


@pytest.mark.usefixtures("same_handlers")
def test_a_request_to_read_the_file_again_does_not_end_the_preparation(tmp_path, monkeypatch):
    ended, read = [], []

    class Asked(supervisor.Supervisor):
        def start(self):
            pass

        def poll(self, timeout_s=0.1):
            self.exit_code = 0

        def reload(self):
            read.append(self)

    monkeypatch.setattr(supervisor, "Supervisor", Asked)
    monkeypatch.setattr(prepare, "prepare", lambda config: signal.raise_signal(signal.SIGHUP))
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path / "run"))
    path = tmp_path / "pipeline.yaml"
    path.write_text("camera: {name: cam0}")
    signal.signal(signal.SIGHUP, lambda *_: ended.append("the default ends the process"))
    assert up.call(argparse.Namespace(config=path, host=None)) == 0
    assert ended == []
    assert len(read) == 1


def test_its_own_lines_are_in_the_form_of_the_log(tmp_path, monkeypatch, capsys):
    class Ended(supervisor.Supervisor):
        def start(self):
            self.exit_code = 0

    monkeypatch.setattr(supervisor, "Supervisor", Ended)
    monkeypatch.setattr(prepare, "prepare", lambda config: None)
    monkeypatch.setattr(reload, "asked_again", lambda: lambda: False)
    monkeypatch.setattr(running, "namesake", lambda pipeline: "another one has the same name")
    monkeypatch.setattr(up, "catch_stop_signals", lambda: lambda: True)
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path / "run"))
    monkeypatch.setenv("HUEPOSE_LOG", "json")
    path = tmp_path / "pipeline.yaml"
    path.write_text("camera: {name: cam0}")
    assert up.call(argparse.Namespace(config=path, host=None)) == 0
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    said = [(line["level"], line["worker"], line["text"]) for line in lines]
    assert said == [("warn", "huepose", "another one has the same name"), ("info", "huepose", "stopped")]
