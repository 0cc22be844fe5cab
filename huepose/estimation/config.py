"""Settings of the estimator; the defaults are those of a live pipeline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

from huepose.support.errors import InputError

if TYPE_CHECKING:
    from huepose.paper.extended.colorpair import ColorpairPathConfig
    from huepose.paper.single_frame import PaperConfig

Method = Literal["full", "colorpair", "paper"]


@dataclass(frozen=True)
class EstimatorConfig:
    """method: "full" (the best), "colorpair" (colour pairs alone: the paper's method with additions) or
    "paper" (the paper's method as it is); seed: of all random choices; threads: objects of a frame that are
    estimated at the same time; found_level: a pose is found from this probability that the object is there,
    None for the calibrated one, which `paper` does not have; look_anew_every: one in this many frames is
    searched in full even if a refined prior is clearly right, 1 for all (chosen); colorpair, paper: settings
    of the method of that name, None for its defaults."""

    method: Method = "full"
    seed: int = 0
    threads: int = 1
    found_level: float | None = None
    look_anew_every: int = 3
    colorpair: ColorpairPathConfig | None = None
    paper: PaperConfig | None = None

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise InputError(
                "method", found=f"'{self.method}'", expected=" or ".join(f"'{m}'" for m in get_args(Method))
            )
        if self.threads < 1:
            raise InputError("threads", found=str(self.threads), expected="1 or more")
