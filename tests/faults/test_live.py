"""Some faults of a running pipeline, short: `huepose chaos` knows them all, and takes its time."""

from __future__ import annotations

import pytest

from huepose_services.chaos.faults import FAULTS
from huepose_services.chaos.outcome import STEADY_OBJECTS, strike
from huepose_services.chaos.system import LivePipeline

pytestmark = [pytest.mark.live, pytest.mark.timeout(900)]

# Of the camera, of the bus, of a worker, of a reader. 10 Hz: how late things are on a busy computer is not
# what this is about.
SLOW = 3.0
SHORT = (
    "last picture with new stamps",
    "depth 3 pictures late",
    "depth all nan",
    "focal length 1.5 times too long",
    "empty masks, masks of another size",
    "frames twice and out of order",
    "corrections older than what is kept",
    "a second camera under one key",
    "a reader that takes 100 ms each",
    "reinit killed",
    "tracker killed",
)
FAULT = {fault.name: fault for fault in FAULTS}


@pytest.fixture(scope="module")
def system():
    with LivePipeline(live=True, slow=SLOW) as one:
        assert one.wait_until_steady(STEADY_OBJECTS, 700.0), one.log()[-3000:]
        yield one


@pytest.mark.parametrize("name", SHORT)
def test_what_must_hold_holds(system, name):
    outcome = strike(system, FAULT[name], 120.0)
    assert outcome.broken == [], (outcome, system.log()[-2000:])
    assert outcome.tracking_poses > 0
