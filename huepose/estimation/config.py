"""What can be chosen about the estimator; the defaults are those of a live pipeline."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from huepose.paper.config import ColorpairPathConfig
from huepose.support.errors import InputError

Method = Literal["full", "colorpair"]


@dataclass(frozen=True)
class FullPathConfig:
    """How much the full method tries. retrieved: views a mask; kept: of them after ICP; turned: those whose
    near-symmetric turns are tried; searched: poses a mask that are searched; judged: poses judged by all
    masks; finished: poses searched finely; alternatives: different poses that are returned; closer:
    templates a mask that get a close look, and that are tried at neighbouring places; samples: of the surface
    in the search; unregistered: whether views are tried as they were found, too, besides after registration;
    poor: a total under which no pose is taken for the answer before it was looked harder."""

    retrieved: int = 30
    kept: int = 8
    turned: int = 5
    searched: int = 18
    judged: int = 40
    finished: int = 5
    alternatives: int = 6
    closer: tuple[int, int] = (1500, 200)
    samples: int = 220
    unregistered: bool = False
    poor: float = 1.4

    def harder(self) -> FullPathConfig:
        """To look harder: two to three times as much of everything."""
        return replace(
            self,
            retrieved=3 * self.retrieved,
            kept=3 * self.kept,
            turned=2 * self.turned,
            searched=2 * self.searched,
            finished=2 * self.finished,
            closer=(2 * self.closer[0], 2 * self.closer[1]),
            unregistered=True,
        )


@dataclass(frozen=True)
class EstimatorConfig:
    """method: "full" (the best that there is) or "colorpair" (the paper's path alone); seed: of all random
    choices; threads: objects of a frame that are estimated at the same time; acquisition_level: the quality
    over which a pose is TRACKING, None for the calibrated one of the method; found_level: the probability
    that the object is there under which nothing is found, None for the calibrated one; competition: whether
    the poses of a frame compete for its depth; look_anew_every: one in so many frames is searched in full
    even when a prior is plainly right (see `confirm`), 1 for all of them; look_harder: whether poor poses are
    looked for again with more effort, which is a waste where boxes are proposals or the next frame is due."""

    method: Method = "full"
    seed: int = 0
    threads: int = 1
    acquisition_level: float | None = None
    found_level: float | None = None
    competition: bool = True
    look_anew_every: int = 3
    look_harder: bool = False
    full: FullPathConfig = field(default_factory=FullPathConfig)
    colorpair: ColorpairPathConfig = field(default_factory=ColorpairPathConfig)

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise InputError(
                "method", found=f"'{self.method}'", expected=" or ".join(f"'{m}'" for m in get_args(Method))
            )
        if self.threads < 1:
            raise InputError("threads", found=str(self.threads), expected="1 or more")
        if self.acquisition_level is not None and not 0.0 < self.acquisition_level < 1.0:
            raise InputError(
                "acquisition_level",
                found=str(self.acquisition_level),
                expected="a probability between 0 and 1",
            )
