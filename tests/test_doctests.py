"""The examples in docstrings are right."""

import doctest
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HOMES = {
    "huepose": ROOT,
    "huepose_protos": ROOT / "protos",
    "huepose_services": ROOT / "services",
    "benchmarks": ROOT,
    "studies": ROOT,
}
MODULES = sorted(
    ".".join(path.relative_to(home).with_suffix("").parts)
    for package, home in HOMES.items()
    for path in (home / package).rglob("*.py")
    if ">>> " in path.read_text()
)


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_hold(name: str) -> None:
    assert doctest.testmod(import_module(name)).failed == 0
