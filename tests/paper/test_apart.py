"""The method `full` and the tracker load nothing of the package `paper`; its methods load it when chosen."""

from __future__ import annotations

import subprocess
import sys
from functools import cache

import pytest

LIVE = """
import huepose, huepose.estimation, huepose.tracking, huepose.reinit
from huepose_services import detector, estimator, reinit, segmenter, tracker
"""
METHOD = """
from huepose.estimation import Estimator, EstimatorConfig
Estimator({{}}, EstimatorConfig(method={method!r})).warm_up()
"""
LOADED = """
import sys
print(*sorted(name for name in sys.modules if name.split(".")[:2] == ["huepose", "paper"]))
"""


@cache
def loaded(code: str) -> set[str]:
    """Modules of the package `paper` that a new process has loaded after running the code."""
    done = subprocess.run(
        [sys.executable, "-c", code + LOADED], capture_output=True, text=True, check=True, timeout=110
    )
    return set(done.stdout.split())


def test_live_workers_load_nothing_of_the_papers_method() -> None:
    assert loaded(LIVE + METHOD.format(method="full")) == set()


@pytest.mark.parametrize(
    ("method", "module"),
    [("paper", "huepose.paper.single_frame"), ("colorpair", "huepose.paper.extended.colorpair")],
)
def test_a_method_is_loaded_when_it_is_chosen(method: str, module: str) -> None:
    assert module in loaded(METHOD.format(method=method))


def test_the_papers_method_does_not_load_its_extension() -> None:
    assert not any(".extended" in name for name in loaded(METHOD.format(method="paper")))
