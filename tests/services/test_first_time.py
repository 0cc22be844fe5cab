"""What is done when HuePose is set up."""

import subprocess
import sys

_CODE = """
import gc
from numba.core.dispatcher import Dispatcher
from huepose.support.jit import KERNELS, name_of
from huepose_services.first_time import main

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


def test_no_kernel_of_what_is_set_up_is_left_for_later():
    done = subprocess.run([sys.executable, "-c", _CODE], capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    *steps, compiled = done.stdout.strip().splitlines()
    assert [step.split(":")[1].strip() for step in steps] == [
        "the built-in objects",
        "the numeric kernels",
        "the built-in scene",
    ]
    assert compiled == "not compiled: []"
