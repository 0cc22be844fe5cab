"""Fit presence: render scenes, detect and estimate all objects in them, fit, write the weights.

    .venv/bin/python -m studies.presence --models MODELS_DIR --bundles DIR --work build/presence

Three sets are rendered (`studies.presence.fit`): the weights are fitted on the first, features and level were
chosen on the second, and the third is reported. Scenes and results are kept in the work folder. Fit quality
first, because the quality of a pose enters the presence of its object.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from huepose.believe.logistic import Logistic, Question, belief, write_fit
from huepose.evaluation.summary import table
from studies.presence.fit import FRAMES, chances, draw, fit_presence, seen_in
from studies.quality.__main__ import bundles_of

LEVELS = (0.3, 0.4, 0.5, 0.6, 0.7)
"""Levels of presence from which on an object is found, in the printed table."""


def main() -> None:
    """Render, estimate in processes, fit, write, print."""
    arguments = _arguments()
    bundles = bundles_of(arguments.models, arguments.bundles, arguments.work)
    folders = {name: draw(name, arguments.models, arguments.work) for name in FRAMES}
    asked = [folder for each in folders.values() for folder in each]
    with ProcessPoolExecutor(arguments.processes, mp_context=get_context("spawn")) as pool:
        looks = dict(zip(asked, pool.map(seen_in, asked, [bundles] * len(asked)), strict=True))
    seen = {name: [frame for folder in each for frame in looks[folder]] for name, each in folders.items()}
    before, found = belief("presence"), fit_presence(seen["fit"], belief("presence"))
    # Every second entry has the colours of another camera; rough poses are fitted on the others.
    of_rough = fit_presence([frame.rough() for frame in seen["fit"][::2]], belief("place"))
    fits: tuple[tuple[Question, Logistic], ...] = (("presence", found), ("place", of_rough))
    for question, fit in fits:
        factors = {name: round(x, 4) for name, x in fit.factors.items()}
        write_fit(question, {"constant": round(fit.constant, 4), "factors": factors})
        print(question, fit)
    rows = []
    for name, frames in seen.items():
        there = np.concatenate([f.there for f in frames])
        for weights, fit in (("before", before), ("fitted", found)):
            stated = np.concatenate([chances(f, fit) for f in frames])
            for level in LEVELS:
                over = stated >= level
                shares = (100.0 * over[there].mean(), over[~there].sum() / len(frames))
                rows.append([name, weights, level, len(there), int(there.sum()), *shares])
    print(table(["set", "weights", "level", "poses", "there", "over level %", "others per frame"], rows))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Fit presence.")
    parser.add_argument("--models", type=Path, required=True, metavar="DIR", help="BOP models folder")
    parser.add_argument("--bundles", type=Path, default=None, metavar="DIR", help="their reference models")
    parser.add_argument("--work", type=Path, default=Path("build/presence"), metavar="DIR")
    parser.add_argument("--processes", type=int, default=2, metavar="N")
    return parser.parse_args()


if __name__ == "__main__":
    main()
