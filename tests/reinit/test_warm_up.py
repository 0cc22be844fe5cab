"""No module is loaded while an answer waits: on a busy computer loading is so slow that a worker seems
hung."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

FIRST_ANSWER = """
from huepose.reinit import ObjectSlot, ReinitLoop, warm_up
from conftest import estimate, pose, result, track
import sys

warm_up()
before = set(sys.modules)
loop = ReinitLoop(objects=[ObjectSlot("mug"), ObjectSlot("jar")])
first = loop.tick(0, [])
assert len(loop.answer(1, result(first, 0, estimate("mug"), estimate("jar", pose(0.5))))) == 2
tracks = [track(name, applied=1, stamp_ms=300) for name in ("mug", "jar")]
second = loop.tick(300_000_000, tracks)
answer = estimate("mug", pose(0.01), instance=0, prior_score=1.0)
assert [c.verdict.value for c in loop.answer(310_000_000, result(second, 300, answer))] == ["agree"]
print(sorted(set(sys.modules) - before))
"""


def test_the_first_answer_loads_nothing() -> None:
    here = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, "-c", FIRST_ANSWER], capture_output=True, text=True, check=False, cwd=here
    )
    assert (done.stdout, done.stderr) == ("[]\n", "")
