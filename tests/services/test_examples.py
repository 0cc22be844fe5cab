"""Every example runs as it is written: on the folder of `huepose new`, at a pipeline, at a ROS 2 router."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from huepose.model import ReferenceModel, save_model
from huepose.scenes.builtin import first_shot
from huepose.scenes.camera import CAMERA
from huepose_services.camera.python import open_source
from huepose_services.cli.new import write_frame
from huepose_services.runtime.config import BusConfig, Config
from huepose_services.runtime.config_file import load
from huepose_services.runtime.running import described, noted
from tests.services.example_programs import (
    EXAMPLE,
    ROOT,
    example,
    listed,
    published,
    tracked,
)

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.fixture(scope="module")
def folder(tea_box: ReferenceModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `huepose new tea_box examples/tea_box.obj` makes, without the mesh file."""
    out = tmp_path_factory.mktemp("new") / "tea_box"
    save_model(tea_box, out / "bundles" / "tea_box.huepose")
    write_frame(out, first_shot({"tea_box": tea_box.mesh}), CAMERA)
    return out


@pytest.fixture(scope="module")
def true_position(tea_box: ReferenceModel) -> np.ndarray:
    return first_shot({"tea_box": tea_box.mesh}).labels.T_cam_obj[0][:3, 3]


def answer(name: str, folder: Path) -> tuple[str, list[float]]:
    """State and position of the first pose that an example prints."""
    done = subprocess.run(example(name, folder), check=True, capture_output=True, text=True)
    words = done.stdout.splitlines()[0].split(maxsplit=3)
    assert words[0] == "tea_box"
    return words[1], [float(x) for x in re.findall(r"-?\d+\.\d*", words[3])]


@pytest.mark.parametrize("name", ["01_one_frame.py", "05_own_detector.py"])
def test_an_example_prints_the_pose_in_a_frame(name: str, folder: Path, true_position: np.ndarray) -> None:
    state, position = answer(name, folder)
    assert state == "TRACKING"
    assert np.allclose(position, true_position, atol=0.005)


@pytest.mark.parametrize("name", ["01_one_frame.py", "05_own_detector.py"])
def test_a_folder_without_a_frame_is_reported_in_one_line(name: str, tmp_path: Path) -> None:
    done = subprocess.run(example(name, tmp_path / "no"), capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"{tmp_path / 'no'}")
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 1


def test_the_camera_gives_frames(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRAME_FOLDER", str(folder))
    pipeline = tmp_path / "pipeline.yaml"
    camera = ROOT / "examples" / "04_own_camera.py"
    pipeline.write_text(f"camera: {{source: python, path: {camera}}}\nworkers: [camera]\nbundles: bundles\n")
    opened = open_source(load(pipeline)).open()
    one, two = opened.read(1.0), opened.read(1.0)
    assert one is not None
    assert two is not None
    assert one.color.shape == (CAMERA.height, CAMERA.width, 3)
    assert (one.color != two.color).any()
    assert one.device_ns < two.device_ns


@pytest.mark.live
def test_the_subscriber_prints_what_comes_and_why_nothing_comes(base_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{base_port}"
    with subprocess.Popen(
        example("02_live_subscriber.py", endpoint), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as reader:
        assert reader.stdout is not None
        assert reader.stderr is not None
        try:
            said = f"waiting for a gateway at {endpoint}: no program listens there\n"
            assert reader.stderr.readline() == said
            with published(endpoint, lambda number: tracked()):
                assert reader.stdout.readline().startswith(f"tea_box {EXAMPLE.instance} TRACKING")
        finally:
            reader.terminate()


@pytest.mark.live
def test_the_subscriber_ends_quietly_when_its_output_is_closed(base_port: int) -> None:
    """As `| head` does: it closes the pipe."""
    endpoint = f"tcp/127.0.0.1:{base_port}"
    with (
        published(endpoint, lambda number: tracked()),
        subprocess.Popen(
            example("02_live_subscriber.py", endpoint),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as reader,
    ):
        assert reader.stdout is not None
        assert reader.stderr is not None
        try:
            assert reader.stdout.readline()
            reader.stdout.close()
            assert reader.wait(15.0) == 0
            assert reader.stderr.read() == ""
        finally:
            reader.terminate()


def first_words(*commands: list[str]) -> list[str]:
    """The first line of each command's error output; all wait at the same time."""
    running = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for command in commands]
    try:
        return [one.stderr.readline() for one in running if one.stderr is not None]
    finally:
        for one in running:
            one.terminate()
            one.communicate()


@pytest.mark.live
def test_a_pipeline_that_is_being_started_is_distinguished_from_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    with noted(described(Config(), tmp_path / "pipeline.yaml")):
        lines = first_words(example("02_live_subscriber.py"), example("03_pick_when_still.py", "tea_box"))
    said = f"waiting for a pipeline: local/cam0, from {tmp_path / 'pipeline.yaml'}, is being started"
    assert [said in line for line in lines] == [True, True], lines


@pytest.mark.live
@pytest.mark.parametrize(
    "script", [["02_live_subscriber.py"], ["03_pick_when_still.py", "box"], ["06_ros2.py", "box", "tcp/a:1"]]
)
def test_a_wrong_address_and_a_choice_of_pipelines_are_one_sentence(
    script: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    ports = (17447, 17547)
    left, right = (described(Config(bus=BusConfig(base_port=n)), tmp_path / f"{n}.yaml") for n in ports)
    for also, said in ([], "found 2 pipelines that run here"), (["tcp/foo:bar"], "found 'tcp/foo:bar'"):
        with noted(left), noted(right):
            done = subprocess.run(example(*script, *also), capture_output=True, text=True, timeout=60.0)
        assert done.returncode == 1
        assert said in done.stderr
        assert done.stderr.count("\n") == 1, done.stderr


@pytest.mark.live
def test_a_name_that_is_not_searched_for_is_reported_with_those_that_are(base_port: int) -> None:
    inside, outside = (f"tcp/127.0.0.1:{base_port + k}" for k in (0, 1))
    with listed(inside, outside=False), listed(outside, outside=True):
        lines = first_words(*(example("03_pick_when_still.py", "crton", at) for at in (inside, outside)))
    assert lines == ["waiting: crton is not searched for; searched for: carton, tea_box\n"] * 2


def test_every_example_says_how_it_is_run_and_is_listed() -> None:
    listed = re.findall(r"examples/(\w+\.py)", (ROOT / "docs" / "quickstart.md").read_text())
    assert sorted(set(listed)) == [path.name for path in EXAMPLES]
    for path in EXAMPLES:
        assert f"examples/{path.name}" in (ast.get_docstring(ast.parse(path.read_text())) or "")
