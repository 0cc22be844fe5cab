"""The estimates that quality is fitted to, made in processes: what they run must not be in `__main__`, which
processes that are spawned do not import."""

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
"""Least share of an object that is seen, for it to be asked for."""

ABSENT_PER_FRAME = 3
"""Objects that are asked for in each frame and are not in it."""


@dataclass(frozen=True)
class Part:
    """A share of a scene's frames, from `first` on every `step`, by one method."""

    kind: str
    method: Method
    scene: Path
    bundles: Path
    first: int
    step: int

    @property
    def name(self) -> str:
        """Of its result file."""
        return f"{self.method}_{self.scene.name}_{self.kind}_{self.first}of{self.step}"


def estimate(part: Part, work: Path) -> None:
    """The estimates of a part, as a file. Nothing is hidden as not found, so that all is fitted to."""
    models = load_models(part.bundles)
    targets, whole = Targets(models), BopScene(part.scene)
    scene = SomeImages(whole, whole.image_ids[part.first :: part.step])
    estimator = Estimator(models, EstimatorConfig(method=part.method, found_level=0.0))
    path = work / f"{part.name}.json"
    if part.kind == "others":
        asked = list(questions([scene], targets, ABSENT_PER_FRAME))
        write_json(path, {"rows": answers_where_absent(estimator, asked)})
    else:
        options = EstimateOptions(min_visib=MIN_VISIB)
        write_json(path, evaluate_estimates([scene], targets, estimator, options).as_json())
