"""The estimates to which quality is fitted. They are made in processes; spawned processes do not import
`__main__`, so their code is here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from huepose.datasets.bop import BopScene
from huepose.datasets.types import SomeImages
from huepose.estimation import Estimator, EstimatorConfig
from huepose.estimation.config import Method
from huepose.evaluation.estimate_protocol import EstimateOptions, evaluate_estimates
from huepose.evaluation.result_files import write_json
from huepose.evaluation.targets import Targets
from huepose.model import load_models
from studies.absent import answers_where_absent, questions

MIN_VISIB = 0.1
"""Least visible share of an object that is estimated."""


@dataclass(frozen=True)
class Part:
    """Every `step`-th frame of a scene from `first` on, by one method."""

    kind: str
    method: Method
    scene: Path
    bundles: Path
    first: int
    step: int

    @property
    def name(self) -> str:
        """The name of its result file."""
        return f"{self.method}_{self.scene.name}_{self.kind}_{self.first}of{self.step}"


def estimate(part: Part, work: Path) -> None:
    """Write the estimates of a part to a file. With a found level of 0 all poses count as found, so that all
    are fitted."""
    models = load_models(part.bundles)
    targets, whole = Targets(models), BopScene(part.scene)
    scene = SomeImages(whole, whole.image_ids[part.first :: part.step])
    estimator = Estimator(models, EstimatorConfig(method=part.method, found_level=0.0))
    path = work / f"{part.name}.json"
    if part.kind == "others":
        asked = list(questions([scene], targets))
        write_json(path, {"rows": answers_where_absent(estimator, asked)})
    else:
        options = EstimateOptions(min_visib=MIN_VISIB)
        write_json(path, evaluate_estimates([scene], targets, estimator, options).as_json())
