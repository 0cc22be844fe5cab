"""What a worker with a real camera and reference models of its own has loaded."""

import subprocess
import sys

from huepose_services.runtime.worker import _HOMES

LABORATORY = ("huepose.evaluation", "huepose.scenes", "huepose.training", "studies")


def test_workers_load_neither_evaluation_nor_training_nor_the_built_in_scene():
    code = (
        f"import sys\nfrom importlib import import_module\nfor home in {list(_HOMES.values())}:\n"
        "    import_module(home)\n"
        f"print(*sorted(name for name in sys.modules if name.startswith({LABORATORY})))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
