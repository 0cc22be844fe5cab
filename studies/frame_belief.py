"""Fit the probability that a tracked pose is right in one frame (`believe.frame`), from right and wrong poses
that tracking reaches on the films of `studies.stress`.

    python -m studies.frame_belief --bundles BUNDLES --json out.json --processes 2

The fit is made on the split `fit` and checked on `choose`. Each has films of hard objects, of random
household objects (bowls, mugs, tools, fruit, packages; most of them with few colours) and of the reference
models in BUNDLES. In every eighth frame poses are tracked from 1 to 15 frames before, and refined from wrong
positions and rotations and from other places in the image, also if the object is gone or swapped for its
look-alike. Each result is right or wrong by its error, whatever its start. Poses that are right except for a
near-symmetric rotation are left out: `tracking.orientation` decides those, not a single frame. `--write`
writes the fit into the package."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from huepose.believe.frame import features
from huepose.believe.logistic import Logistic, belief, write_fit
from huepose.evaluation import metrics
from huepose.evaluation.result_files import write_json
from huepose.geometry import RgbdFrame, se3
from huepose.geometry.arrays import Bool, Float64
from huepose.judge.borders import continued
from huepose.judge.terms import NOTHING
from huepose.model import ReferenceModel
from huepose.support.progress import progress
from huepose.tracking import TrackerConfig
from huepose.tracking.hypothesis import Anchor, Hypothesis
from huepose.tracking.motion import increment_velocity
from huepose.tracking.refined import best_of
from huepose.tracking.step import advance
from huepose.tracking.subject import Subject
from huepose.tracking.usual import Usual
from studies.likelihood import logistic
from studies.stress.causes import on_a_surface
from studies.stress.play import error_of
from studies.stress.playing import Job, film_of

EVERY = 8
NEAR, FAR = (3, 5, 7), (10, 15)
"""Steps in frames, besides one."""

KNOWN = 0.8
"""Share of the poses for which the usual total and the light are known."""

FAR_OFF = 99.0
"""Largest error, in diameters, and the error of an object that is not there."""


@dataclass(frozen=True)
class Row:
    """A pose that was reached: from what start (`kind`), its features, its error in diameters, and the error
    up to a near-symmetric rotation."""

    sequence: str
    frame: int
    kind: str
    source: str
    features: Mapping[str, float]
    error: float
    turned_error: float

    @property
    def right(self) -> bool:
        """Error under a tenth of the diameter."""
        return self.error < metrics.RECALL_FRACTION

    @property
    def group(self) -> str:
        """Right, or one of three ways to be wrong, which have equal weight in the fit."""
        if self.right:
            return "right"
        if not self.kind.startswith("step"):
            return "wrong start"
        return "gone" if self.error == FAR_OFF else "followed"

    @property
    def counts(self) -> bool:
        """Whether the row enters the fit: not if only the near-symmetric rotation is wrong."""
        return self.right or self.turned_error >= metrics.RECALL_FRACTION


def main() -> None:
    """Collect, fit, report on both splits."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bundles", type=Path, required=True)
    parser.add_argument(
        "--films", type=int, nargs=3, default=(15, 24, 8), help="of hard, of household objects, of BUNDLES"
    )
    parser.add_argument("--only", nargs="+", default=[], help="features to fit; the others stay as they are")
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    parts = {}
    with ProcessPoolExecutor(arguments.processes) as pool:
        for split in ("fit", "choose"):
            kinds = zip(("builtin", "household", arguments.bundles), arguments.films, strict=True)
            jobs = [Job(split, n, objects, None, ()) for objects, count in kinds for n in range(count)]
            collected = progress(pool.map(collect, jobs), split, len(jobs))
            parts[split] = [row for rows in collected for row in rows if row.counts]
    fit = fitted(parts["fit"], arguments.only)
    report = {name: worth(rows, fit) for name, rows in parts.items()}
    factors = {k: round(v, 3) for k, v in fit.factors.items() if v > 0}
    entry = {"constant": round(fit.constant, 3), "factors": factors}
    rows = {name: [asdict(row) for row in rows] for name, rows in parts.items()}
    write_json(arguments.json, {"fit": entry, "report": report, "rows": rows})
    if arguments.write:
        write_fit("frame", entry)
    print(json.dumps({"fit": entry, "report": report}, indent=1))


def collect(job: Job) -> list[Row]:
    """The rows of every EVERY-th frame of a film."""
    film, models = film_of(job)
    if film is None:
        return []
    model = models[film.object]
    subject, rng = Subject.of(model), np.random.default_rng([job.number, *film.name.encode()])
    frames, visible = [s.frame for s in film.frames], [s.visib_fract for s in film.frames]
    truth = [s.T_cam_obj for s in film.frames]
    known, rows = Usual(), []
    for i in range(2, len(frames), EVERY):
        gone = visible[i] < 0.1
        found: list[tuple[str, Usual, Hypothesis]] = []
        if not gone and visible[i - 1] >= 0.1:
            before = best_of(subject.surface, frames[i - 1], [(truth[i - 1], "still")], known.light)
            if error_of(model, before.T_cam_obj, truth[i - 1]) < metrics.RECALL_FRACTION:
                known = known.after(before.terms)
        shown = max((k for k in range(i) if visible[k] >= 0.1), default=0)
        # An object that is gone was tracked until it left: its look-alike or an occluder is there now.
        steps = (i - shown,) if gone else (1, int(rng.choice(NEAR)), int(rng.choice(FAR)))
        for step in steps:
            if step > max(FAR) or i - step < 1 or visible[i - step] < 0.1:
                continue
            usual = Usual()
            if rng.random() < KNOWN:
                # The usual total is a mean over frames before: about the total just before the step.
                start = best_of(subject.surface, frames[i - step], [(truth[i - step], "still")], known.light)
                usual = Usual(start.terms.total, known.light)
            velocity = increment_velocity(subject.surface, truth[i - step - 1], truth[i - step], 1 / 30)
            start = Hypothesis(truth[i - step], NOTHING, np.zeros((6, 6)), "still", velocity)
            anchor = Anchor((start,), frames[i - step], usual)
            reached = advance(subject, anchor, frames[i], TrackerConfig())
            found += [(f"step {step}", usual, h) for h in (*reached.followed, *reached.proposed)]
        # If the object is gone, all poses are wrong: they start around its first pose.
        at = truth[i] if not gone else truth[0]
        for kind, T in wrong_starts(model, at, frames[i], rng):
            usual = known if rng.random() < KNOWN else Usual()
            found.append((kind, usual, best_of(subject.surface, frames[i], [(T, "still")], usual.light)))
        for kind, usual, h in found:
            error = turned_error = FAR_OFF
            if not gone:
                error, turned_error = (
                    min(error_of(model, h.T_cam_obj, truth[i], rotations), FAR_OFF)
                    for rotations in (model.equivalents, model.near_symmetries)
                )
            goes_on = continued(subject.contours, h.T_cam_obj, frames[i])
            named = features(h.terms, usual.baseline, goes_on, usual.light)
            rows.append(Row(film.name, i, kind, h.source, named, error, turned_error))
    return rows


def wrong_starts(
    model: ReferenceModel, T_cam_obj: Float64, frame: RgbdFrame, rng: np.random.Generator
) -> list[tuple[str, Float64]]:
    """Poses that are shifted and rotated, near-symmetrically rotated, and elsewhere in the image."""
    centre = T_cam_obj[:3, :3] @ model.mesh.centre + T_cam_obj[:3, 3]

    def at(rotation: Float64, position: Float64) -> Float64:
        R = se3.rotation_exp(rotation) @ T_cam_obj[:3, :3]
        return se3.make(R, position - R @ model.mesh.centre)

    out = []
    for _ in range(2):
        axis = rng.normal(size=3)
        rotation = axis / np.linalg.norm(axis) * rng.uniform(0.3, np.pi)
        shift = rng.normal(0, 0.5 * model.diameter_m, 3) * (1, 1, 0.5)
        out.append(("shifted", at(rotation, centre + shift)))
    if len(model.near_symmetries) > 1:
        out.append(
            (
                "turned over",
                T_cam_obj @ model.near_symmetries[1 + int(rng.integers(len(model.near_symmetries) - 1))],
            )
        )
    if (frame.depth > 0.3).any():
        position = on_a_surface(frame, rng)
        out.append(("elsewhere", at(rng.normal(0, 1.5, 3), position)))
    return out


def _table(rows: Sequence[Row]) -> tuple[list[str], Float64, Bool]:
    names = list(rows[0].features)
    X = np.array([[row.features[name] for name in names] for row in rows])
    return names, X, np.array([row.right for row in rows])


def fitted(rows: Sequence[Row], only: Sequence[str] = ()) -> Logistic:
    """The maximum-likelihood fit; right and wrong poses have equal total weight, and so have the three groups
    of wrong ones. only: features whose factors are fitted, while the package's other factors stay; the
    constant may then only decrease."""
    names, X, right = _table(rows)
    groups = [row.group for row in rows]
    share = {name: (3.0 if name == "right" else 1.0) / 6.0 / groups.count(name) for name in set(groups)}
    weight = len(rows) * np.array([share[name] for name in groups])
    if not only:
        return logistic(X, right, weight, names)
    kept = belief("frame")
    kept = Logistic(kept.constant, {k: f for k, f in kept.factors.items() if k not in only})
    known = np.array([kept.log_odds(row.features) for row in rows])
    new = logistic(X[:, [names.index(name) for name in only]], right, weight, only, known)
    return Logistic(kept.constant + min(new.constant, 0.0), {**kept.factors, **new.factors})


def worth(rows: Sequence[Row], fit: Logistic) -> dict[str, float]:
    """Quality of a fit on rows: mean log likelihood, calibration error over ten bins of equal count, share of
    the right poses under and of the wrong ones over the level of TRACKING, percent."""
    right = np.array([row.right for row in rows])
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
