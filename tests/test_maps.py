"""The package docstrings of the large rooms name exactly the existing modules."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest


@pytest.mark.parametrize("room", ["evaluation", "onboarding", "scenes"])
def test_a_package_docstring_names_every_module(room: str) -> None:
    package = import_module(f"huepose.{room}")
    assert package.__doc__ is not None
    assert package.__file__ is not None
    folder = Path(package.__file__).parent
    there = {p.stem for p in folder.iterdir() if (p.suffix == ".py" or (p / "__init__.py").exists())}
    named = set(re.findall(r"[a-z]\w*", package.__doc__))
    assert there - {"__init__"} <= named
    assert {word for word in named if "_" in word} - {"read_mesh"} <= there
