"""Prepare a computer once, when HuePose is set up: compile the numeric kernels, so that no later command is
silent for a minute, onboard the objects of the built-in scene, and render that scene.

`python -m huepose_services.first_time`; deploy/first_time.sh calls it.
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
    """Do each step, and print how long it took."""
    signal.signal(signal.SIGINT, _interrupted)
    from huepose.model import load_models
    from huepose.scenes.builtin import SyntheticScene
    from huepose.support.compiling import telling_of_compiling
    from huepose_services.builtin import builtin_bundles, bundles_are_kept

    kept = bundles_are_kept(0)
    folder = _timed("the built-in objects", lambda: builtin_bundles(0))
    with telling_of_compiling(every=True):
        _timed("the numeric kernels", lambda: compile_all(load_models(folder), learn=kept))
    _timed("the built-in scene", lambda: SyntheticScene(0))


def _interrupted(number: int, frame: FrameType | None) -> None:
    """End at once, also inside the compiler, which would report an exception as its own fault. No file is
    left incomplete: caches are written whole or not at all."""
    clear = "\r\x1b[K" if sys.stderr.isatty() else ""
    os.write(2, f"{clear}setup: interrupted; `make setup` goes on here\n".encode())
    os._exit(130)


def _timed(what: str, work: Callable[[], T]) -> T:
    """Do a step and print the time; a step whose results are cached takes a few seconds at most."""
    start = time.monotonic()
    done = work()
    print(f"setup: {what}: ready after {time.monotonic() - start:.0f} s", flush=True)
    return done


def compile_all(models: Mapping[str, ReferenceModel], learn: bool) -> None:
    """Compile all kernels: do once, on the built-in objects, what commands and workers do. learn: also
    onboard one object; needed if all reference models were cached, because then onboarding has compiled
    nothing here."""
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
    Tiles.of(frame)  # the detector uses it from the second frame on
    # A kernel of the paper's methods.
    local_planes(shot.depth, shot.depth > 0.0, CAMERA, np.zeros((1, 2)), RADIUS_PX, GATE_M)
    _estimate_rendered(models["corner_bracket"])
    _estimate_rendered(models["soup_can"])


def _estimate_rendered(model: ReferenceModel) -> None:
    """Estimate an object in a rendered frame, as the self-test of a new object does."""
    from huepose.estimation import Estimator, ObjectQuery
    from huepose.evaluation import suitability
    from huepose.geometry import Box, RgbdFrame
    from huepose.profiles import profile
    from huepose.scenes.rendered import rendered_frame

    rendered = rendered_frame({model.name: model.mesh}, 0, 0, suitability.RANGES)
    box = Box.of_mask(rendered.shot.owner == 0)
    frame = RgbdFrame(rendered.shot.color, rendered.shot.depth, rendered.camera)
    if box is not None:
        Estimator({model.name: model}, profile("live").estimator).estimate(
            frame, [ObjectQuery(model.name, box)]
        )


if __name__ == "__main__":
    main()
