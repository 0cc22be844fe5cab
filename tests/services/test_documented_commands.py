"""Every command in a block of the documentation is accepted by the program, and every named script exists."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from huepose_services.cli.main import build_parser

ROOT = Path(__file__).parents[2]
PAGES = [
    *ROOT.glob("*.md"),
    *ROOT.glob("docs/*.md"),
    *ROOT.glob("protos/*.md"),
    *ROOT.glob("benchmarks/*.md"),
    *ROOT.glob("studies/*.md"),
]
# Placeholders for a number, or for a choice of two.
PLACEHOLDERS = {"N": "1", "S": "1", "X": "1", "Y": "1", "W": "1", "H": "1", "F": "0.5", "DIR|builtin": "DIR"}


def documented() -> list[str]:
    """The commands of all blocks: without prompts, paths to the program, comments and redirections."""
    found = []
    for page in PAGES:
        blocks = re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
        for block in (text for language, text in blocks if language in ("", "bash", "console")):
            for line in re.sub(r"\\\n\s*", " ", block).splitlines():
                match = re.match(r"(?:\$ )?(?:sudo )?(?:\S*/bin/)?huepose ([a-z].*)", line)
                if match:
                    found.append(re.split(r"\s#|\s[|>&]", match[1])[0].strip())
    return sorted(set(found))


def test_the_pages_show_commands():
    assert len(documented()) > 30


@pytest.mark.parametrize("line", documented())
def test_a_documented_command_is_accepted(line):
    words = [PLACEHOLDERS.get(word, word) for word in shlex.split(re.sub(r"[\[\]]|\.\.\.", "", line))]
    parsed = build_parser().parse_args(words)
    assert parsed.verb == words[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_page_installs_huepose_from_a_package_index(page):
    """It is not there: anyone could publish anything under its name."""
    assert not re.findall(r"pip install [^`\n]*'?huepose[\[\s`']", page.read_text())


def test_every_named_script_exists():
    text = "\n".join(page.read_text() for page in PAGES)
    modules = set(re.findall(r"(?<=-m )(?:studies|benchmarks)\.\w+", text))
    files = set(re.findall(r"\b(?:studies|benchmarks)/\w+\.(?:py|sh)", text))
    assert len(modules) > 8
    homes = [ROOT / module.replace(".", "/") for module in modules]
    absent = [str(h) for h in homes if not (h / "__main__.py").exists() and not h.with_suffix(".py").exists()]
    assert not absent + [name for name in files if not (ROOT / name).exists()]


def test_every_study_is_listed():
    homes = ROOT / "studies"
    studies = {path.parent.name for path in homes.glob("*/__main__.py")}
    studies |= {path.stem for path in homes.glob("*.py") if 'if __name__ == "__main__"' in path.read_text()}
    assert studies == set(re.findall(r"-m studies\.(\w+)", (homes / "README.md").read_text()))
