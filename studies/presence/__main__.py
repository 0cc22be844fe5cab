"""Fit presence anew: draw scenes, ask the detector and the estimator for everything, fit, write the weights.

    .venv/bin/python -m studies.presence --models MODELS_DIR --bundles DIR --work build/quality

Scenes that `studies.quality` drew in the same folder are used; what is missing is drawn. Quality should be
fitted first, because a pose that is surely right speaks for its object.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from huepose.believe.fits import write_fit
from huepose.believe.presence import presence_fit
from huepose.datasets.bop import BopScene
from huepose.datasets.types import Sample
from huepose.estimation import Estimator, EstimatorConfig
from huepose.estimation.config import StandingConfig
from huepose.evaluation.summary import table
from huepose.evaluation.targets import Targets
from huepose.model import load_models
from huepose.perception.colorpair_detector import ColorPairDetector
from huepose.perception.config import DetectorConfig
from huepose.support.progress import progress
from studies.presence.fit import SeenPlaces, chances, fit_presence, look
from studies.quality.__main__ import bundles_of, drawn_ycb

EVERY = 5
"""So many frames of the drawn ones are one that is used."""

FOLDS = 5


def main() -> None:
    """Draw, look in two processes, fit, write, print."""
    arguments = _arguments()
    scenes = drawn_ycb(arguments.models, arguments.work)
    bundles = bundles_of(arguments.models, arguments.bundles, arguments.work)
    images = [(path, image) for path in scenes for image in BopScene(path).image_ids[::EVERY]]
    shares = [(images[k :: arguments.processes], bundles) for k in range(arguments.processes)]
    with ProcessPoolExecutor(arguments.processes, mp_context=get_context("spawn")) as pool:
        looks = list(pool.map(_seen, *zip(*shares, strict=True)))
    frames = [frame for k in range(len(images)) for frame in [looks[k % len(looks)][k // len(looks)]]]
    held_out = np.concatenate(
        [chances(f, fit_presence(_but(frames, k), presence_fit())) for k, f in _dealt(frames)]
    )
    found = fit_presence(frames, presence_fit())
    factors = {name: round(x, 4) for name, x in found.factors.items()}
    write_fit("presence", {"constant": round(found.constant, 4), "factors": factors})
    rows = []
    for name, stated in (
        ("before", np.concatenate([chances(f, presence_fit()) for f in frames])),
        ("held out", held_out),
    ):
        there = np.concatenate([f.there for f in frames])
        over = stated >= StandingConfig().present
        rows.append([name, len(there), 100.0 * there.mean(), 100.0 * over[there].mean(),
                     100.0 * there[over].mean(), f"{stated.mean():.3f}"])  # fmt: skip
    print(found)
    print(table(["weights", "poses", "there %", "of them over the level %", "right over it %", "mean"], rows))


def _dealt(frames: Sequence[SeenPlaces]) -> list[tuple[int, SeenPlaces]]:
    return [(k % FOLDS, frame) for k, frame in enumerate(frames)]


def _but(frames: Sequence[SeenPlaces], fold: int) -> list[SeenPlaces]:
    return [frame for k, frame in _dealt(frames) if k != fold]


def _seen(images: Sequence[tuple[Path, int]], bundles: Path) -> list[SeenPlaces]:
    """What is seen in some images, everything asked for."""
    targets = Targets(load_models(bundles))
    models = targets.models_by_name
    detector = ColorPairDetector(models, DetectorConfig(proposals=3, min_score=0.0))
    estimator = Estimator(models, EstimatorConfig(found_level=0.0))
    scenes = {path: BopScene(path) for path, _ in images}
    out = []
    for path, image in progress(images, "frames"):
        scene = scenes[path]
        sample = Sample(scene.frame(image), scene.truths(image), scene.name, image)
        out.append(look(sample, targets, detector, estimator))
    return out


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Fit presence anew.")
    parser.add_argument("--models", type=Path, required=True, metavar="DIR", help="BOP models folder")
    parser.add_argument("--bundles", type=Path, default=None, metavar="DIR", help="their reference models")
    parser.add_argument("--work", type=Path, default=Path("build/quality"), metavar="DIR")
    parser.add_argument("--processes", type=int, default=2, metavar="N")
    return parser.parse_args()


if __name__ == "__main__":
    main()
