"""What a computer does once, when HuePose is set up: it compiles the numeric kernels, so that no command
afterwards is silent for a minute, learns the objects of the built-in scene, and draws that scene.

`python -m huepose_services.first_time`, as deploy/first_time.sh calls it.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from types import FrameType
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from huepose.model import ReferenceModel

T = TypeVar("T")


def main() -> None:
    """Each step in turn, and how long it took."""
    signal.signal(signal.SIGINT, _interrupted)
    from huepose.model import load_models
    from huepose.scenes.builtin import SyntheticScene
    from huepose.support.compiling import telling_of_compiling
    from huepose_services.builtin import builtin_bundles, bundles_are_kept

    kept = bundles_are_kept(0)
    folder = _told("the built-in objects", lambda: builtin_bundles(0))
    with telling_of_compiling(every=True):
        _told("the numeric kernels", lambda: compile_all(load_models(folder), learn=kept))
    _told("the built-in scene", lambda: SyntheticScene(0))


def _interrupted(number: int, frame: FrameType | None) -> None:
    """Ends at once, also within the compiler, which takes an exception for a fault of its own: what is kept
    is written whole."""
    clear = "\r\x1b[K" if sys.stderr.isatty() else ""
    os.write(2, f"{clear}setup: interrupted; `make setup` goes on here\n".encode())
    os._exit(130)


def _told(what: str, work: Callable[[], T]) -> T:
    """Do it, and say that it is there; what was kept from an earlier time takes a few seconds at most."""
    start = time.monotonic()
    done = work()
    print(f"setup: {what}: ready after {time.monotonic() - start:.0f} s", flush=True)
    return done


def compile_all(models: Mapping[str, ReferenceModel], learn: bool) -> None:
    """Do once, on the built-in objects, what commands and workers will do: all kernels are compiled then.
    learn: one of them is learnt, which has compiled nothing here where all were kept from before."""
    import numpy as np

    from huepose import reinit
    from huepose.colorpair.lifting import GATE_M, RADIUS_PX, local_planes
    from huepose.estimation import Estimator
    from huepose.geometry import RgbdFrame
    from huepose.onboarding.reference import reference_model
    from huepose.perception.stillness import Tiles
    from huepose.perception.view_detector import ViewDetector
    from huepose.profiles import profile
    from huepose.scenes.builtin import first_shot
    from huepose.scenes.camera import CAMERA
    from huepose.tracking import Tracker

    if learn:
        reference_model(models["corner_bracket"].mesh, "corner_bracket")
    live, names = profile("live"), sorted(models)
    shot = first_shot({name: models[name].mesh for name in names})
    frame = RgbdFrame(shot.color, shot.depth, CAMERA)
    Estimator(models, live.estimator).warm_up()
    ViewDetector(models, live.detector).detect(frame, names)
    Tracker(models, live.tracker).warm_up()
    reinit.warm_up()
    Tiles.of(frame)  # what a detector sees of a second frame
    # What the methods of the paper do.
    local_planes(shot.depth, shot.depth > 0.0, CAMERA, np.zeros((1, 2)), RADIUS_PX, GATE_M)
    _in_a_drawn_scene(models["corner_bracket"])
    _in_a_drawn_scene(models["soup_can"])


def _in_a_drawn_scene(model: ReferenceModel) -> None:
    """As the self-test of a new object."""
    from huepose.estimation import Estimator, ObjectQuery
    from huepose.evaluation import suitability
    from huepose.geometry import Box, RgbdFrame
    from huepose.profiles import profile
    from huepose.scenes.rendered import rendered_frame

    drawn = rendered_frame({model.name: model.mesh}, 0, 0, suitability.RANGES)
    box = Box.of_mask(drawn.shot.owner == 0)
    frame = RgbdFrame(drawn.shot.color, drawn.shot.depth, drawn.camera)
    if box is not None:
        Estimator({model.name: model}, profile("live").estimator).estimate(
            frame, [ObjectQuery(model.name, box)]
        )


if __name__ == "__main__":
    main()
