"""Re-initialisation: which objects perception looks for and when, and what its estimates mean."""

from huepose.reinit.config import ReinitConfig
from huepose.reinit.judge import judge_tracked
from huepose.reinit.loop import ReinitLoop
from huepose.reinit.types import (
    Counters,
    ObjectSlot,
    PerceptionResult,
    Prior,
    Request,
    RequestedObject,
    Searching,
)
from huepose.reinit.warm_up import warm_up

__all__ = [
    "Counters",
    "ObjectSlot",
    "PerceptionResult",
    "Prior",
    "ReinitConfig",
    "ReinitLoop",
    "Request",
    "RequestedObject",
    "Searching",
    "judge_tracked",
    "warm_up",
]
