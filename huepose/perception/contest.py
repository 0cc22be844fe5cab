"""Places that several objects are proposed for: what one explains well, others explain less likely."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from huepose.perception.scouting import Proposal
from huepose.select.surfaces import HALF, share_held

LEAD = 0.7
"""A place is another object's when its score there, a logit, is higher by this, and it holds half of the
place's surface."""

FALL = 1.5
"""What the score of a place falls by when it is another object's."""


def contested(proposals: Mapping[str, Sequence[Proposal]]) -> dict[str, list[Proposal]]:
    """The proposals of each object, best first, after those places have lost that other objects explain
    better. The best place of an object speaks for it; the others do not."""
    leaders = {name: max(places, key=lambda p: p.score) for name, places in proposals.items() if places}
    out = {}
    for name, places in proposals.items():
        rivals = [leader for other, leader in leaders.items() if other != name]
        fallen = [replace(p, score=p.score - FALL) if _lost(p, rivals) else p for p in places]
        out[name] = sorted(fallen, key=lambda p: -p.score)
    return out


def _lost(place: Proposal, rivals: Sequence[Proposal]) -> bool:
    better = [rival.support for rival in rivals if rival.score > place.score + LEAD]
    return bool(better) and share_held(place.support, np.unique(np.concatenate(better))) > HALF
