"""The scripts of deploy/ find system libraries and uv."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

DEPLOY = Path(__file__).parents[1] / "deploy"


def _bash(script: str, folder: Path, path: str) -> subprocess.CompletedProcess[str]:
    command = ["bash", "-c", f"set -euo pipefail\n{script}"]
    return subprocess.run(
        command, cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True, timeout=60
    )


def test_system_libraries_are_found_without_sbin_on_the_path(tmp_path: Path) -> None:
    """PATH of an ordinary user of Debian. The script installs nothing and names what is missing."""
    text = (DEPLOY / "setup.sh").read_text()
    (function,) = re.findall(r"^system_libraries\(\) \{.*?^\}", text, re.MULTILINE | re.DOTALL)
    stand_ins = 'id() { echo 1000; }\nfail() { echo "$*"; exit 0; }\nuname() { echo x86_64; }'
    done = _bash(f"{stand_ins}\n{function}\nsystem_libraries", tmp_path, "/usr/bin:/bin")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("script", ["audit.sh", "bundle.sh", "try_wheel.sh"])
def test_of_several_uv_the_version_in_uv_txt_is_used(tmp_path: Path, script: str) -> None:
    (found,) = re.findall(r"^UV=.*$", (DEPLOY / script).read_text(), re.MULTILINE)
    (tmp_path / "deploy").mkdir()
    (tmp_path / "deploy" / "uv.txt").write_text((DEPLOY / "uv.txt").read_text())
    version = re.findall(r"^uv==([\d.]+)", (DEPLOY / "uv.txt").read_text(), re.MULTILINE)[0]
    for one in ("0.0.1", version, "latest"):
        (tmp_path / ".tools" / f"uv-{one}" / "bin").mkdir(parents=True)
        uv = tmp_path / ".tools" / f"uv-{one}" / "bin" / "uv"
        uv.write_text(f"#!/bin/sh\necho {one}\n")
        uv.chmod(0o755)
    done = _bash(f'{found}\n"$UV"', tmp_path, os.environ["PATH"])
    assert done.stdout == f"{version}\n", done.stderr
