"""What can be set about the paper's method on single frames."""

from __future__ import annotations

from dataclasses import dataclass, field

from huepose.paper.classes import ClassConfig
from huepose.paper.ppf import PpfConfig
from huepose.paper.semantic_icp import SemanticIcpConfig
from huepose.paper.triangles import TriangleConfig
from huepose.paper.voting import VotingConfig


@dataclass(frozen=True)
class PaperConfig:
    """refined: initial alignments that are refined, the paper's "small, consistent set"; triangles, ppf: None
    to do without that source of votes (see `paper.ppf` for why one may not want point pair features, which
    are always asked where triangles are not); the rest: of the steps."""

    refined: int = 30
    classes: ClassConfig = field(default_factory=ClassConfig)
    triangles: TriangleConfig | None = field(default_factory=TriangleConfig)
    ppf: PpfConfig | None = field(default_factory=PpfConfig)
    voting: VotingConfig = field(default_factory=VotingConfig)
    icp: SemanticIcpConfig = field(default_factory=SemanticIcpConfig)
