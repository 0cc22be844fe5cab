"""What can be chosen about the estimator; the defaults are those of a live pipeline."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

from huepose.propose.config import EvidenceConfig, RetrievalConfig
from huepose.support.errors import InputError

if TYPE_CHECKING:
    from huepose.paper.extended.colorpair import ColorpairPathConfig
    from huepose.paper.single_frame import PaperConfig

Method = Literal["full", "colorpair", "paper"]


@dataclass(frozen=True)
class FullPathConfig:
    """How much the full method tries. Origin, where nothing else is said: chosen, by `huepose eval estimate`
    on drawn heaps and piles, as few as lose no recall there.

    kept: views a mask that stay after registration; with_near_symmetries: those whose near-symmetric
    rotations are tried; searched: poses a mask that are searched; judged: poses judged by all masks;
    finished: poses searched finely; alternatives: different poses that are returned.

    coarse_samples, samples: of the surface, by which poses are ranked before the search, and in it.
    search_deg, fine_deg, prior_deg: steps of the search, coarse to fine, in degrees: of proposed poses, of
    the best of them, and of a prior, which is nearer. registered_within: after the search, poses whose total
    is farther behind the best are not registered again.
    """

    retrieval: RetrievalConfig = field(default_factory=RetrievalConfig)
    kept: int = 8
    with_near_symmetries: int = 5
    searched: int = 18
    judged: int = 40
    finished: int = 5
    alternatives: int = 6
    coarse_samples: int = 350
    samples: int = 220
    search_deg: tuple[float, ...] = (8.0, 4.0, 2.0, 1.0)
    fine_deg: tuple[float, ...] = (3.0, 1.5, 0.7)
    prior_deg: tuple[float, ...] = (4.0, 2.0, 1.0)
    registered_within: float = 0.5


@dataclass(frozen=True)
class ConfirmConfig:
    """When a refined prior is plainly right, so that no views are sought. Origin: chosen.

    score: total from which it may be. margin: how much better than its near-symmetric rotations it must be,
    and the most that its margin counts then. near_symmetries: those that are searched, by steps_deg,
    chosen by so many surface samples. look_anew_every: one
    in so many frames is searched in full all the same, 1 for all of them.
    """

    score: float = 1.9
    margin: float = 0.12
    near_symmetries: int = 3
    samples: int = FullPathConfig.coarse_samples
    steps_deg: tuple[float, ...] = (3.0, 1.0)
    look_anew_every: int = 3


@dataclass(frozen=True)
class CompetitionConfig:
    """When poses of one frame compete for its depth. Origin: chosen.

    sure: quality from which a pose keeps its pixels; from other instances of its object it always does.
    contested: a pose is judged again when surer ones have this share of its visible pixels. doubtful, taken:
    so is one under this quality when surer ones have this share of its box.
    """

    sure: float = 0.5
    contested: float = 0.25
    doubtful: float = 0.8
    taken: float = 0.05


@dataclass(frozen=True)
class StandingConfig:
    """Which poses at proposed places stand.

    present: probability that the object is there from which a pose stands. Origin: a false one in ten frames
    of the drawn set `choose` of studies.presence (docs/detection.md). claimed: a pose of which better
    poses explain this share of the visible pixels has nothing of its own: the half.

    most_sure: no pose speaks more for its object than one of this quality. other_texture: another texture
    must be so many times likelier than the object's own before it speaks against it. Origin: chosen.
    """

    present: float = 0.6
    claimed: float = 0.5
    most_sure: float = 0.99
    other_texture: float = 2.0


@dataclass(frozen=True)
class EstimatorConfig:
    """method: "full" (the best that there is), "colorpair" (colour pairs alone, with what was added to the
    paper's path) or "paper" (the paper's path as it is); seed: of all random choices; threads: objects of a
    frame that are estimated at the same time; found_level: the probability that the object is there under
    which nothing is found, None for the calibrated one; competing: whether the poses of a frame compete for
    its depth; colorpair, paper: what can be set about the method of that name, None for its defaults. `paper`
    has no level and no competition."""

    method: Method = "full"
    seed: int = 0
    threads: int = 1
    found_level: float | None = None
    competing: bool = True
    evidence: EvidenceConfig = field(default_factory=EvidenceConfig)
    full: FullPathConfig = field(default_factory=FullPathConfig)
    confirm: ConfirmConfig = field(default_factory=ConfirmConfig)
    competition: CompetitionConfig = field(default_factory=CompetitionConfig)
    colorpair: ColorpairPathConfig | None = None
    paper: PaperConfig | None = None

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise InputError(
                "method", found=f"'{self.method}'", expected=" or ".join(f"'{m}'" for m in get_args(Method))
            )
        if self.threads < 1:
            raise InputError("threads", found=str(self.threads), expected="1 or more")
