"""A textured box for the mesh tests."""

from __future__ import annotations

import pytest

from huepose.geometry import Mesh
from tests.onboarding import solids


@pytest.fixture(scope="module")
def printed_box() -> Mesh:
    return solids.printed_box((0.08, 0.06, 0.04), seed=3)
