"""What a command cannot write is refused before the work."""

import os
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import pytest

from huepose.support.errors import InputError
from huepose_services.cli import main as command_line
from huepose_services.cli.main import BAD_INPUT, main
from huepose_services.cli.options import print_result
from tests.disk import full_disk
from tests.services.conftest import Says


def test_an_image_that_cannot_be_encoded_is_refused_before_the_work(tmp_path: Path, refused: Says) -> None:
    lacking = [f"--{option}=no_{option}" for option in ("color", "depth", "camera", "bundles")]
    error = refused(["estimate", *lacking, "--image", tmp_path / "out.foo"])
    assert "out.foo: found an image that cannot be encoded" in error
    assert "no_" not in error


@pytest.mark.parametrize(
    "arguments",
    [
        ["onboard", "no_mesh.obj", "--name", "brick", "--out", "{file}/bundles"],
        ["render-scenes", "--models", "builtin", "--out", "{file}/scene"],
        ["eval", "estimate", "--bop", "no_scene", "--bundles", "no_bundles", "--json", "{file}/out.json"],
        ["bench", "bus", "--json", "{file}/deep/down/out.json"],
    ],
)
def test_results_that_cannot_be_written_are_refused_before_the_work(
    arguments: list[str], tmp_path: Path, refused: Says
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    error = refused([a.format(file=file) for a in arguments])
    assert f"{file} is no folder; expected a place that can be written" in error
    assert "no_" not in error


@pytest.mark.parametrize(
    ("option", "given", "said"),
    [
        ("--explain", "file", "found a file; expected a folder, which may be new"),
        ("--json", "folder", "found a folder; expected a file, which may be new"),
        ("--image", "folder", "found a folder; expected a file, which may be new"),
    ],
)
def test_a_file_for_a_folder_and_a_folder_for_a_file_are_refused_before_the_work(
    option: str, given: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    lacking = [f"--{name}=no_{name}" for name in ("color", "depth", "camera", "bundles")]
    assert main(["estimate", *lacking, option, str(tmp_path / given)]) == BAD_INPUT
    assert capsys.readouterr().err == f"huepose estimate: {option} {tmp_path / given}: {said}.\n"


@pytest.mark.parametrize(
    "arguments",
    [
        ["view", "--save", "/proc/out.rrd"],
        ["new", "brick", "no_mesh.obj", "--out", "/proc/brick"],
        ["onboard", "no_mesh.obj", "--name", "brick", "--out", "/proc"],
        ["new", "brick", "no_mesh.obj"],
        ["record", "r.mcap"],
        ["bench", "estimate", "--image", "/proc/stages.png"],
    ],
)
def test_a_folder_that_cannot_be_written_is_refused_before_the_work(
    arguments: list[str], refused: Says, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir("/proc")
    error = refused(arguments)
    assert "--" not in error, "no option that was not given"
    assert "/proc cannot be written; expected a place that can be written" in error
    assert "no_" not in error


@pytest.mark.parametrize(
    "line",
    [
        "estimate --color no_ --depth no_ --camera no_ --bundles no_ --image {folder}/out.png",
        "view --save {folder}/out.rrd",
    ],
)
def test_the_folder_of_an_image_and_of_a_recording_must_exist(
    line: str, tmp_path: Path, refused: Says
) -> None:
    folder = tmp_path / "mistyped"
    error = refused(line.format(folder=folder).split())
    assert f"no folder {folder}; expected a place that can be written" in error
    assert not folder.exists()


@pytest.mark.parametrize(("number", "named"), [(28, True), (11, False)])  # a full disk; a lack of processes
def test_errors_of_the_disk_are_input_errors_and_others_are_raised(
    number: int, named: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def work(parsed: object) -> int:
        raise OSError(number, "the reason", "out.json")

    monkeypatch.setattr("huepose_services.cli.validate.call", work)
    if named:
        assert command_line.main(["validate"]) == BAD_INPUT
        assert capsys.readouterr().err == "huepose validate: out.json: found the reason.\n"
    else:
        with pytest.raises(OSError, match="the reason"):
            command_line.main(["validate"])


def test_an_answer_is_printed_before_a_full_disk_refuses_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "out.json"
    with full_disk(), pytest.raises(InputError, match=f"{path}: found File too large"):
        print_result(Namespace(json=path), {"found": 1}, "found it")
    assert capsys.readouterr().out == "found it\n"
    assert not path.exists()


def test_output_that_cannot_be_written_is_reported_once() -> None:
    command = [sys.executable, "-m", "huepose_services.cli.main", "models", "list"]
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    with open("/dev/full", "w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, env=environment)
    assert ended.returncode == BAD_INPUT
    assert ended.stderr == "huepose models: its output: found No space left on device.\n"
