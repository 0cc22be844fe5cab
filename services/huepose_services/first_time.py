"""What a computer does once, when HuePose is set up: it compiles the numeric kernels, so that no command
afterwards is silent for a minute, learns the objects of the built-in scene, and draws that scene.

`python -m huepose_services.first_time`, as deploy/setup.sh calls it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from huepose import reinit
from huepose.estimation import Estimator, ObjectQuery
from huepose.evaluation import suitability
from huepose.geometry import Box, RgbdFrame
from huepose.model import ReferenceModel, load_models
from huepose.perception.colorpair_detector import ColorPairDetector
from huepose.profiles import profile
from huepose.scenes.builtin import SyntheticScene, first_shot
from huepose.scenes.plan import CAMERA
from huepose.scenes.rendered import rendered_frame
from huepose.support.progress import progress
from huepose.tracking import Tracker
from huepose_services.builtin import builtin_bundles


def main() -> None:
    """Do once, on built-in objects, what commands and workers will do. Each step says how far it is;
    kernels are not counted beside that, which would write over the same line of a terminal."""
    models = load_models(builtin_bundles(0))
    live, names = profile("live"), sorted(models)
    shot = first_shot({name: models[name].mesh for name in names})
    frame = RgbdFrame(shot.color, shot.depth, CAMERA)
    steps: list[Callable[[], object]] = [
        lambda: Estimator(models, live.estimator).warm_up(),
        lambda: ColorPairDetector(models, live.detector).detect(frame, names),
        lambda: Tracker(models, live.tracker).warm_up(),
        reinit.warm_up,
        partial(_in_a_drawn_scene, models["corner_bracket"]),
        partial(_in_a_drawn_scene, models["soup_can"]),
    ]
    for step in progress(steps, "compiling numeric kernels for this computer"):
        step()
    SyntheticScene(0)


def _in_a_drawn_scene(model: ReferenceModel) -> None:
    """As the self-test of a new object."""
    drawn = rendered_frame({model.name: model.mesh}, 0, 0, suitability.RANGES)
    box = Box.of_mask(drawn.shot.owner == 0)
    frame = RgbdFrame(drawn.shot.color, drawn.shot.depth, drawn.camera)
    if box is not None:
        Estimator({model.name: model}, profile("live").estimator).estimate(
            frame, [ObjectQuery(model.name, box)]
        )


if __name__ == "__main__":
    main()
