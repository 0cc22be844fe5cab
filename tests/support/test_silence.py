"""No loaded library sends data about this computer to its maker."""

import os
import subprocess
import sys

import pytest

ONNX_RUNTIME = """
import huepose
import numpy as np
from huepose.propose.view_codes import _codes
_codes(np.zeros((1, 64, 64, 3), np.uint8), np.zeros((1, 64, 64), np.float32), clean=True)
"""
DEPTHAI = """
import huepose_services.doctor.checks as checks
list(checks.cameras([]))
"""


@pytest.mark.parametrize("program", [ONNX_RUNTIME, DEPTHAI], ids=["onnxruntime", "depthai"])
def test_no_library_stores_data_to_send(program: str, tmp_path) -> None:
    """Either library first stores what it would send as a file in the user's cache."""
    if program is DEPTHAI:
        pytest.importorskip("depthai", reason="depthai is not installed")
    # Not the whole environment: if it says CI, ONNX Runtime sends nothing anyway.
    kept = {name: os.environ[name] for name in ("PATH", "PYTHONPATH") if name in os.environ}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=kept
        | {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / ".cache"), "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        timeout=100.0,
    )
    assert done.returncode == 0, done.stderr
    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert not [path for path in written if {"Microsoft", "depthai"} & set(path.parts)]
