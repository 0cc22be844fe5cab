"""What the setup of HuePose does."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

_CODE = """
import gc
from numba.core.dispatcher import Dispatcher
from huepose.support.jit import KERNELS, name_of
from huepose_services.first_time import main
from tests.onboarded import few_views

with few_views():  # the same kernels
    main()
ours = [k for k in gc.get_objects() if isinstance(k, Dispatcher) and name_of(k.py_func) in KERNELS]
assert len(ours) > 100, len(ours)
# A kernel from the cache brings those that it calls along.
ready = [kernel for kernel in ours if kernel.signatures]
for kernel in ready:
    function = kernel.py_func
    inner = [cell.cell_contents for cell in function.__closure__ or ()]
    called = [*(function.__globals__.get(name) for name in function.__code__.co_names), *inner]
    ready += [k for k in called if isinstance(k, Dispatcher) and k not in ready]
print("not compiled:", sorted(KERNELS - {name_of(kernel.py_func) for kernel in ready}))
"""


def test_the_setup_compiles_all_kernels():
    done = subprocess.run([sys.executable, "-c", _CODE], capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    *steps, compiled = done.stdout.strip().splitlines()
    assert [step.split(":")[1].strip() for step in steps] == [
        "the built-in objects",
        "the numeric kernels",
        "the built-in scene",
    ]
    assert compiled == "not compiled: []"


@pytest.mark.parametrize("during", ["", "onboarding the built-in objects", "kernels compiled"])
def test_ctrl_c_ends_the_setup_at_any_time_in_one_line(tmp_path: Path, during: str) -> None:
    """At once, while an object is onboarded, and within the compiler. Caches are empty, except that for the
    last case the objects are there, so that their onboarding need not be compiled first."""
    kept = {"NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    if during != "kernels compiled":
        kept["XDG_CACHE_HOME"] = str(tmp_path / "cache")
    command = [sys.executable, "-u", "-m", "huepose_services.first_time"]
    with (tmp_path / "said").open("w") as said:
        setup = subprocess.Popen(command, env=os.environ | kept, stdout=said, stderr=said)
    text, deadline = "", time.monotonic() + 240.0
    try:
        while during not in text and setup.poll() is None and time.monotonic() < deadline:
            time.sleep(0.2)
            text = (tmp_path / "said").read_text()
        time.sleep(1.0)
        setup.send_signal(signal.SIGINT)
        assert setup.wait(20.0) == 130
    finally:
        setup.kill()
        setup.wait()
    lines = (tmp_path / "said").read_text()[len(text) :].splitlines()
    assert lines[-1] == "setup: interrupted; `make setup` goes on here"
    assert all(" kernels compiled, " in line or line.startswith("onboarding ") for line in lines[:-1])
