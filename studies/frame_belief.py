"""Fit how sure a pose in a frame is (`believe.frame`): poses that tracking reaches, right and wrong, on drawn
sequences.

    S="python -m studies.drawn_sequences --bundles BUNDLES"
    $S --out build/fit --seed 21 --count 16 --objects 1 3 5 8 15 18 12 20
    $S --out build/choose --seed 22 --count 8 --objects 2 4 7 17
    python -m studies.frame_belief --bundles BUNDLES --fit build/fit --choose build/choose --json out.json

Every third frame is reached from 1 to 15 frames before, from wrong places and turns, and from elsewhere in
the picture. Each pose that comes out counts as right or wrong by where it is, whatever led there. `--write`
puts the fit in the package."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from huepose.believe.fits import write_fit
from huepose.believe.frame import features
from huepose.believe.logistic import Logistic
from huepose.datasets.fast_ycb import FastYcbSequence, object_of
from huepose.evaluation import metrics
from huepose.geometry import RgbdFrame, se3
from huepose.geometry.arrays import Bool, Float64
from huepose.judge.terms import NOTHING
from huepose.model import ReferenceModel, load_models
from huepose.support.progress import progress
from huepose.tracking import TrackerConfig, evidence
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.motion import increment_velocity
from huepose.tracking.step import Anchor, Subject, advance, best_of
from studies.likelihood import logistic

EVERY = 3
NEAR, FAR = (3, 5, 7), (10, 15)
"""Frames apart, beside neighbours."""

KNOWN = 0.8
"""Share of the questions in which baseline and light are known."""


@dataclass(frozen=True)
class Row:
    """What is seen at a pose that was reached, how (`kind`), and its error in diameters."""

    sequence: str
    frame: int
    kind: str
    source: str
    features: Mapping[str, float]
    error: float


def main() -> None:
    """Collect, fit, report on what the fit has not seen."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bundles", type=Path, required=True)
    parser.add_argument("--fit", type=Path, required=True)
    parser.add_argument("--choose", type=Path, required=True)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    parts = {name: rows_of(arguments.bundles, getattr(arguments, name)) for name in ("fit", "choose")}
    fit = fitted(parts["fit"])
    report = {name: worth(rows, fit) for name, rows in parts.items()}
    factors = {k: round(v, 3) for k, v in fit.factors.items() if v > 0}
    entry = {"constant": round(fit.constant, 3), "factors": factors}
    rows = {name: [asdict(row) for row in rows] for name, rows in parts.items()}
    arguments.json.write_text(json.dumps({"fit": entry, "report": report, "rows": rows}))
    if arguments.write:
        write_fit("frame", entry)
    print(json.dumps({"fit": entry, "report": report}, indent=1))


def rows_of(bundles: Path, folder: Path) -> list[Row]:
    """Of all sequences in a folder of `studies.drawn_sequences`."""
    sequences = sorted(path.parents[1] for path in folder.glob("*/*/gt/poses_ycb.txt"))
    with ProcessPoolExecutor() as pool:
        collected = pool.map(partial(collect, bundles), sequences)
        return [row for rows in progress(collected, folder.name, len(sequences)) for row in rows]


def collect(bundles: Path, path: Path) -> list[Row]:
    """Poses that are reached in every third frame of a sequence."""
    model = load_models(bundles)[object_of(path)]
    offset = np.zeros(3) if model.frame_offset_m is None else model.frame_offset_m
    sequence, subject = FastYcbSequence(path, offset), Subject.of(model)
    visible = json.loads((path / "visib_fract.json").read_text())
    rng = np.random.default_rng([len(path.name), *path.parent.name.encode()])
    frames = [sequence.frame(i) for i in sequence.image_ids]
    labels = [sequence.truths(i)[0].T_cam_obj for i in sequence.image_ids]
    truth = [T for T in labels if T is not None]
    baseline, light, rows = None, None, []
    for i in range(2, len(frames), EVERY):
        if visible[i] < 0.1:
            continue
        before = best_of(subject.surface, frames[i - 1], [(truth[i - 1], "still")], light)
        if error_of(model, before.T_cam_obj, truth[i - 1]) < metrics.RECALL_FRACTION:
            baseline = evidence.baseline_after(baseline, before.terms.total)
            light = evidence.light_after(light, before.terms)
        found: list[tuple[str, float | None, Hypothesis]] = []
        for step in (1, int(rng.choice(NEAR)), int(rng.choice(FAR))):
            if i - step < 1:
                continue
            known = rng.random() < KNOWN
            baseline_now, lit = (baseline, light) if known else (None, None)
            velocity = increment_velocity(truth[i - step - 1], truth[i - step], 1 / 30)
            start = Hypothesis(truth[i - step], NOTHING, np.zeros((6, 6)), "still", velocity)
            reached = advance(
                subject, Anchor((start,), frames[i - step], baseline_now, lit), frames[i], TrackerConfig()
            )
            found += [(f"step {step}", baseline_now, h) for h in (*reached.followed, *reached.proposed)]
        for kind, T in wrong_starts(model, truth[i], frames[i], rng):
            found.append((kind, baseline, best_of(subject.surface, frames[i], [(T, "still")], light)))
        for kind, baseline_now, h in found:
            error = error_of(model, h.T_cam_obj, truth[i])
            seen = features(h.terms, baseline_now)
            rows.append(Row(path.parent.name, i, kind, h.source, seen, error))
    return rows


def wrong_starts(
    model: ReferenceModel, T_cam_obj: Float64, frame: RgbdFrame, rng: np.random.Generator
) -> list[tuple[str, Float64]]:
    """Poses that are shifted and turned, turned over so that the shape nearly fits, and elsewhere in the
    picture."""
    centre = T_cam_obj[:3, :3] @ model.mesh.centre + T_cam_obj[:3, 3]

    def at(turn: Float64, place: Float64) -> Float64:
        R = se3.rotation_exp(turn) @ T_cam_obj[:3, :3]
        return se3.make(R, place - R @ model.mesh.centre)

    out = []
    for _ in range(2):
        axis = rng.normal(size=3)
        turn = axis / np.linalg.norm(axis) * rng.uniform(0.3, np.pi)
        out.append(("shifted", at(turn, centre + rng.normal(0, 0.5 * model.diameter_m, 3) * (1, 1, 0.5))))
    if len(model.near_symmetries) > 1:
        out.append(
            (
                "turned over",
                T_cam_obj @ model.near_symmetries[1 + int(rng.integers(len(model.near_symmetries) - 1))],
            )
        )
    rows, columns = np.nonzero(frame.depth > 0.3)
    if len(rows):
        k = int(rng.integers(len(rows)))
        pixel = np.array([[columns[k], rows[k]]], float)
        place = frame.camera.backproject(pixel, frame.depth[rows[k : k + 1], columns[k : k + 1]])[0]
        out.append(("elsewhere", at(rng.normal(0, 1.5, 3), place)))
    return out


def error_of(model: ReferenceModel, T_cam_obj: Float64, truth: Float64) -> float:
    """ADD to the nearest equivalent pose, in diameters."""
    return (
        min(metrics.add(model.eval_points, T_cam_obj, truth @ turn) for turn in model.equivalents)
        / model.diameter_m
    )


def _table(rows: Sequence[Row]) -> tuple[list[str], Float64, Bool]:
    names = list(rows[0].features)
    X = np.array([[row.features[name] for name in names] for row in rows])
    return names, X, np.array([row.error < metrics.RECALL_FRACTION for row in rows])


def fitted(rows: Sequence[Row]) -> Logistic:
    """The fit of the largest likelihood, right and wrong weighing alike."""
    names, X, right = _table(rows)
    weight = np.where(right, 0.5 / right.mean(), 0.5 / (1.0 - right.mean()))
    return logistic(X, right, weight, names)


def worth(rows: Sequence[Row], fit: Logistic) -> dict[str, float]:
    """What a fit is worth on rows: mean log likelihood, calibration error over ten bins of equal count, share
    of the right under and of the wrong over the level of TRACKING, percent."""
    right = np.array([row.error < metrics.RECALL_FRACTION for row in rows])
    p = np.array([fit(row.features) for row in rows])
    bins = np.array_split(np.argsort(p), 10)
    level = TrackerConfig().tracking_quality
    return {
        "rows": len(rows),
        "right_percent": 100.0 * float(right.mean()),
        "log_likelihood": float(np.log(np.where(right, p, 1.0 - p) + 1e-9).mean()),
        "calibration_error": float(np.mean([abs(p[b].mean() - right[b].mean()) for b in bins])),
        "right_under_percent": 100.0 * float((p[right] < level).mean()),
        "wrong_over_percent": 100.0 * float((p[~right] >= level).mean()),
    }


if __name__ == "__main__":
    main()
