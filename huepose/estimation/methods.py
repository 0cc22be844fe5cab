"""The methods other than `full`; each is loaded when an estimator that uses it is made.

So a process that estimates with `full` loads nothing of `paper`: neither its modules nor their compiled
kernels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from huepose.estimation.config import EstimatorConfig
from huepose.model.types import ReferenceModel
from huepose.propose.evidence import Evidence
from huepose.select.distinct import Ranked


class PairMethod(Protocol):
    """A method that finds poses by colour pairs alone."""

    @property
    def bare(self) -> bool:
        """Whether its first pose is the estimate as it is: without the final refinement, the belief and the
        competition of a frame's objects."""
        ...

    def check(self, model: ReferenceModel) -> None:
        """Raises InputError for a model that lacks what the method needs."""
        ...

    def warm_up(self, models: Sequence[ReferenceModel]) -> None:
        """Compile kernels that the first frame may not need but a later one does."""
        ...

    def poses(self, model: ReferenceModel, evidence: Evidence, rng: np.random.Generator) -> Ranked:
        """Poses ranked by its own score, best first; none if nothing is found."""
        ...


def method_of(config: EstimatorConfig) -> PairMethod | None:
    """The method of a configuration; None for `full`, which is the estimator's own."""
    if config.method == "paper":
        from huepose.paper.single_frame import PaperMethod

        return PaperMethod(config.paper)
    if config.method == "colorpair":
        from huepose.paper.extended.colorpair import ColorpairMethod

        return ColorpairMethod(config.colorpair)
    return None
