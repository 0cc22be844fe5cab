"""What led to an answer, for whoever wants to see why it is what it is."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.geometry.arrays import Bool
from huepose.geometry.box import Box
from huepose.propose.evidence import Evidence
from huepose.select.distinct import NONE, Ranked
from huepose.select.near_ties import Contest


@dataclass(frozen=True, eq=False)
class Explanation:
    """What led to an answer: the box, the candidate masks (H, W), what was looked at (None where there is no
    depth), and the different poses, best first; prior: the refined prior, where there was one; confirmed: it
    was plainly right, and no other views were sought; contest: between the best poses,
    where they scored nearly alike."""

    box: Box
    masks: tuple[Bool, ...]
    evidence: Evidence | None
    ranked: Ranked = NONE
    prior: Ranked = NONE
    confirmed: bool = False
    contest: Contest | None = None
