"""What every verb has in common: a place that cannot be written is found before the work."""

from pathlib import Path

import pytest

from huepose_services.cli import main as command_line
from huepose_services.cli.main import BAD_INPUT, main


@pytest.mark.parametrize(
    "arguments",
    [
        ["onboard", "no_mesh.obj", "--name", "brick", "--out", "{file}/bundles"],
        ["render-scenes", "--models", "builtin", "--out", "{file}/scene"],
        ["eval", "estimate", "--bop", "no_scene", "--bundles", "no_bundles", "--json", "{file}/out.json"],
        ["bench", "bus", "--json", "{file}/deep/down/out.json"],
    ],
)
def test_results_that_cannot_be_written_end_it_before_the_work(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    assert main([a.format(file=file) for a in arguments]) == BAD_INPUT
    error = capsys.readouterr().err
    assert f"{file} is no folder; expected a place that can be written" in error
    assert "no_" not in error


@pytest.mark.parametrize(("number", "told"), [(28, True), (11, False)])  # a full disk; a lack of processes
def test_what_the_disk_says_is_told_and_anything_else_is_our_mistake(
    number: int, told: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def work(parsed: object) -> int:
        raise OSError(number, "the reason", "out.json")

    monkeypatch.setattr("huepose_services.cli.validate.call", work)
    if told:
        assert command_line.main(["validate"]) == BAD_INPUT
        assert capsys.readouterr().err == "huepose validate: out.json: found the reason.\n"
    else:
        with pytest.raises(OSError, match="the reason"):
            command_line.main(["validate"])


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [(["estmate"], "estimate"), (["objects", "lst"], "list"), (["demo", "--segmenter", "deptj"], "depth")],
)
def test_a_mistyped_word_is_answered_with_the_one_that_may_be_meant(
    arguments: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(arguments)
    assert f"there is no '{arguments[-1]}': did you mean '{meant}'?" in capsys.readouterr().err
