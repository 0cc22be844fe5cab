"""Pipelines that run are found, others are not; if several run, one must be named."""

import argparse
import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import msgspec
import pytest

from huepose.support.errors import InputError
from huepose_protos.local import run_folder
from huepose_protos.messages import ObjectEntry
from huepose_services.cli.main import main
from huepose_services.cli.options import chosen, chosen_config
from huepose_services.cli.poses import _silence
from huepose_services.cli.status import as_text
from huepose_services.runtime.config import BusConfig, Config, LinkConfig
from huepose_services.runtime.running import Pipeline, described, namesake, noted, occupant, pick, running
from huepose_services.watch import View


@pytest.fixture(autouse=True)
def runtime_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    global HERE
    folder = tmp_path / "huepose"
    HERE = Pipeline(base_port=18100, site="lab", camera="cam0", file="/etc/lab.yaml", folder=str(folder))
    return folder


def test_a_pipeline_is_found_while_it_runs():
    assert running() == []
    assert pick() == Pipeline(base_port=17447)  # the default one
    with noted(HERE):
        assert running() == [HERE]
        assert pick() == HERE
        assert HERE.endpoints[1] == f"unixsock-stream/{run_folder()}/18101"
        assert HERE.key("pose/**") == "huepose/lab/cam0/pose/**"
    assert running() == []


def test_a_pipeline_in_a_folder_that_is_no_utf8_is_found():
    with noted(msgspec.structs.replace(HERE, file="/caf\udce9/lab.yaml")):
        assert running() == [msgspec.structs.replace(HERE, file=r"/caf\udce9/lab.yaml")]


def test_the_note_of_a_dead_process_is_removed(runtime_folder):
    with noted(HERE):
        dead = runtime_folder / f"{2**22 + 1}.json"
        dead.write_text('{"base_port": 18000}')
        assert running() == [HERE]
        assert not dead.exists()


def test_the_note_of_a_killed_process_is_removed_even_if_another_one_has_its_pid(runtime_folder):
    with noted(HERE):
        own = json.loads(next(runtime_folder.glob("*.json")).read_text())
        later = runtime_folder / f"{os.getppid()}-18000.json"
        later.write_text(json.dumps(own | {"base_port": 18000, "born": "another boot/1"}))
        assert running() == [HERE]
        assert not later.exists()


def test_a_folder_that_others_may_write_is_not_trusted(runtime_folder):
    runtime_folder.mkdir()
    (runtime_folder / f"{os.getpid()}.json").write_text('{"base_port": 18000}')
    runtime_folder.chmod(0o777)
    assert running() == []


def test_of_two_pipelines_one_must_be_named(runtime_folder):
    with noted(HERE):
        # Another process that surely runs: the one that started this one.
        (runtime_folder / f"{os.getppid()}.json").write_text(
            '{"base_port": 18200, "site": "hall", "camera": "eye"}'
        )
        with pytest.raises(InputError) as refusal:
            pick()
        assert "2 that run here" in str(refusal.value)
        assert "lab/cam0 at port 18100 (/etc/lab.yaml)" in str(refusal.value)
        lab, hall = r"18100 \(or lab/cam0\), or --config /etc/lab", r"18200 \(or hall/eye\), or --config PIPE"
        assert re.search(f"Say which: --pipeline ({lab}|{hall})", str(refusal.value))
        assert pick(which="lab/cam0") == pick(which="cam0") == pick(which="18100") == HERE
        assert pick(which="hall").base_port == 18200
        with pytest.raises(InputError, match="no such pipeline here"):
            pick(which="attic")


def test_a_suggested_file_is_quoted_for_the_shell(runtime_folder):
    with noted(msgspec.structs.replace(HERE, file="/my robot/lab.yaml")):
        other = {"base_port": 18200, "site": "hall", "camera": "eye", "file": "/my robot/hall.yaml"}
        (runtime_folder / f"{os.getppid()}.json").write_text(json.dumps(other))
        with pytest.raises(InputError, match=r"or --config '/my robot/(lab|hall)\.yaml'\.$"):
            pick()


def test_of_two_cameras_of_one_file_the_file_is_not_suggested(runtime_folder):
    with noted(HERE):
        other = '{"base_port": 18120, "site": "lab", "camera": "right", "file": "/etc/lab.yaml"}'
        (runtime_folder / f"{os.getppid()}.json").write_text(other)
        with pytest.raises(InputError, match=r"Say which: --pipeline 181[02]0 \(or lab/(cam0|right)\)\."):
            pick()


def test_a_recording_that_is_played_is_not_suggested_as_a_configuration(runtime_folder):
    recording = msgspec.structs.replace(HERE, base_port=17447, file="/run1.mcap")
    with noted(recording):
        other = {"base_port": 18200, "site": "lab", "camera": "cam0", "file": "/run2.mcap"}
        (runtime_folder / f"{os.getppid()}.json").write_text(json.dumps(other))
        with pytest.raises(InputError, match=r"Say which: --pipeline (17447|18200)\.$"):
            pick()


def test_two_pipelines_of_one_name_are_distinguished_by_their_ports(runtime_folder):
    with noted(HERE):
        other = '{"base_port": 18200, "site": "lab", "camera": "cam0"}'
        (runtime_folder / f"{os.getppid()}.json").write_text(other)
        with pytest.raises(InputError, match=r"Say which: --pipeline 18[12]00, or --config"):
            pick(which="lab/cam0")
        assert pick(which="18200").base_port == 18200


def test_another_pipeline_of_the_same_name_is_reported(runtime_folder):
    with noted(HERE):
        assert namesake(HERE) is None, "this one is meant"
        other = {"base_port": 18200, "site": "lab", "camera": "cam0", "file": "hall.yaml"}
        note = runtime_folder / f"{os.getppid()}.json"
        note.write_text(json.dumps(other))
        assert namesake(HERE) is None, "a recording that is played does not count"
        note.write_text(json.dumps(other | {"workers": ["camera"]}))
        warning = namesake(HERE)
        assert "lab/cam0 at port 18200 (hall.yaml) has the same name" in warning
        assert "`site` or `camera.name`" in warning


def test_a_configuration_names_its_pipeline_whether_it_runs_or_not(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("{site: attic, bus: {base_port: 19000}, camera: {name: eye, truth: true}}")
    assert (pick(path).base_port, pick(path).name) == (19000, "attic/eye")


def test_a_port_that_is_taken_is_explained(runtime_folder):
    config = Config(bus=BusConfig(base_port=18200))
    assert occupant(config, "tracker") == "another program there"
    with noted(Pipeline(base_port=18200, workers=("tracker",))):
        assert occupant(config, "tracker") == "another program there", "this process itself does not count"
        text = '{"base_port": 18200, "site": "h", "camera": "c", "workers": ["tracker"], "file": "/h.yaml"}'
        (runtime_folder / f"{os.getppid()}.json").write_text(text)
        assert occupant(config, "tracker") == "the tracker of h/c there, which runs already (/h.yaml)"
        near = Config(bus=BusConfig(base_port=18201))
        assert occupant(near, "camera") == "the tracker of h/c there, which runs already (/h.yaml)"
        assert occupant(near, "tracker") == "another program there"
        played = text.replace("/h.yaml", "/h.mcap").replace('"tracker"', "")
        (runtime_folder / f"{os.getppid()}.json").write_text(played)
        assert occupant(config, "tracker") == "a recording there that is played (/h.mcap)"
        with_its_configuration = played.replace("/h.mcap", "/h.yaml")
        (runtime_folder / f"{os.getppid()}.json").write_text(with_its_configuration)
        assert occupant(config, "tracker") == "a recording there that is played (/h.yaml)"


def test_a_pipeline_that_is_being_prepared_is_reported_as_starting(tmp_path, monkeypatch, capsys, refused):
    path = tmp_path / "lab.yaml"
    path.write_text(f"site: lab\nbus: {{base_port: {HERE.base_port}}}\n")

    def prepare(config):
        assert main(["status"]) == 1
        raise InputError("the scene", found="something else to test")

    monkeypatch.setattr("huepose_services.runtime.prepare.prepare", prepare)
    assert f"lab/cam0 is being started or stopped, from {path}" in refused(["up", path])
    assert running() == []
    assert main(["status", "--config", str(path)]) == 1
    assert "no pipeline runs at port 18100" in capsys.readouterr().err


def test_a_pipeline_of_another_folder_is_named(tmp_path, monkeypatch, capsys):
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        (folder / "pipeline.yaml").write_text("{}")
    monkeypatch.chdir(here)
    arguments = argparse.Namespace(config=None, pipeline=None)
    with noted(Pipeline(base_port=18200, site="lab", camera="eye", file=str(there / "pipeline.yaml"))):
        assert chosen(arguments).base_port == 18200
        said = capsys.readouterr().err
        assert said == f"this is lab/eye, which runs from {there / 'pipeline.yaml'}\n"
        chosen(argparse.Namespace(config=None, pipeline="lab"))
        assert capsys.readouterr().err == "", "it was asked for by its name"
    with noted(Pipeline(base_port=18200, file=str(here / "pipeline.yaml"))):
        chosen(arguments)
        assert capsys.readouterr().err == ""


def test_status_names_a_pipeline_of_another_folder_once(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("huepose_services.cli.status._LEAST_S", 0.1)
    monkeypatch.setattr("huepose_services.cli.status._MOST_S", 0.1)
    file = str(tmp_path / "pipeline.yaml")
    with noted(Pipeline(base_port=18200, site="lab", camera="eye", workers=("camera",), file=file)):
        assert main(["status"]) == 1
        said = capsys.readouterr()
        assert (said.out + said.err).count("lab/eye") == 1
        assert (said.out + said.err).count(file) == 1
        assert main(["status", "--json"]) == 1
        said = capsys.readouterr()
        assert said.out.count(file) == 1
        assert said.err == ""


@pytest.mark.usefixtures("same_handlers")
def test_top_ends_at_ctrl_c_even_within_a_finaliser(monkeypatch):
    """Python cannot raise an exception from a finaliser: it would be lost."""

    class Finalised:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    looks = []

    def look(watch, seconds, stopping=lambda: False):
        looks.append(seconds)
        Finalised()

    monkeypatch.setattr("huepose_services.watch.Watch.look", look)
    with noted(Pipeline(base_port=18200, workers=("camera",))):
        assert main(["top", "--seconds", "2"]) == 0
    assert len(looks) == 1


@pytest.mark.parametrize(
    ("before", "said"), [("SIG_DFL", "True\n"), ("SIG_IGN", "False\n")], ids=["terminal", "nohup"]
)
def test_closing_the_terminal_ends_a_command_in_order_unless_it_runs_under_nohup(before, said):
    code = (
        f"import signal; signal.signal(signal.SIGHUP, signal.{before})\n"
        "from huepose_services.cli.options import catch_stop_signals\n"
        "told = catch_stop_signals(); signal.raise_signal(signal.SIGHUP); print(told())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
    assert (done.returncode, done.stdout) == (0, said)


@pytest.mark.parametrize("words", [["objects", "list"], ["graph"]])
def test_a_command_says_at_which_port_it_looks_for_a_pipeline(words, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("huepose_services.cli.objects._CONNECT_WITHIN_S", 0.1)
    monkeypatch.setattr("huepose_services.cli.graph._LOOK_S", 0.1)
    path = tmp_path / "lab.yaml"
    path.write_text("site: lab\nbus: {base_port: 18300}\n")
    assert main([*words, "--config", str(path)]) == 1
    first, second = capsys.readouterr().err.splitlines()
    assert first == "looking for a pipeline at port 18300 ..."
    assert "18300" in second
    assert "unixsock" not in second
    assert main(["graph", "--config", str(path), "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert (answer["pipeline"], answer["running"]) == ("lab/cam0", False)
    assert {worker["there"] for worker in answer["workers"]} == {False}


def test_a_box_with_a_negative_side_is_explained_by_its_size(refused):
    said = refused(["objects", "reset", "drill", "--box", "210", "120", "-90", "160"])
    assert "--box: found 210 120 -90 160; expected X Y W H (left, top, width, height)" in said
    assert "name of" not in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            "reset tea_box/0",
            "reset: found tea_box/0; expected a name of 1 to 64 characters of a-z, 0-9, _ and -. "
            "Name the object without /0: tea_box.",
        ),
        ("add Mug", "add: found Mug; expected a name of 1 to 64 characters of a-z, 0-9, _ and -."),
        ("add mug --max-instances 65", "--max-instances: found 65; expected 1 to 64."),
    ],
)
def test_an_invalid_request_is_refused_with_the_reason(words, said, refused):
    assert refused(["objects", *words.split()]) == f"huepose objects: {said}\n"


def test_a_recording_that_is_played_is_not_taken_for_a_starting_pipeline(tmp_path, monkeypatch, capsys):
    def waits_for_an_answer(*_):
        pytest.fail("a recording takes no requests")

    monkeypatch.setattr("huepose_services.cli.objects.ask", waits_for_an_answer)
    played = Pipeline(base_port=29347, site="lab", camera="cam0", file=str(tmp_path / "run1.mcap"))
    with noted(played):
        assert main(["objects", "list", "--pipeline", "lab/cam0"]) == 1
        said = capsys.readouterr().err
        assert f"lab/cam0 is a recording that is played, {tmp_path / 'run1.mcap'}" in said
        arguments = argparse.Namespace(config=None, pipeline="lab/cam0")
        assert chosen_config(arguments)[0].bus.base_port == 29347  # its file is not read as YAML
    assert "`huepose up` starts one" in Pipeline(base_port=29347).absence


def test_the_second_computer_of_a_pipeline_says_that_poses_and_objects_are_at_the_other_one(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(
        "huepose_services.cli.objects.ask", lambda *_: pytest.fail("there is no worker to answer")
    )
    config = Config(hosts={"desk": ("estimator",)}, link=LinkConfig(connect="robot:7448"))
    desk, robot = (described(config.at(host), tmp_path / "pipeline.yaml") for host in ("desk", None))
    assert robot.elsewhere == ""
    there = "here local/cam0 has perception only: ask the camera's computer for poses and objects"
    with noted(desk):
        assert main(["objects", "list"]) == 1
        assert f"huepose objects: {there}" in capsys.readouterr().err
    reader = SimpleNamespace(seen=True, live=set())
    assert _silence(reader, desk, desk.key("pose/**")).startswith(there)
    known = [ObjectEntry(object="mug", max_instances=1, searching=0)]
    view = View(desk, True, {}, frozenset(), (), known, {})
    assert as_text(view).splitlines()[-1].startswith(there)
    assert "mug" in as_text(dataclasses.replace(view, pipeline=robot))


@pytest.mark.parametrize(
    ("workers", "said"),
    [
        (("camera", "tracker"), "local/cam0 has no worker reinit, which keeps the list of objects"),
        (
            ("tracker", "reinit"),
            "the worker reinit of local/cam0 does not answer: it is starting or stopping, or has ended",
        ),
    ],
)
def test_if_nobody_answers_the_worker_that_should_is_named(tmp_path, monkeypatch, capsys, workers, said):
    monkeypatch.setattr("huepose_services.cli.objects.ask", lambda *_: None)
    with noted(described(Config(workers=workers), tmp_path / "pipeline.yaml")):
        assert main(["objects", "list"]) == 1
    assert f"huepose objects: {said}" in capsys.readouterr().err


@pytest.mark.parametrize("text", [None, "bus: {base_port: none}\n"])
def test_a_running_pipeline_is_recorded_even_if_its_file_is_wrong_now(tmp_path, text):
    path = tmp_path / "pipeline.yaml"
    config = Config(site="lab", bus=BusConfig(base_port=18100, frame_pool_mib=9.0))
    arguments = argparse.Namespace(config=None, pipeline=None)
    with noted(described(config, path)):
        if text is not None:
            path.write_text(text)
        found, valid = chosen_config(arguments)
        assert not valid
        assert (found.keys, found.bus) == (config.keys, config.bus)
        assert set(found.workers) > set(config.workers), "all workers that may publish are read"
    path.write_text("bus: {base_port: none}\n")
    with pytest.raises(InputError):  # no pipeline runs from it
        chosen_config(arguments)


def test_a_configuration_may_have_any_name(tmp_path):
    path = tmp_path / "lab.conf"
    path.write_text("site: lab\nbus: {base_port: 29447}\nobjects: [{name: cup}]\nbundles: bundles\n")
    config, _ = chosen_config(argparse.Namespace(config=path, pipeline=None))
    assert [item.name for item in config.objects] == ["cup"]
