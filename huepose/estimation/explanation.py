"""What an estimate is based on, for those who want to know why it is as it is."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.geometry.arrays import Bool
from huepose.geometry.box import Box
from huepose.propose.evidence import Evidence
from huepose.select.distinct import NONE, Ranked
from huepose.select.near_ties import Contest


@dataclass(frozen=True, eq=False)
class Explanation:
    """What an estimate is based on. masks: candidate masks (H, W); evidence: None if there is no depth;
    ranked: the different poses, best first; prior: the refined prior, if there was one; confirmed: the prior
    was clearly right, and views were not searched; contest: comparison of the best poses, if they nearly
    tied."""

    box: Box
    masks: tuple[Bool, ...]
    evidence: Evidence | None
    ranked: Ranked = NONE
    prior: Ranked = NONE
    confirmed: bool = False
    contest: Contest | None = None
