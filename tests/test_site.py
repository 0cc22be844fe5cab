"""The documentation as a site: all links work, and the reference of pipeline.yaml has every key."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from msgspec import structs

from huepose_services.runtime.config import Config, ViewerConfig

ROOT = Path(__file__).parents[1]


def test_the_site_is_built_without_a_warning_and_explains_every_key(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(
        command,
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "configuration" / "index.html").read_text()
    keys = [field.name for kind in (Config, ViewerConfig) for field in structs.fields(kind)]
    assert not [key for key in keys if f"<code>{key}</code>" not in page]
    row = re.search(r"<td><code>image_rate_hz</code></td>(.*?)</tr>", page, re.DOTALL)[1]
    assert re.findall(r"<td>(.*?)</td>", row) == [
        "number &gt; 0 ≤ 30",
        "<code>10.0</code>",
        "images a second; all poses are shown",
    ]
    assert "demo.webp" in (tmp_path / "index.html").read_text()


@pytest.mark.parametrize("script", sorted((ROOT / "docs").glob("make_*.py")), ids=lambda path: path.name)
def test_the_scripts_that_make_the_pages_images_find_what_they_import(script):
    if script.name == "make_graph.py" and sys.version_info < (3, 11):
        pytest.skip("import-linter, which brings grimp, needs Python 3.11")
    spec = importlib.util.spec_from_file_location(script.stem, script)
    spec.loader.exec_module(importlib.util.module_from_spec(spec))
