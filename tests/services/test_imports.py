"""What workers, subscribers and the command line import, and what they must not import."""

from __future__ import annotations

import subprocess
import sys

import pytest

EVERY_WORKER = """
import sys
from importlib import import_module
from huepose_services.runtime.config import WORKERS
from huepose_services.runtime.worker import home_of
for worker in WORKERS:
    import_module(home_of(worker))
import huepose.onboarding.reference  # a worker learns the built-in objects where nobody did
from huepose import Estimator, Tracker, load_models
assert "huepose.tracking.tracker" in sys.modules
"""
SUBSCRIBER = "import huepose_protos.client, huepose_services.cli.poses, huepose_services.runtime.running"
HELP = "import huepose_services.cli.main as command_line\ncommand_line.build_parser().format_help()"


@pytest.mark.parametrize(
    ("imports", "must_not_import"),
    [
        (EVERY_WORKER, ("open3d", "dash", "trimesh", "torch", "PIL")),
        # Kernels take 45 MiB and over a second of CPU time at every start.
        ("import huepose_services.camera.ingest", ("numba", "scipy", "onnxruntime")),
        ("import huepose_services.reinit", ("numba", "scipy", "onnxruntime")),
        # A tenth of a second of CPU time at every start.
        ("import huepose_services.tracker", ("scipy.spatial", "scipy.optimize", "onnxruntime")),
        (SUBSCRIBER, ("cv2", "numba", "scipy", "open3d", "onnxruntime")),
        # The shell completes a word without a delay.
        (HELP, ("numpy", "zenoh", "cv2", "msgspec", "yaml", "numba", "open3d")),
    ],
    ids=["every worker", "camera", "reinit", "tracker", "subscriber", "help"],
)
def test_a_process_does_not_import_what_it_does_not_need(
    imports: str, must_not_import: tuple[str, ...]
) -> None:
    code = f"{imports}\nimport sys\nprint(*sorted({set(must_not_import)} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100.0)
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr
