"""A camera on a hand moves fast over a heap of static objects: what does the tracker gain if the camera pose
is given?

    .venv/bin/python -m studies.on_hand --bundles DIR --json OUT.json [--search]

Each film is rendered once and kept: 2 s at 30 Hz, up to 0.8 m/s and 90 degrees a second. All objects start at
their true poses; then the tracker is alone, with the profile `live`. The camera pose (`--told`) is: `not`
given and not measured; not given, but `measured` by odometry; given `exactly`; `noisy` (0.5 mm and 0.09
degrees per axis); `late` by 15 ms; `misfixed` (the camera is 2.7 cm and 5.4 degrees away from the given
pose); completely wrong (the `inverse` of the pose).

With `--search` there is no first pose: live perception searches for all objects of the bundles, and its
answers come with the latency of perception. Each film is played forwards and backwards, 4 s, all frames.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from huepose.believe.state import State
from huepose.datasets.types import VISIBLE
from huepose.evaluation import metrics
from huepose.evaluation.result_files import write_json
from huepose.geometry import RgbdFrame, se3
from huepose.geometry.arrays import Float64, Rng
from huepose.model import ReferenceModel, load_models
from huepose.profiles import profile
from huepose.reinit.loop import ReinitLoop
from huepose.reinit.types import ObjectSlot
from huepose.scenes.camera import COLOR, STEREO
from huepose.scenes.frame import Shot, Stage, shoot
from huepose.scenes.loop_file import Loop, kept_loop
from huepose.scenes.motion import positions
from huepose.scenes.rendered import SceneRanges, heaped_stage
from huepose.support.files import cache_folder
from huepose.support.progress import progress
from huepose.tracking import Correction, Tracker, TrackerConfig
from studies.live import NOWHERE, Sight
from studies.stress.films import Seen
from studies.stress.play import error_of, followed

VERSION = 2  # increase it if a pixel or the truth changes
FRAMES, HZ = 60, 30
LATE_S = 0.015
"""Age of a late camera pose."""

NOISE = np.repeat([0.0005, 0.0015], 3)
"""Standard deviations of a given noisy camera pose: metres and radians along and about each axis."""

MISFIXED = se3.make(se3.rotation_exp(np.radians([3.0, -4.0, 2.0])), np.array([0.02, -0.01, 0.015]))
"""Constant error of the given camera pose: 5.4 degrees and 2.7 cm."""

TOLD = ("not", "exactly", "noisy", "late", "misfixed", "inverse", "measured")
"""How the camera pose is given: see above."""


@dataclass(frozen=True)
class Row:
    """Result of one film at every `every`-th frame, with the camera pose given as `told`. Counts over frames
    and objects: visible by 30 %; of these TRACKING and right; TRACKING and wrong."""

    film: int
    every: int
    told: str
    visible: int
    right: int
    wrong: int


@dataclass(frozen=True)
class Found:
    """Result of an object that is visible by 30 % for a second or more of a film. after_s: for how long it
    was visible until it was TRACKING and right, None if it never was; visible, right, wrong: as in `Row`."""

    film: int
    told: str
    object: str
    after_s: float | None
    visible: int
    right: int
    wrong: int


Film = tuple[tuple[str, ...], Stage, Loop, list[dict[str, Any]]]
"""The names of the objects, the stage, the images and the truth."""


def rendered(models: Mapping[str, ReferenceModel], seed: int, number: int) -> Film:
    """Film `number` of a seed, from disk if it was rendered before."""
    heap, names, rng, _ = heaped_stage({n: m.mesh for n, m in models.items()}, seed, number, SceneRanges())
    stage = Stage(
        heap.meshes,
        heap.labelled,
        np.repeat(heap.T_room_mesh[:, 1:2], FRAMES, axis=1),
        hand(rng) @ heap.T_cam_room[1],
        heap.lights[:1] * FRAMES,
        heap.camera,
    )

    shots = (shoot(stage, i, seed * 1000 + number, COLOR, STEREO) for i in range(FRAMES))
    meshes = sha256(b"".join(models[name].mesh.content() for name in sorted(models))).hexdigest()[:8]
    path = cache_folder() / "on_hand" / f"{seed}-{number:03d}-{meshes}-{VERSION}.loop"
    loop, truth = kept_loop(path, lambda: map(Shot.kept, shots))
    return names, stage, loop, truth


def hand(rng: Rng) -> Float64:
    """Poses (FRAMES, 4, 4) of a hand that moves to and fro, relative to its mean pose."""
    phase = np.linspace(0.0, 1.0, FRAMES, endpoint=False)
    shifts, rotations = (positions(rng.normal(0.0, 1.0, (5, 3)), phase) for _ in range(2))
    for path, fastest in ((shifts, rng.uniform(0.4, 0.8)), (rotations, np.radians(rng.uniform(40.0, 90.0)))):
        path -= path.mean(0)
        path *= fastest / (HZ * np.linalg.norm(np.diff(path, axis=0), axis=1).max())
    return np.array([se3.make(se3.rotation_exp(w), p) for w, p in zip(rotations, shifts, strict=True)])


def given_pose(told: str, stage: Stage, i: int, rng: Rng) -> Float64 | None:
    """The camera pose that is given with frame i, T_room_cam (4, 4); None if none is given."""
    T = se3.inverse(stage.T_cam_room[i])
    match told:
        case "exactly":
            return T
        case "noisy":
            return se3.perturb(T, rng.normal(0.0, NOISE))
        case "late":
            before = se3.inverse(stage.T_cam_room[max(i - 1, 0)])
            return se3.interpolate(before, T, 1.0 - LATE_S * HZ)
        case "misfixed":
            return T @ MISFIXED
        case "inverse":
            return se3.inverse(T)
    return None


def _config(told: str) -> TrackerConfig:
    return replace(profile("live").tracker, odometry=told == "measured")


def _frame(film: Film, i: int, number: int, told: str, rng: Rng) -> RgbdFrame:
    """Image i of a film as frame `number`, with the camera pose given as `told`."""
    _, stage, loop, _ = film
    T_parent_cam, stamp_ns = given_pose(told, stage, i, rng), round(number * 1e9 / HZ)
    return RgbdFrame(loop.color(i), loop.depth(i), stage.camera, number, stamp_ns, 1, T_parent_cam)


def played(
    models: Mapping[str, ReferenceModel], film: Film, number: int, every: int, told: str, rng: Rng
) -> Row:
    """The result of one film that is tracked from the true poses of its first frame."""
    names, _, _, truth = film
    tracker = Tracker({name: models[name] for name in names}, _config(told))
    visible = right = wrong = 0
    for i in range(0, FRAMES, every):
        frame = _frame(film, i, i, told, rng)
        poses = dict(zip(names, np.array(truth[i]["T_cam_obj"]), strict=True))
        share = dict(zip(names, truth[i]["visib_fract"], strict=True))
        for name in names if i == 0 else ():
            if share[name] >= VISIBLE:
                tracker.correct(Correction.first(name, poses[name], frame, 1.0))
        for pose in tracker.step(frame):
            error = error_of(models[pose.object], pose.T_cam_obj, poses[pose.object])
            fits, known = error < metrics.RECALL_FRACTION, pose.state is State.TRACKING
            visible += i > 0 and share[pose.object] >= VISIBLE
            right += i > 0 and share[pose.object] >= VISIBLE and known and fits
            wrong += i > 0 and known and not fits
    return Row(number, every, told, visible, right, wrong)


def searched(
    models: Mapping[str, ReferenceModel], film: Film, number: int, told: str, rng: Rng
) -> Iterator[Found]:
    """The results of the objects of one film without first poses: all models are searched for."""
    names, _, _, truth = film
    order = [*range(FRAMES), *reversed(range(FRAMES))]
    tracker = Tracker(models, _config(told))
    reinit = ReinitLoop(objects=[ObjectSlot.of(model) for model in models.values()])
    films = (Seen(_frame(film, i, k, told, rng), NOWHERE, 1.0) for k, i in enumerate(order))
    states: dict[str, list[tuple[bool, bool, bool]]] = {name: [] for name in names}
    for i, (_, poses) in zip(order, followed(films, tracker, reinit, Sight(*models.values())), strict=True):
        of = {pose.object: pose for pose in poses if pose.state is State.TRACKING}
        for name, T, share in zip(
            names, np.array(truth[i]["T_cam_obj"]), truth[i]["visib_fract"], strict=True
        ):
            error = error_of(models[name], of[name].T_cam_obj, T) if name in of else np.inf
            right = error < metrics.RECALL_FRACTION
            states[name].append((share >= VISIBLE, right, name in of and not right))
    for name, of_frames in states.items():
        visible, right, wrong = np.array(of_frames).T
        if visible.sum() >= HZ:
            good = np.flatnonzero(right[visible])
            after_s = float(good[0] + 1) / HZ if len(good) else None
            sums = (int(x.sum()) for x in (visible, visible & right, wrong))
            yield Found(number, told, name, after_s, *sums)


def rows(given: argparse.Namespace) -> Iterator[Row | Found]:
    """The results of all films, at each rate, with the camera pose given in each way."""
    models = load_models(given.bundles)
    for number in progress(range(given.films), "films"):
        film = rendered(models, given.seed, number)
        for every, told in product([1] if given.search else given.every, given.told):
            rng = np.random.default_rng([given.seed, number])
            if given.search:
                yield from searched(models, film, number, told, rng)
            else:
                yield played(models, film, number, every, told, rng)


def _found_line(told: str, some: list[Found]) -> str:
    """The results of all objects with the camera pose given as `told`, as one line."""
    times = [one.after_s for one in some if one.after_s is not None]
    soon = ", ".join(f"{sum(t <= s for t in times)} in {s} s" for s in (1, 2, 4))
    sums = [sum(getattr(one, name) for one in some) for name in ("right", "visible", "wrong")]
    return f"{told}: {soon} of {len(some)}; right in {sums[0]} of {sums[1]} frames, wrong in {sums[2]}"


def main() -> None:
    """Play the films, and print the results."""
    what = __doc__
    parser = argparse.ArgumentParser(description=what, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bundles", type=Path, required=True)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--films", type=int, default=8)
    parser.add_argument("--seed", type=int, default=901)
    parser.add_argument("--every", type=int, nargs="+", default=[1, 3, 5, 10])
    parser.add_argument("--told", nargs="+", choices=TOLD, default=TOLD)
    parser.add_argument("--search", action="store_true", help="without first poses, by live perception")
    given = parser.parse_args()
    done: list[Row | Found] = []
    for row in rows(given):
        done.append(row)
        write_json(given.json, {"rows": [vars(one) for one in done]})
    if given.search:
        found = [row for row in done if isinstance(row, Found)]
        for told in given.told:
            print(_found_line(told, [one for one in found if one.told == told]))
        return
    print("every camera    visible right wrong")
    for every, told in product(given.every, given.told):
        some = [row for row in done if isinstance(row, Row) and (row.every, row.told) == (every, told)]
        sums = [sum(getattr(row, name) for row in some) for name in ("visible", "right", "wrong")]
        print(f"{every:5d} {told:9s} {sums[0]:7d} {sums[1]:5d} {sums[2]:5d}")


if __name__ == "__main__":
    main()
