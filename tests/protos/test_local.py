"""Which note files are of pipelines that run on this machine."""

import json
import os
import subprocess
import sys

import pytest

from huepose_protos.local import (
    BASE_PORT,
    Whereabouts,
    boot_id,
    born_of,
    endpoint,
    pose_endpoints,
    writer_runs,
)


def test_every_shell_of_a_user_has_the_same_folder(monkeypatch, tmp_path):
    for name in ("HUEPOSE_RUN", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    command = [sys.executable, "-c", "from huepose_protos.local import run_folder; print(run_folder())"]
    for folder in (tmp_path, "/tmp"):
        monkeypatch.setenv("TMPDIR", str(folder))
        found = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        assert found == f"/tmp/huepose-{os.getuid()}\n"


def test_a_note_does_not_count_for_a_later_process_with_the_same_pid(tmp_path):
    mine = born_of(os.getpid())
    note = tmp_path / f"{os.getpid()}-17447.json"
    for content, runs in (
        ({"born": mine}, True),
        ({"born": f"{boot_id()}/1"}, False),
        ({"born": f"another boot/{mine.partition('/')[2]}"}, False),
        ({}, True),
        ([], True),
    ):
        note.write_text(json.dumps(content))
        assert writer_runs(note) == runs
    assert born_of(2**22 + 1) == ""


def test_a_killed_pipeline_has_no_port_even_if_another_process_has_its_pid(tmp_path, monkeypatch):
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    note = {"site": "lab", "camera": "cam0"}
    killed = note | {"base_port": 18100, "born": f"{boot_id()}/1"}
    (tmp_path / f"{os.getpid()}-18100.json").write_text(json.dumps(killed))
    assert Whereabouts("lab", "cam0").port == BASE_PORT
    runs = note | {"base_port": 18200, "born": born_of(os.getpid())}
    (tmp_path / f"{os.getpid()}-18200.json").write_text(json.dumps(runs))
    assert Whereabouts("lab", "cam0").port == 18200


def _run(folder, camera, port, process=None):
    note = {"site": "lab", "camera": camera, "base_port": port, "file": f"/etc/{camera}.yaml"}
    (folder / f"{process or os.getpid()}-{port}.json").write_text(json.dumps(note))


def test_poses_are_read_from_the_only_running_pipeline(tmp_path, monkeypatch):
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    assert pose_endpoints() == [endpoint(BASE_PORT + 1), endpoint(BASE_PORT)]
    _run(tmp_path, "gone", 18300, 2**22 + 1)
    _run(tmp_path, "right", 18100)
    _run(tmp_path, "right", 18100, os.getppid())  # another of its workers, run by itself
    assert pose_endpoints() == [endpoint(18101), endpoint(18100)]
    assert pose_endpoints(17447) == [endpoint(17448), endpoint(17447)]
    assert pose_endpoints(folder=tmp_path / "other") == [
        endpoint(17448, tmp_path / "other"),
        endpoint(17447, tmp_path / "other"),
    ]


def test_with_several_pipelines_one_must_be_named(tmp_path, monkeypatch):
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    _run(tmp_path, "right", 18120)
    _run(tmp_path, "left", 18100)
    with pytest.raises(ValueError) as error:
        pose_endpoints()
    assert str(error.value) == (
        "pose_endpoints: found 2 pipelines that run here: lab/left at port 18100 (/etc/left.yaml), lab/right "
        "at port 18120 (/etc/right.yaml); expected one. Say which: pose_endpoints(18100), or "
        'PoseClient(None, site="lab", camera="left")'
    )
    assert Whereabouts("lab", "right").port == 18120


def test_the_port_of_another_camera_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    _run(tmp_path, "left", 17447)
    place = Whereabouts("lab", "rigth")
    assert place.port is None
    assert place.absence() == (
        "no pipeline of lab/rigth runs here, only lab/left at port 17447 (/etc/left.yaml)"
    )


def test_two_pipelines_of_one_name_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    _run(tmp_path, "left", 18120)
    _run(tmp_path, "left", 18100)
    with pytest.raises(ValueError) as error:
        Whereabouts("lab", "left")
    assert str(error.value) == (
        "2 pipelines of lab/left run here: lab/left at port 18100 (/etc/left.yaml), lab/left at port 18120 "
        "(/etc/left.yaml); expected one. Say which: by site and camera, or by its port, as 18100"
    )
    with pytest.raises(ValueError, match=r"Say which: pose_endpoints\(18100\)$"):
        pose_endpoints()


def test_a_camera_is_found_again_at_another_port(tmp_path, monkeypatch):
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    monkeypatch.setattr("huepose_protos.local._LOOK_EVERY_NS", 0)
    _run(tmp_path, "left", 18100)
    place = Whereabouts("lab", "right")
    assert (place.port, place.has_moved()) == (None, False)
    _run(tmp_path, "right", 18120)
    assert (place.has_moved(), place.port, place.absence()) == (True, 18120, None)
    _run(tmp_path, "right", 18140)  # the known port is kept
    assert (place.has_moved(), place.port, place.absence()) == (False, 18120, None)
    (tmp_path / f"{os.getpid()}-18120.json").unlink()
    assert (place.has_moved(), place.port) == (True, 18140)
