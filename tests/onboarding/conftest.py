"""What several tests of meshes look at."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Mesh
from tests.onboarding import solids


@pytest.fixture(scope="module")
def printed_box() -> Mesh:
    """A box of 8 x 6 x 4 cm, all sides of noise: every texel is used."""
    rng = np.random.default_rng(3)
    pictures = {side: rng.integers(0, 256, (64, 64, 3)).astype(np.uint8) for side in solids.SIDES}
    return solids.box((0.08, 0.06, 0.04), pictures)
