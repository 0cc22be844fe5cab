"""Errors and average recall of the BOP challenge by bop_toolkit's own functions.

Both sides get the same poses, depth images and meshes; our renderer renders the depth of objects for both.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets.bop_detections import BopDetections
from huepose.datasets.types import GroundTruth, Scene
from huepose.datasets.ycbv_folder import TargetImages
from huepose.evaluation.bop_errors import (
    FRACTIONS,
    PIXELS,
    VSD_DELTA_M,
    BopErrors,
    BopObject,
    average_recalls,
)
from huepose.evaluation.estimate_protocol import EstimateOptions, EstimateSetup
from huepose.evaluation.tables.submission import AsGiven
from huepose.evaluation.targets import Targets
from huepose.geometry import Camera, RgbdFrame, se3
from huepose.geometry.arrays import Float64
from huepose.rendering import render_depth

KINDS = ("vsd", "mssd", "mspd")
_SYMMETRY_STEP = 0.01
"""`max_sym_disc_step` of the toolkit's eval_bop19_pose.py."""


class Toolkit:
    """The modules of a checkout of bop_toolkit."""

    def __init__(self, folder: Path) -> None:
        sys.path.insert(0, str(folder))
        try:  # misc first: it and pose_error import each other
            self.misc, self.pose_error, self.pose_matching, self.score = (
                importlib.import_module(f"bop_toolkit_lib.{name}")
                for name in ("misc", "pose_error", "pose_matching", "score")
            )
        finally:
            sys.path.remove(str(folder))


@dataclass(frozen=True, eq=False)
class _Renderer:
    """The renderer interface of the toolkit; millimetres."""

    objects: Mapping[int, BopObject]
    camera: Camera

    def render_object(self, number: int, R: Float64, t: Float64, *_: float) -> dict[str, Any]:
        depth = render_depth(self.objects[number].mesh, se3.make(R, t.ravel() / 1000.0), self.camera)
        return {"depth": 1000.0 * depth}


@dataclass(frozen=True, eq=False)
class Question:
    """scenes: with all labels, named by numbers; wanted: the counted instances of each object in (scene,
    image); objects, infos: the measured objects and the entries of models_info.json (millimetres), by id."""

    scenes: Sequence[Scene]
    wanted: Mapping[tuple[int, int], Mapping[int, int]]
    objects: Mapping[int, BopObject]
    infos: Mapping[str, Any]
    targets: Targets
    poses: BopDetections

    def images(self) -> Iterator[tuple[Scene, int, int, Mapping[int, int]]]:
        """Scene, its number, image, and the wanted instances of objects that can be measured."""
        for scene in self.scenes:
            number = int(scene.name)
            for image in scene.image_ids:
                asked = self.wanted.get((number, image), {})
                asked = {o: n for o, n in asked.items() if o in self.objects}
                if asked:
                    yield scene, number, image, asked


@dataclass(eq=False)
class Comparison:
    """apart: the largest difference between both sides in an error (VSD, MSSD over the diameter, MSPD in
    pixels) over the `measured` poses; ours, theirs: `ar` and its parts, percent."""

    measured: int = 0
    apart: dict[str, float] = field(default_factory=lambda: dict.fromkeys(KINDS, 0.0))
    ours: Mapping[str, float | None] = field(default_factory=dict)
    theirs: Mapping[str, float] = field(default_factory=dict)


def compare(toolkit: Toolkit, question: Question) -> Comparison:
    """Measure the poses on both sides."""
    result = Comparison()
    setup = EstimateSetup(
        question.targets,
        AsGiven(),
        EstimateOptions("file"),
        bop_objects=question.objects,
        given=question.poses,
    )
    own: list[dict[str, Any]] = []
    their = _Theirs(toolkit, question)
    for scene, number, image, asked in question.images():
        frame, labels = scene.frame(image), scene.truths(image)
        rows = setup.image(TargetImages(scene, {image: asked}), image).rows
        for row in rows:
            assert row.bop is not None  # only objects that can be measured are wanted
            own.append(row.bop.as_json())
            if row.T_cam_obj is not None and isinstance(row.object, int):
                errors = their.errors(row.object, row.T_cam_obj, labels[row.instance], frame)
                result.measured += 1
                for kind, difference in _apart(errors, row.bop.errors).items():
                    result.apart[kind] = max(result.apart[kind], difference)
        their.add(number, image, asked, labels, frame)
    result.ours, result.theirs = average_recalls(own), their.average_recalls()
    return result


def _apart(errors: BopErrors, own: BopErrors) -> dict[str, float]:
    return {
        "vsd": float(np.abs(np.subtract(errors.vsd, own.vsd)).max()),
        "mssd": abs(errors.mssd - own.mssd),
        "mspd": abs(errors.mspd_px - own.mspd_px),
    }


class _Theirs:
    """What the toolkit's scripts eval_calc_errors.py and eval_calc_scores.py do, with its functions."""

    def __init__(self, toolkit: Toolkit, question: Question) -> None:
        self.toolkit, self.question = toolkit, question
        self.symmetries = {
            o: toolkit.misc.get_symmetry_transformations(question.infos[str(o)], _SYMMETRY_STEP)
            for o in question.objects
        }
        self.labels: dict[int, dict[int, list[dict[str, Any]]]] = {}
        self.shown: dict[int, dict[int, list[dict[str, Any]]]] = {}
        self.valid: dict[int, dict[int, list[bool]]] = {}
        self.found: dict[int, list[dict[str, Any]]] = {}

    def errors(self, number: int, T: Float64, label: GroundTruth, frame: RgbdFrame) -> BopErrors:
        """Errors of a pose against a label, by the toolkit's functions."""
        assert label.T_cam_obj is not None
        info, measured = self.question.infos[str(number)], self.question.objects[number]
        poses = [x for M in (T, label.T_cam_obj) for x in (M[:3, :3], 1000.0 * M[:3, 3:])]
        camera, points = frame.camera, 1000.0 * measured.mesh.vertices.astype(np.float64)
        K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        lib, turns = self.toolkit.pose_error, self.symmetries[number]
        vsd = lib.vsd(
            *poses,
            1000.0 * frame.depth,
            K,
            1000.0 * VSD_DELTA_M,
            FRACTIONS,
            True,
            info["diameter"],
            _Renderer(self.question.objects, camera),
            number,
        )
        mssd, mspd = lib.mssd(*poses, points, turns), lib.mspd(*poses, K, points, turns)
        return BopErrors(tuple(vsd), mssd / info["diameter"], mspd * 640.0 / camera.width)

    def add(
        self,
        scene: int,
        image: int,
        asked: Mapping[int, int],
        labels: Sequence[GroundTruth],
        frame: RgbdFrame,
    ) -> None:
        """Add an image: its labels, which of them count, and the errors of the most confident poses against
        all labels of their object."""
        left = dict(asked)
        valid = [False] * len(labels)
        for i in sorted(range(len(labels)), key=lambda i: labels[i].visib_fract or 0.0, reverse=True):
            number = labels[i].object_id
            if number is not None and left.get(number, 0) > 0:
                left[number] -= 1
                valid[i] = True
        shown = [{"visib_fract": label.visib_fract or 0.0} for label in labels]
        self.labels.setdefault(scene, {})[image] = [{"obj_id": label.object_id} for label in labels]
        self.shown.setdefault(scene, {})[image] = shown
        self.valid.setdefault(scene, {})[image] = valid
        poses = self.question.poses.by_image.get((scene, image), ())
        for number, count in asked.items():
            own = [(i, p) for i, p in enumerate(poses) if p.object_id == number]
            for i, pose in sorted(own, key=lambda item: item[1].score, reverse=True)[:count]:
                assert pose.T_cam_obj is not None
                errors = {
                    k: self.errors(number, pose.T_cam_obj, label, frame)
                    for k, label in enumerate(labels)
                    if label.object_id == number
                }
                found = {"im_id": image, "obj_id": number, "est_id": i, "score": pose.score, "all": errors}
                self.found.setdefault(scene, []).append(found)

    def average_recalls(self) -> dict[str, float]:
        """As in eval_bop19_pose.py, percent."""
        parts = {
            "ar_vsd": [
                self._recall(lambda e, k=k: e.vsd[k], limit)
                for k in range(len(FRACTIONS))
                for limit in FRACTIONS
            ],
            "ar_mssd": [self._recall(lambda e: e.mssd, limit) for limit in FRACTIONS],
            "ar_mspd": [self._recall(lambda e: e.mspd_px, limit) for limit in PIXELS.astype(float)],
        }
        means = {key: 100.0 * float(np.mean(values)) for key, values in parts.items()}
        return {"ar": float(np.mean(list(means.values()))), **means}

    def _recall(self, value: Any, limit: float) -> float:
        matches = []
        for scene, labels in self.labels.items():
            found = [
                {
                    **{key: f[key] for key in ("im_id", "obj_id", "est_id", "score")},
                    "errors": {k: [value(e)] for k, e in f["all"].items()},
                    "gt_visib_fracts": {k: self.shown[scene][f["im_id"]][k]["visib_fract"] for k in f["all"]},
                }
                for f in self.found.get(scene, [])
            ]
            matches += self.toolkit.pose_matching.match_poses_scene(
                scene, labels, self.shown[scene], self.valid[scene], found, [limit], -1
            )
        ids = {m["obj_id"] for m in matches}
        scores = self.toolkit.score.calc_localization_scores(list(self.labels), ids, matches, -1, False)
        return float(scores["recall"])
