"""Which notes are of pipelines that run on this machine."""

import json
import os

from huepose_protos.local import BASE_PORT, base_port_of, boot_id, born_of, writer_runs


def test_a_note_is_of_one_process_and_of_no_later_one_with_its_number(tmp_path):
    mine = born_of(os.getpid())
    note = tmp_path / f"{os.getpid()}-17447.json"
    for said, runs in (
        ({"born": mine}, True),
        ({"born": f"{boot_id()}/1"}, False),
        ({"born": f"another boot/{mine.partition('/')[2]}"}, False),
        ({}, True),
        ([], True),
    ):
        note.write_text(json.dumps(said))
        assert writer_runs(note) == runs
    assert born_of(2**22 + 1) == ""


def test_the_port_of_a_killed_pipeline_is_nobodys_though_another_process_has_its_number(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    note = {"site": "lab", "camera": "cam0"}
    killed = note | {"base_port": 18100, "born": f"{boot_id()}/1"}
    (tmp_path / f"{os.getpid()}-18100.json").write_text(json.dumps(killed))
    assert base_port_of("lab", "cam0") == BASE_PORT
    runs = note | {"base_port": 18200, "born": born_of(os.getpid())}
    (tmp_path / f"{os.getpid()}-18200.json").write_text(json.dumps(runs))
    assert base_port_of("lab", "cam0") == 18200
