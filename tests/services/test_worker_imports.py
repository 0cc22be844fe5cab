"""What a worker imports, and what it does without."""

from __future__ import annotations

import subprocess
import sys

IMPORT_ALL = """
import sys
from importlib import import_module
from huepose_services.runtime.config import WORKERS
from huepose_services.runtime.worker import home_of
for worker in WORKERS:
    import_module(home_of(worker))
import huepose.onboarding.reference  # a worker learns the built-in objects where nobody did
from huepose import Estimator, Tracker, load_models
assert "huepose.tracking.tracker" in sys.modules
print(*sorted({name.split(".")[0] for name in sys.modules} & {"open3d", "dash", "trimesh", "torch", "PIL"}))
"""


def test_workers_do_without_what_only_onboarding_and_training_need() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, timeout=100.0)
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


WITHOUT_KERNELS = """
import sys
from importlib import import_module
from huepose_services.runtime.worker import home_of
for worker in ("camera", "reinit"):
    import_module(home_of(worker))
print(*sorted({name.split(".")[0] for name in sys.modules} & {"numba", "scipy", "onnxruntime"}))
"""


def test_camera_and_reinitialisation_load_no_kernels() -> None:
    """Kernels take 45 MiB and over a second of CPU time at every start."""
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_KERNELS], capture_output=True, text=True, timeout=100.0
    )
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


TRACKER = """
import sys
import huepose_services.tracker
print(*sorted({"scipy.spatial", "scipy.optimize", "onnxruntime"} & set(sys.modules)))
"""


def test_the_tracker_imports_none_of_what_only_perception_needs() -> None:
    """A tenth of a second of CPU time at every start."""
    done = subprocess.run([sys.executable, "-c", TRACKER], capture_output=True, text=True, timeout=100.0)
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr
