"""Every locked package has a wheel for every supported computer: nothing is compiled there."""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.tags import Tag, compatible_tags, cpython_tags
from packaging.utils import canonicalize_name, parse_wheel_filename

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # with pytest

ROOT = Path(__file__).parents[1]
GLIBC = 35
"""Minor version of glibc in Ubuntu 22.04 and JetPack 6, the oldest supported systems."""
EXTRAS = ("edge", "viewer", "realsense", "oak", "onboard", "ros2", "secure")


@cache
def _wheels() -> dict[tuple[str, str | None], list[dict[str, Any]]]:
    """The wheels of each locked package, by name and version."""
    lock = tomllib.loads((ROOT / "uv.lock").read_text())
    return {(p["name"], p.get("version")): p.get("wheels", []) for p in lock["package"]}


@cache
def _exported(extras: tuple[str, ...]) -> list[Requirement]:
    """The locked requirements of these extras, with their markers."""
    uv = sorted(ROOT.glob(".tools/uv-*/bin/uv"))
    if not uv:
        pytest.skip("no uv in .tools: make setup")
    flags = [flag for extra in extras for flag in ("--extra", extra)]
    command = [uv[-1], "export", "--frozen", "--offline", "--no-dev", "--no-emit-project", "--no-hashes"]
    done = subprocess.run([*command, *flags], cwd=ROOT, capture_output=True, text=True, check=True)
    lines = (line.split("#")[0].strip() for line in done.stdout.splitlines())
    return [Requirement(line) for line in lines if line]


def _tags(python: tuple[int, int], machine: str) -> set[Tag]:
    """Tags of wheels that run on such a computer."""
    legacy = ["2014"] if machine == "aarch64" else ["2014", "2010", "1"]
    names = [f"_2_{minor}" for minor in range(GLIBC, 4, -1)] + legacy
    platforms = [f"manylinux{name}_{machine}" for name in names] + [f"linux_{machine}"]
    interpreter = f"cp{python[0]}{python[1]}"
    return {*cpython_tags(python, platforms=platforms), *compatible_tags(python, interpreter, platforms)}


@pytest.mark.parametrize("extras", [EXTRAS, ("edge-gpu",)], ids=["edge", "edge-gpu"])
@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
@pytest.mark.parametrize("python", [(3, 10), (3, 11), (3, 12)], ids=["3.10", "3.11", "3.12"])
def test_each_locked_package_has_a_wheel(python, machine, extras):
    version = ".".join(map(str, python))
    there = {"python_version": version, "python_full_version": f"{version}.0", "platform_machine": machine}
    there |= {"sys_platform": "linux", "platform_system": "Linux", "implementation_name": "cpython"}
    wanted = [r for r in _exported(extras) if r.marker is None or r.marker.evaluate(there)]
    assert {"numpy", "eclipse-zenoh"} <= {r.name for r in wanted}
    takes = _tags(python, machine)
    missing = []
    for requirement in wanted:
        (pinned,) = requirement.specifier
        urls = (w["url"] for w in _wheels()[canonicalize_name(requirement.name), pinned.version])
        if not any(parse_wheel_filename(url.rsplit("/", 1)[1])[3] & takes for url in urls):
            missing.append(str(requirement))
    assert missing == []
