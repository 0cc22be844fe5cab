"""Meshes from drawn recordings of objects that are turned, held against the true ones.

    python -m studies.turned --out OUT
    python -m studies.turned --out OUT --only tea_box_held
    python -m studies.turned --out OUT --video VIDEO --mesh MESH.obj --box X Y W H

Without a video: a box turns once on a turntable (`tea_box`); it is turned in the hand, by a finger, a thumb
and a palm that grip elsewhere half way (`tea_box_held`); a bottle is turned by two fingers (`juice_bottle`).
Depth is as an active stereo camera gives it. Printed of each: how far the mesh lies from the true one where
it was seen, and the AUC of tracking with either: in drawn frames in which a fast hand carries the object, or
in the video itself, whose labels must name one object.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from huepose.datasets.bop import BopScene
from huepose.datasets.bop_writer import BopWriter, Label
from huepose.evaluation.sources import TruthSource
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_protocol import SourceNames, Sources, TrackOptions, evaluate_tracking
from huepose.geometry import Box, Mesh, RgbdFrame, se3
from huepose.geometry.arrays import Float, Float64, Rng
from huepose.model import ReferenceModel
from huepose.onboarding import onboard_mesh, read_mesh
from huepose.onboarding.from_video import Learned, Selection, learn
from huepose.scenes import carried, textures
from huepose.scenes.camera import COLOR, STEREO
from huepose.scenes.frame import Stage, shoot, silhouette
from huepose.scenes.light import random_light
from huepose.scenes.motion import UP_ROOM, upright
from huepose.scenes.room import sheet, table_top, wallpaper
from huepose.scenes.shapes import demo_objects, printed
from huepose.scenes.unseen.objects import rod
from huepose.support.progress import progress
from huepose.tracking import Correction, State, Tracker

CAMERA = carried.CAMERA
MIDDLE_CAM = np.array([0.0, 0.0, 0.55])
ID = 1


def main() -> None:
    """Draw what is not there yet, make the meshes, and compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(TURNING), help="one of what is drawn")
    parser.add_argument("--video", type=Path, help="a BOP scene")
    parser.add_argument("--mesh", type=Path, help="the object's true mesh, millimetres")
    parser.add_argument("--box", type=float, nargs=4, help="the object in the video's first frame")
    arguments = parser.parse_args()
    if arguments.video is not None:
        scene = BopScene(arguments.video)
        compare(
            arguments.video.name,
            read_mesh(arguments.mesh, "mm"),
            scene,
            Selection(Box(*arguments.box)),
            scene,
        )
        return
    meshes = demo_objects(arguments.seed)
    for case in TURNING if arguments.only is None else [arguments.only]:
        name, turning = TURNING[case]
        rng = np.random.default_rng([arguments.seed, len(name)])
        folder, mesh = arguments.out / case, meshes[name]
        recorded = drawn(folder / "turned", turning(mesh, rng), arguments.seed)
        others = [other for key, other in meshes.items() if key != name]
        moving = drawn(folder / "carried", carried.staged(mesh, others, rng), arguments.seed)
        box = recorded.truths(recorded.image_ids[0])[0].box_visib
        assert box is not None  # it is in view
        compare(case, mesh, recorded, Selection(box.grown(0.05)), moving)


def turntable(mesh: Mesh, rng: Rng, frames: int = 120) -> Stage:
    """Once round on a table, in steps of three degrees."""
    place = MIDDLE_CAM - mesh.centre[2] * UP_ROOM
    angles = np.arange(frames) * 2 * np.pi / frames
    path = np.array([se3.make(upright(angle), place) for angle in angles])
    table = se3.make(upright(0.0), place + float(mesh.vertices[:, 2].min()) * UP_ROOM)
    return _stage([(mesh, path), (sheet(1.2, 1.0, table_top(rng)), _still(table, frames))], rng)


def by_hand(mesh: Mesh, rng: Rng) -> Stage:
    """Between two fingers that grip at other sides half way."""
    finger = _skin(0.08, 0.009, rng)
    reach = np.ptp(mesh.vertices, axis=0)[0] / 2 + 0.008
    grips = [(_grip(side, reach), _grip(side + np.pi / 2, reach)) for side in (0.0, np.pi)]
    return _in_hand(mesh, 200, [(finger, both) for both in grips], rng)


def held(mesh: Mesh, rng: Rng) -> Stage:
    """Between a finger and a thumb, with the palm at a third side; all three grip a quarter turn farther on
    half way."""
    half = np.ptp(mesh.vertices, axis=0)[:2] / 2
    parts = []
    for angle, length, radius in ((0.0, 0.10, 0.02), (np.pi, 0.09, 0.018), (np.pi / 2 + 0.5, 0.12, 0.042)):
        sides = [angle, angle + np.pi / 2]
        reaches = [np.abs([np.cos(a), np.sin(a)]) @ half + 0.9 * radius for a in sides]
        first, second = (_grip(a, reach) for a, reach in zip(sides, reaches, strict=True))
        parts.append((_skin(length, radius, rng), (first, second)))
    return _in_hand(mesh, 120, parts, rng)


def _in_hand(
    mesh: Mesh, frames: int, parts: Sequence[tuple[Mesh, tuple[Float64, Float64]]], rng: Rng
) -> Stage:
    """Once round and nodding, before a wall. parts: of the hand, each with where it grips before and after
    half way (4, 4)."""
    share = np.arange(frames) / frames
    nods = [se3.rotation_exp(np.array([1.2 * np.sin(2 * np.pi * s), 0, 0])) for s in share]
    path = np.array(
        [se3.make(R @ upright(2 * np.pi * s), MIDDLE_CAM) for R, s in zip(nods, share, strict=True)]
    )
    scene = [(mesh, path)]
    for part, grips in parts:
        scene.append((part, np.array([T @ grips[int(2 * s)] for T, s in zip(path, share, strict=True)])))
    wall = se3.make(np.diag([1.0, -1.0, -1.0]), np.array([0, 0, 1.3]))
    scene.append((sheet(2.6, 2.2, wallpaper(rng)), _still(wall, frames)))
    return _stage(scene, rng)


TURNING = {
    "tea_box": ("tea_box", turntable),
    "tea_box_held": ("tea_box", held),
    "juice_bottle": ("juice_bottle", by_hand),
}
"""What is drawn: the object, and how it is turned."""


def _skin(length: float, radius: float, rng: Rng) -> Mesh:
    """A part of a hand: a plain rod with round ends, along z."""
    charts = rod((0, 0, 0), (0, 0, length), radius)
    return printed(charts, [_plain] * len(charts), textures.palette(0.07, rng), rng, 64)


def _grip(angle: float, reach: float) -> Float64:
    """A finger that points at the object's axis from a side."""
    out = np.array([np.cos(angle), np.sin(angle), 0.0])
    return se3.make(np.stack([[0, 0, 1.0], np.cross(out, [0, 0, 1.0]), out], 1), reach * out)


def _plain(rng: Rng, height: int, width: int, p: textures.Palette) -> np.ndarray:
    return np.full((height, width, 3), (205, 160, 135), np.uint8)


def _still(T: Float64, frames: int) -> Float64:
    return np.asarray(np.broadcast_to(T, (frames, 4, 4)))


def _stage(scene: list[tuple[Mesh, Float64]], rng: Rng) -> Stage:
    meshes, paths = zip(*scene, strict=True)
    n = len(paths[0])
    return Stage(meshes, 1, np.array(paths), np.tile(np.eye(4), (n, 1, 1)), (random_light(rng),) * n, CAMERA)


def drawn(folder: Path, stage: Stage, seed: int) -> BopScene:
    """A stage as a BOP scene; frames that are there are kept."""
    writer = BopWriter(folder, {"seed": seed, "frames": len(stage)})
    for i in progress(sorted(set(range(len(stage))) - writer.done), f"drawing {folder}"):
        shot = shoot(stage, i, seed, COLOR, STEREO)
        T = shot.labels.T_cam_obj[0]
        label = Label(ID, T, shot.owner == 0, *silhouette(stage.meshes[0], T, CAMERA))
        writer.add(i, shot.color, shot.depth, CAMERA, [label])
    return BopScene(folder)


def compare(name: str, true: Mesh, recorded: BopScene, selection: Selection, moving: BopScene) -> None:
    """Make a mesh of a recording and print what it is worth."""

    def frames() -> Iterator[RgbdFrame]:
        yield from (recorded.frame(i) for i in progress(recorded.image_ids, f"learning {name}"))

    made = learn(frames(), selection)
    object_id = recorded.truths(recorded.image_ids[0])[0].object_id
    model = onboard_mesh(true, "object", object_id=object_id)
    T_true_made = aligned(made, model, recorded)
    points = made.mesh.vertices[made.seen].astype(np.float64)
    moved = replace(made.mesh, vertices=se3.apply(T_true_made, made.mesh.vertices).astype(np.float32))
    errors = np.median([_error(made, n, T_true_made, recorded) for n in made.T_cam_obj], axis=0)
    closing = "-" if made.closing_m is None else f"{1000 * made.closing_m:.1f} mm"
    print(
        f"{name}: followed in {len(made.T_cam_obj)} of {made.frames} frames, {made.views} views, "
        f"{100 * made.directions:.0f} % of directions, {100 * made.surface:.0f} % of the surface, closing "
        f"error {closing}\n"
        f"  off the true surface, mean and 90 %: {_off(se3.apply(T_true_made, points), true)} where it was "
        f"seen, {_off(se3.apply(_fitted(T_true_made, points, true), points), true)} at the best fit; the "
        f"true one off the whole made one: {_off(true.vertices, moved)}\n"
        f"  its poses while it was made: {errors[0]:.2f} mm, {errors[1]:.2f} degrees (medians)",
        flush=True,
    )
    models = {"true": model, "made": onboard_mesh(moved, "object", object_id=object_id)}
    start, options, names = Sources(TruthSource()), TrackOptions(), SourceNames("gt")
    figures = {}
    for kind, of in models.items():
        # Errors are of the true mesh's points, whichever is tracked.
        targets = Targets({of.name: replace(of, eval_points=model.eval_points)})
        result = evaluate_tracking([moving], targets, Tracker, lambda scene, seed: start, options, names)
        summary = result.as_json()["summary"]
        figures[kind] = summary["auc_add"], summary["auc_adds"]
        print(
            f"  tracked with the {kind} mesh: AUC ADD {summary['auc_add']:.1f}, "
            f"ADD-S {summary['auc_adds']:.1f}; TRACKING {summary['coverage_tracking']:.1f} %, "
            f"false in {summary['false_tracking_frames']}",
            flush=True,
        )
    shares = [100 * a / b for a, b in zip(figures["made"], figures["true"], strict=True)]
    print(f"  made in percent of true: ADD {shares[0]:.1f}, ADD-S {shares[1]:.1f}", flush=True)


def aligned(made: Learned, model: ReferenceModel, recorded: BopScene) -> Float64:
    """T_true_made by the tracker's poses with the true mesh: no label but the first one counts."""
    tracker, first = Tracker({model.name: model}), recorded.truths(recorded.image_ids[0])[0].T_cam_obj
    assert first is not None
    tracker.correct(Correction.first(model.name, first, recorded.frame(recorded.image_ids[0])))
    found = []
    for number, image in enumerate(recorded.image_ids):
        (pose,) = tracker.step(recorded.frame(image))
        if number in made.T_cam_obj and pose.T_cam_obj is not None and pose.state is State.TRACKING:
            found.append(se3.inverse(pose.T_cam_obj) @ made.T_cam_obj[number])
    apart = np.array([[se3.rotation_angle(a[:3, :3], b[:3, :3]) for a in found] for b in found])
    middle = found[int(np.argmin(np.median(apart, axis=0)))]
    near = [T for T in found if se3.rotation_angle(T[:3, :3], middle[:3, :3]) < 0.1]
    return se3.make(
        Rotation.from_matrix([T[:3, :3] for T in near]).mean().as_matrix(),
        np.median([T[:3, 3] for T in near], axis=0),
    )


def _fitted(T_true_made: Float64, points: Float64, true: Mesh) -> Float64:
    """T_true_made such that points (N, 3) lie on the true surface."""
    T = T_true_made
    for _ in range(40):
        p = se3.apply(T, points)
        q, n = _closest(p, true)
        near = np.linalg.norm(p - q, axis=1) < 0.01
        J = np.concatenate([n, np.cross(p, n)], 1)[near]
        x = np.linalg.lstsq(J, -((p - q) * n).sum(1)[near], rcond=None)[0]
        T = se3.orthonormalised(se3.make(se3.rotation_exp(x[3:]), x[:3]) @ T)
    return T


def _off(points: Float, mesh: Mesh) -> str:
    """Distances of points (N, 3) from a surface, in words."""
    off_mm = 1000 * np.linalg.norm(points - _closest(points, mesh)[0], axis=1)
    return f"{off_mm.mean():.2f} and {np.percentile(off_mm, 90):.2f} mm"


def _closest(points: Float, mesh: Mesh) -> tuple[Float64, Float64]:
    """The nearest places (N, 3) of a surface, and its normals there."""
    import open3d as o3d

    tensor = o3d.core.Tensor.from_numpy
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(tensor(mesh.vertices), tensor(mesh.faces.astype(np.uint32)))
    found = scene.compute_closest_points(tensor(np.asarray(points, np.float32)))
    return found["points"].numpy().astype(np.float64), found["primitive_normals"].numpy().astype(np.float64)


def _error(made: Learned, number: int, T_true_made: Float64, recorded: BopScene) -> tuple[float, float]:
    label = recorded.truths(recorded.image_ids[number])[0].T_cam_obj
    assert label is not None
    T = made.T_cam_obj[number] @ se3.inverse(T_true_made)
    shift = np.linalg.norm(T[:3, 3] - label[:3, 3])
    return 1000 * float(shift), float(np.degrees(se3.rotation_angle(T[:3, :3], label[:3, :3])))


if __name__ == "__main__":
    main()
