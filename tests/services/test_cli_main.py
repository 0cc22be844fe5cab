"""What all commands have in common: help, suggestions, options, answers as JSON, Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
from argparse import ArgumentParser
from collections.abc import Iterator
from pathlib import Path

import pytest

from huepose_services.cli import entry
from huepose_services.cli import main as command_line
from huepose_services.cli.main import BAD_INPUT, main
from tests.services.conftest import Says


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [(["estmate"], "estimate"), (["objects", "lst"], "list"), (["demo", "--segmenter", "deptj"], "depth")],
)
def test_a_mistyped_word_gets_a_suggestion(arguments: list[str], meant: str, refused: Says) -> None:
    assert f"there is no '{arguments[-1]}': did you mean '{meant}'?" in refused(arguments)


def test_without_a_command_the_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == BAD_INPUT
    said = capsys.readouterr()
    assert said.err == ""
    assert "Live 6D object poses" in said.out
    assert "130 ended by Ctrl-C" in " ".join(said.out.split())


def _commands(parser: ArgumentParser) -> Iterator[ArgumentParser]:
    """The parsers of all commands and of their subcommands."""
    for action in parser._actions:
        if isinstance(action.choices, dict):
            for below in action.choices.values():
                yield below
                yield from _commands(below)


def test_every_command_says_what_it_does_and_what_its_arguments_are() -> None:
    commands = list(_commands(command_line.build_parser()))
    assert len(commands) > 30
    assert [one.prog for one in commands if not one.description] == []
    named = [(one.prog, action) for one in commands for action in one._actions if not action.choices]
    assert [(prog, action.dest) for prog, action in named if not action.help] == []


def test_a_mistyped_option_is_answered_by_its_command(refused: Says) -> None:
    error = refused(["poses", "--robbot"])
    assert error.startswith("usage: huepose poses")
    assert "there is no option '--robbot': did you mean '--robot'?" in error


def test_a_word_that_no_command_is_like_gets_no_suggestion(refused: Says) -> None:
    error = refused(["nonsense"])
    assert "did you mean" not in error
    assert "'onboard'" in error


def test_an_option_that_no_other_is_like_gets_no_suggestion(refused: Says) -> None:
    assert refused(["view", "--json"]).endswith("there is no option '--json'\n")


def test_a_recording_of_nothing_says_so_and_leaves_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("huepose_services.cli.record.catch_stop_signals", lambda: lambda: True)
    config = tmp_path / "pipeline.yaml"
    config.write_text("bus: {base_port: 29147}\nbundles: bundles\nobjects: [{name: cup}]\n")
    assert main(["record", str(tmp_path / "out.mcap"), "--config", str(config)]) == 1
    assert "nothing was recorded" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.mcap"))
    assert main(["record", str(tmp_path / "out.mcap"), "--config", str(config), "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert [answer["files"], answer["frames"], answer["bytes"]] == [[], 0, 0]


def test_a_view_of_nothing_says_so_and_leaves_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("huepose_services.models.load", lambda config: {})
    config = tmp_path / "pipeline.yaml"
    config.write_text("bus: {base_port: 29147}\nbundles: bundles\nobjects: [{name: cup}]\n")
    saved = tmp_path / "out.rrd"
    assert main(["view", "--save", str(saved), "--config", str(config), "--seconds", "0.2"]) == 1
    assert "no image arrived, so nothing was saved" in capsys.readouterr().err
    assert not saved.exists()


def test_a_view_that_was_saved_before_is_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = tmp_path / "out.rrd"
    saved.write_text("of before")
    assert main(["view", "--save", str(saved), "--seconds", "0.2"]) == BAD_INPUT
    assert "found a file of that name; expected a new one" in capsys.readouterr().err
    assert saved.read_text() == "of before"


@pytest.mark.parametrize("line", ["record out.mcap", "view --save out.rrd", "top"])
@pytest.mark.parametrize("seconds", ["-3", "0", "nan", "soon"])
def test_seconds_must_be_more_than_zero(line: str, seconds: str, refused: Says) -> None:
    assert f"found {seconds}, expected seconds, more than 0" in refused([*line.split(), "--seconds", seconds])


@pytest.mark.parametrize("given", ["-1", "0.5", "some"])
@pytest.mark.parametrize(
    "line",
    [
        "demo --seed",
        "bench --seed",
        "render-scenes --models builtin --out no_scene --seed",
        "render-scenes --models builtin --out no_scene --textures",
        "train rotation --out no_folder --seed",
        "train views --out no_folder --seed",
        "eval estimate --bop no_scene --bundles no_bundles --seed",
        "eval perception --bop no_scene --bundles no_bundles --seed",
        "eval track --bop no_scene --bundles no_bundles --seed",
        "eval tables --ycbv no_set --out no_folder --seed",
    ],
)
def test_a_seed_is_a_whole_number_that_is_not_negative(
    line: str, given: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*line.split(), given])
    assert ended.value.code == BAD_INPUT
    option = line.split()[-1]
    said = f"argument {option}: found {given}, expected a whole number, 0 or more\n"
    assert capsys.readouterr().err.endswith(said)


@pytest.mark.parametrize("option", ["--minutes", "--slow"])
@pytest.mark.parametrize("number", ["-3", "0", "nan"])
def test_numbers_for_chaos_must_be_more_than_zero(option: str, number: str, refused: Says) -> None:
    assert f"argument {option}: found {number}, expected more than 0\n" in refused(["chaos", option, number])


ONE = "estimate --color c --depth d --camera k --bundles b"


@pytest.mark.parametrize(
    ("line", "dest", "given"),
    [
        (ONE, "object", None),
        (f"{ONE} --object a --object b c", "object", list("abc")),
        ("demo", "object", []),
        ("demo --object a --object b", "object", ["a", "b"]),
        ("eval tables --out o", "every", [1, 5]),
        ("eval tables --out o --every 2 --every 3", "every", [2, 3]),
    ],
)
def test_an_option_that_takes_several_adds_up(line: str, dest: str, given: list[str] | None) -> None:
    assert getattr(command_line.build_parser().parse_args(line.split()), dest) == given


def test_a_shell_completes_commands_and_values(tmp_path: Path) -> None:
    def choices(line: str) -> set[str]:
        asked = {
            "_ARGCOMPLETE": "1",
            "_ARGCOMPLETE_STDOUT_FILENAME": str(tmp_path / "choices"),
            "_ARGCOMPLETE_IFS": "\n",
            "COMP_LINE": line,
            "COMP_POINT": str(len(line)),
        }
        command = [sys.executable, "-m", "huepose_services.cli.main"]
        subprocess.run(command, env={**os.environ, **asked}, check=True, timeout=60.0)
        return {word.strip() for word in (tmp_path / "choices").read_text().split("\n")}

    assert choices("huepose est") == {"estimate"}
    assert {"list", "add", "remove", "reset"} <= choices("huepose objects ")
    assert choices("huepose estimate --method co") == {"colorpair"}


# Commands that answer something, and do not run until they are stopped.
ANSWERS = [
    *("demo", "estimate --color C --depth D --camera J --bundles B", "onboard M --name N --out B", "bench"),
    *("status", "objects list", "objects add N", "objects remove N", "objects reset N", "poses", "doctor"),
    *(
        "validate",
        "models list",
        "replay F --verify",
        "calibrate hand-eye --object O --hand H --camera fixed",
    ),
]


@pytest.mark.parametrize("line", ANSWERS)
def test_every_answer_is_available_as_json(line: str) -> None:
    assert command_line.build_parser().parse_args([*line.split(), "--json"]).json is True


@pytest.mark.parametrize("option", ["--max-instances", "--instances"])
def test_the_number_of_instances_may_have_the_name_of_the_configuration(option: str) -> None:
    parsed = command_line.build_parser().parse_args(["objects", "add", "mug", option, "3"])
    assert parsed.instances == 3


def test_an_answer_as_json_is_all_that_is_printed(tmp_path: Path, printed: Says) -> None:
    path = tmp_path / "pipeline.yaml"
    path.write_text("site: here\ncamera: {source: synthetic}\n")
    answer = json.loads(printed(["validate", path, "--json"]))
    assert answer["keys"] == "huepose/here/cam0/..."
    assert list(answer["ports"]) == answer["workers"]
    assert answer["listens"] == {}


def test_validate_says_where_each_camera_is_reached(tmp_path: Path, printed: Says) -> None:
    path = tmp_path / "pipeline.yaml"
    path.write_text("workers: [camera, gateway, viewer]\ncameras: [{name: left}, {name: right}]\n")
    said = [line.split() for line in printed(["validate", path]).splitlines() if "listens" in line]
    assert [line[1:3] for line in said] == [["gateway.listen", f"127.0.0.1:{p},"] for p in (7447, 7448)]
    assert said[1][3:5] == ["viewer.web_port", "0.0.0.0:9091,"], "rerun serves its page at every address"


@pytest.mark.parametrize("line", [["validate"], ["status", "--json", "--config"]], ids=["text", "json"])
def test_a_path_in_another_encoding_is_printed_with_escapes(line: list[str], tmp_path: Path) -> None:
    path = tmp_path / "caf\udce9.yaml"
    path.write_text("bus: {base_port: 18200}")
    program = [sys.executable, "-m", "huepose_services.cli.main", *line, os.fsencode(path)]
    # As in a locale such as en_US.UTF-8; Python escapes by itself in C.UTF-8.
    strict = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    done = subprocess.run(program, env=strict, capture_output=True, text=True, timeout=120.0)
    assert (done.returncode, done.stderr) == (1 if "--json" in line else 0, "")
    assert "caf\\udce9.yaml" in done.stdout.replace("\\\\", "\\")


@pytest.mark.usefixtures("same_handlers")
def test_a_worker_of_a_camera_that_the_file_lacks_does_not_run_for_another(
    tmp_path: Path, refused: Says
) -> None:
    path = tmp_path / "pipeline.yaml"
    path.write_text("workers: [tracker]\ncameras: [{name: left}]\nbus: {base_port: 18200}")
    said = refused(["run", "right.any", path])
    assert "pipeline.yaml: camera right: found only the camera left; expected one of that name." in said


def test_ctrl_c_while_a_command_line_is_parsed_gives_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command_line, "build_parser", interrupted)
    assert main(["poses"]) == 130
    assert capsys.readouterr().err == "huepose: interrupted\n"


@pytest.mark.parametrize("compiled", [False, True])
def test_ctrl_c_while_a_module_is_imported_gives_no_traceback(
    compiled: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Interrupted:
        @staticmethod
        def find_spec(name: str, *_: object) -> None:
            if name == command_line.__name__:
                try:
                    signal.raise_signal(signal.SIGINT)
                except KeyboardInterrupt:
                    if not compiled:
                        raise
                raise ImportError("initialization failed")

    monkeypatch.delitem(sys.modules, command_line.__name__)
    monkeypatch.setattr(sys, "meta_path", [Interrupted, *sys.meta_path])
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # as when a program starts
    try:
        assert entry.main() == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "huepose: interrupted\n"


def test_ctrl_c_during_a_callback_of_compiled_code_also_ends_a_command() -> None:
    """Python cannot raise from a callback: it prints the error, and goes on."""
    program = f"""
import ctypes, signal, sys, time
from {entry.__name__} import main
from {command_line.__name__} import __name__ as name

signal.signal(signal.SIGINT, signal.default_int_handler)
called_back = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))

def command():
    called_back()
    for _ in range(1000):
        time.sleep(0.01)
    return 0

sys.modules[name].main = command
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60.0)
    assert (done.returncode, done.stderr) == (130, "huepose: interrupted\n")


def test_the_command_is_the_entry_that_catches_ctrl_c_in_imports() -> None:
    said = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert f'huepose = "{entry.__name__}:main"' in said


@pytest.mark.parametrize("closed", ["1>&-", "2>&-", "1>&- 2>&-"])
def test_a_command_works_if_who_started_it_closed_an_output(closed: str) -> None:
    start = "import sys; from huepose_services.cli.entry import main; sys.exit(main())"
    ran = subprocess.run(
        ["sh", "-c", f'"$0" "$@" {closed}', sys.executable, "-c", start, "models", "list"],
        check=False,
        capture_output=True,
        text=True,
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ("yolox-nano" in ran.stdout) == (closed == "2>&-")


def test_a_command_that_may_ask_works_without_an_input(tmp_path: Path) -> None:
    corners = ("0 0 0", "2 0 0", "0 2 0", "0 0 2")  # 2 mm, or 2 m
    text = "".join(f"v {corner} 255 0 0\n" for corner in corners) + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    (tmp_path / "m.obj").write_text(text)
    start = "import sys; from huepose_services.cli.entry import main; sys.exit(main())"
    command = [sys.executable, "-c", start, "onboard", str(tmp_path / "m.obj"), "--name", "m"]
    ran = subprocess.run(
        ["sh", "-c", '"$0" "$@" <&-', *command, "--out", str(tmp_path / "out")],
        check=False,
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 2
    assert "found no unit" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_progress_is_silent_if_the_error_output_is_closed() -> None:
    start = (
        "import sys; from huepose_services.cli import entry, main\n"
        "from huepose.support.progress import progress\n"
        "main.main = lambda: print(list(progress([1, 2], 'work')))\n"
        "sys.exit(entry.main())"
    )
    command = ["sh", "-c", '"$0" "$@" 2>&-', sys.executable, "-c", start]
    assert subprocess.run(command, check=False, capture_output=True, text=True).stdout == "[1, 2]\n"
