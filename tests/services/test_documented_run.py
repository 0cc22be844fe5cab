"""The commands of the README, the quick start and the section about a folder of images do what the pages say:
each block, in the order of its page, as it is written, in a fresh bash with the environment activated."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose_services.cli.main import build_parser

ROOT = Path(__file__).parents[2]
ACTIVATE = ROOT / ".venv" / "bin" / "activate"
PAGES = ("README.md", "docs/quickstart.md")

LEFT_OUT = {
    "make ": "sets up, and runs what is run here, or all tests",
    "pip install ": "asks the package index for 2.5 GB; `make dist` installs the wheel",
    "huepose onboard-bop path/to/bop/models": "a data set that is not here; test_cli_onboard has one",
    "huepose onboard --from-video turned.mcap": "a recording that is not here; test_from_video has one",
    "ros2 run ": "needs ROS 2",
    "source .venv/bin/activate": "is said before each command here",
}
"""Commands that are not run, by their beginning, and why."""

UNTIL_CTRL_C = {
    "huepose demo": r"tea_box\S* +.*TRACKING",
    "huepose up": r"tea_box/0 .*TRACKING",
    "huepose poses": r"tea_box.*TRACKING",
    "huepose view": r"the page is http",
    "huepose top": r"tracker +ready",
    "huepose record": r"run1\.mcap",
}
"""Commands that run until Ctrl-C, by their beginning, and what they must print before that."""

SAYS = {
    "huepose new": r"tea_box suits",
    "huepose onboard": r"tea_box suits",
    "huepose estimate": r"tea_box +TRACKING",
    "python write_scene_camera.py": "",
    "huepose validate": r"tracker 17448",
    "huepose objects reset": r"tea_box is searched for again",
    "huepose status": r"tracker +ready",
}
"""What the other commands must have printed at their end, by their beginning."""

ONBOARD = "huepose onboard examples"
"""The command whose reference model `huepose new` has made as well: it is run in a test of its own."""

_PIPELINES = ("huepose demo", "huepose up")
_TIMEOUT_S = 180.0


def commands(page: str, section: str = "") -> list[str]:
    """The lines of a page's blocks for a shell, with the comments behind them; section: of this section
    only."""
    blocks = re.findall(r"^```bash\n(.*?)^```", text_of(page, section), re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in re.sub(r"\\\n\s*", " ", block).splitlines() if line.strip()]


def lines_of_pages() -> list[str]:
    """The lines of PAGES, in their order."""
    return [line for page in PAGES for line in commands(page)]


def onboarding() -> list[str]:
    """Those that begin with ONBOARD, each once."""
    return list(dict.fromkeys(line for line in lines_of_pages() if line.startswith(ONBOARD)))


def text_of(page: str, section: str = "") -> str:
    """A page, or the part of it under a heading."""
    text = (ROOT / page).read_text()
    return text if not section else text.split(f"\n## {section}\n")[1].split("\n## ")[0]


def begins(line: str, beginnings: dict[str, str] | tuple[str, ...]) -> str | None:
    """The beginning that a line has."""
    return next((start for start in beginnings if line.startswith(start)), None)


def meant(line: str) -> str:
    """The command of a line, with its defaults: `huepose up` is `huepose up pipeline.yaml`."""
    words = shlex.split(line, comments=True)
    return str(build_parser().parse_args(words[1:])) if words[0] == "huepose" else line


@dataclass
class Terminal:
    """One command in a bash of its own, in a folder; its output goes to a file."""

    line: str
    folder: Path
    said: Path
    environment: dict[str, str]
    process: subprocess.Popen[bytes] = field(init=False)

    def __post_init__(self) -> None:
        with self.said.open("wb") as out:
            self.process = subprocess.Popen(
                ["bash", "--noprofile", "--norc", "-c", f"source '{ACTIVATE}'\n{self.line}"],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def text(self) -> str:
        return self.said.read_text(errors="replace")

    def wait_for(self, pattern: str) -> None:
        """Waits for this output. Fails if the command ends before, or takes too long."""
        end = time.monotonic() + _TIMEOUT_S
        while not re.search(pattern, self.text):
            assert self.process.poll() is None, f"{self.line} ended\n{self.text}"
            assert time.monotonic() < end, f"{self.line} did not say {pattern}\n{self.text}"
            time.sleep(0.2)

    def ctrl_c(self) -> None:
        """Sends Ctrl-C as a terminal does: to the program and all that it started. It must end without
        error."""
        os.killpg(self.process.pid, signal.SIGINT)
        # A demo that is interrupted has no result, and says so.
        self.ends(130 if self.line.startswith("huepose demo") else 0)

    def ends(self, expected: int = 0) -> None:
        """Waits until it ends by itself, with this exit code."""
        try:
            code = self.process.wait(_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{self.line} does not end\n{self.text}")
        assert code == expected, f"{self.line}: exit code {code}\n{self.text}"
        assert "Traceback" not in self.text, self.text

    def kill(self) -> None:
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


class Reader:
    """Somebody who follows a page: one terminal for the pipeline, others for the rest."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self.folder, self._environment = folder, environment
        self._terminals: list[Terminal] = []
        self._pipeline: Terminal | None = None

    def follow(self, line: str) -> None:
        """Runs a line, and checks what it does."""
        if moved := re.match(r"cd (\S+)", line):
            self.folder = self.folder / moved[1]
            assert self.folder.is_dir()
            return
        going_on = begins(line, UNTIL_CTRL_C)
        if going_on in _PIPELINES or line.startswith(("huepose new", "huepose onboard")):
            self.end_pipeline()
        said = self.folder / f"said_{len(self._terminals)}.txt"
        terminal = Terminal(line, self.folder, said, self._environment)
        self._terminals.append(terminal)
        if going_on is None:
            terminal.ends()
            assert re.search(SAYS[begins(line, SAYS) or line], terminal.text), terminal.text
            return
        terminal.wait_for(UNTIL_CTRL_C[going_on])
        if going_on in _PIPELINES:
            self._pipeline = terminal
        else:
            terminal.ctrl_c()

    def end_pipeline(self) -> None:
        """Sends Ctrl-C to the pipeline, if one runs."""
        if self._pipeline is not None:
            self._pipeline.ctrl_c()
        self._pipeline = None

    def kill(self) -> None:
        """Kills all that still runs."""
        for terminal in self._terminals:
            terminal.kill()


@contextmanager
def reader(folder: Path) -> Iterator[Reader]:
    """A reader with a folder of their own for sockets, and this machine's caches."""
    kept = ("HOME", "XDG_CACHE_HOME", "PYTHONPATH", "LANG", "NUMBA_CACHE_DIR")
    environment = {name: os.environ[name] for name in kept if name in os.environ}
    environment |= {"PATH": "/usr/local/bin:/usr/bin:/bin", "HUEPOSE_RUN": str(folder / "run")}
    someone = Reader(folder, environment)
    try:
        yield someone
        someone.end_pipeline()
    finally:
        someone.kill()


def prepare(folder: Path) -> None:
    """Writes the reader's own files in the pages: a mesh and a pipeline.yaml."""
    shutil.copytree(ROOT / "examples", folder / "examples")
    lines = "bundles: bundles\nobjects: [{name: tea_box}]\ncamera: {source: synthetic, truth: true}\n"
    (folder / "pipeline.yaml").write_text(lines)


def test_lines_that_are_left_out_exist_and_all_others_are_commands_of_huepose():
    lines = lines_of_pages()
    assert not [start for start in LEFT_OUT if not any(line.startswith(start) for line in lines)]
    run = [line for line in lines if begins(line, LEFT_OUT) is None]
    assert len(run) > 15
    assert all(line.startswith(("huepose ", "cd ")) for line in run)


@pytest.mark.live
@pytest.mark.pipeline
@pytest.mark.timeout(900)
@pytest.mark.skipif(not ACTIVATE.exists(), reason="there is no .venv: make setup")
def test_the_commands_do_what_the_pages_say(tmp_path: Path) -> None:
    """First the README, then the quick start; the same command in both is run once."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if probe.connect_ex(("127.0.0.1", 9090)) == 0:
            pytest.skip("the page's port, 9090, is taken")
    prepare(tmp_path)
    (tmp_path / "bundles").symlink_to("tea_box/bundles")  # in place of what ONBOARD makes
    with reader(tmp_path) as someone:
        done = {meant(line) for line in onboarding()}
        for line in lines_of_pages():
            if begins(line, LEFT_OUT) is None and meant(line) not in done:
                someone.follow(line)
                done.add(meant(line))
    assert (tmp_path / "out.png").stat().st_size > 10_000


@pytest.mark.live
@pytest.mark.timeout(300)
@pytest.mark.skipif(not ACTIVATE.exists(), reason="there is no .venv: make setup")
def test_a_mesh_is_onboarded_as_the_page_says(tmp_path: Path) -> None:
    prepare(tmp_path)
    with reader(tmp_path) as someone:
        for line in onboarding():
            someone.follow(line)
    assert (tmp_path / "bundles" / "tea_box.huepose").exists()


FOLDER = ("docs/cameras.md", "A folder of images")


@pytest.mark.live
@pytest.mark.timeout(300)
@pytest.mark.skipif(not ACTIVATE.exists(), reason="there is no .venv: make setup")
def test_a_folder_of_images_is_played_as_the_page_says(tmp_path: Path, recording) -> None:
    """The page's files are written as they are; the images are rendered ones."""
    shutil.copytree(recording[0] / "bundles", tmp_path / "bundles")
    shutil.copytree(recording[0] / "scene" / "rgb", tmp_path / "desk" / "rgb")
    (tmp_path / "desk" / "depth").mkdir()
    for path in (recording[0] / "scene" / "depth").iterdir():
        tenths_mm = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        millimetres = np.rint(tenths_mm / 10.0).astype(np.uint16)
        assert cv2.imwrite(str(tmp_path / "desk" / "depth" / path.name), millimetres)
    files = re.findall(r"^```(?:python|yaml)\n# (\S+)\n(.*?)^```", text_of(*FOLDER), re.MULTILINE | re.DOTALL)
    assert [name for name, _ in files] == ["write_scene_camera.py", "desk.yaml"]
    for name, text in files:
        (tmp_path / name).write_text(text)
    with reader(tmp_path) as someone:
        for line in commands(*FOLDER):
            someone.follow(line)
