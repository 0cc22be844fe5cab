"""Pipelines that run are found, others not."""

import os

import pytest

from huepose_services.runtime.running import base_ports, noted


@pytest.fixture(autouse=True)
def runtime_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "huepose"


def test_a_pipeline_is_found_while_it_runs():
    assert base_ports() == []
    with noted(17447):
        assert base_ports() == [17447]
    assert base_ports() == []


def test_the_note_of_a_dead_process_is_removed(runtime_folder):
    with noted(17447):
        dead = runtime_folder / f"{2**22 + 1}.port"
        dead.write_text("18000")
        assert base_ports() == [17447]
        assert not dead.exists()


def test_a_folder_that_others_may_write_is_not_believed(runtime_folder):
    runtime_folder.mkdir()
    (runtime_folder / f"{os.getpid()}.port").write_text("18000")
    runtime_folder.chmod(0o777)
    assert base_ports() == []
