"""The methods beside `full`, each loaded when an estimator is made that uses it.

So whoever estimates by `full` loads nothing of `paper`: not its modules, not what they compile.
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
        """Whether its first pose is the answer as it is: without the final refinement, the belief and the
        competition of a frame's objects."""
        ...

    def check(self, model: ReferenceModel) -> None:
        """Raises InputError for a model that lacks what the method needs."""
        ...

    def warm_up(self, models: Sequence[ReferenceModel]) -> None:
        """Compile what a first picture may do without and a later one needs."""
        ...

    def poses(self, model: ReferenceModel, evidence: Evidence, rng: np.random.Generator) -> Ranked:
        """Poses by its own score, best first; none where nothing is found."""
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
