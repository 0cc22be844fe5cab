"""The reference model of a label, and the error of a pose against that label.

If the texture contradicts or cannot confirm a label, other poses can be declared right, too (`--equivalent`):
`{"SCENE/IMAGE/INSTANCE": {"T_obj_obj": [4x4, ...]}}`, metres; the labelled pose times each counts as right.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from huepose.datasets import files
from huepose.datasets.types import GroundTruth
from huepose.datasets.ycb_objects import ycb_named
from huepose.evaluation import metrics
from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64
from huepose.model.types import ReferenceModel
from huepose.support.errors import InputError


@dataclass(frozen=True)
class PoseError:
    """Errors of a pose against a label, metres; inf without a pose.

    add_m: ADD to the nearest of the labelled pose and the declared ones; official_add_m: ADD to the labelled
    pose; adds_m: ADD-S; right: ADD under a tenth of the diameter to any of these poses or to one of its
    equivalent rotations."""

    add_m: float
    adds_m: float
    official_add_m: float
    right: bool

    @staticmethod
    def missing() -> PoseError:
        """The errors of a missing pose."""
        return PoseError(np.inf, np.inf, np.inf, False)


class Targets:
    """The reference models of an evaluation, found by BOP id or name; errors are measured here."""

    def __init__(
        self, models: Mapping[str, ReferenceModel], objects: Sequence[str | int] | None = None
    ) -> None:
        """objects: ids or names to which the evaluation is limited. Raises InputError for an unknown name."""
        self._by_name = dict(models)
        self._by_id = {m.object_id: m for m in models.values() if m.object_id is not None}
        self._trees: dict[str, cKDTree] = {}
        self._wanted = None if objects is None else {self._checked(o) for o in objects}

    def _checked(self, wanted: str | int) -> str | int:
        text = str(wanted)
        if text.isdigit():
            return int(text)
        if text not in self._by_name:
            raise InputError(
                f"object '{text}'",
                found="no reference model of that name",
                expected=f"an id or one of {', '.join(sorted(self._by_name)) or 'none'}",
            )
        return text

    def wants(self, truth: GroundTruth) -> bool:
        """Whether this label is to be evaluated; it may have no reference model."""
        if self._wanted is None:
            return True
        model = self.model_of(truth)
        names = {truth.object_id, truth.object} | ({model.object_id, model.name} if model else set())
        return bool((names - {None}) & self._wanted)

    def model_of(self, truth: GroundTruth) -> ReferenceModel | None:
        """The reference model of a label, by name first; None where there is none."""
        if truth.object is not None and truth.object in self._by_name:
            return self._by_name[truth.object]
        return None if truth.object_id is None else self._by_id.get(truth.object_id)

    def named(self, name_or_id: str | int) -> ReferenceModel | None:
        """The reference model with that name or id."""
        text = str(name_or_id)
        model = self._by_name.get(text)
        return model if model is not None or not text.isdigit() else self._by_id.get(int(text))

    @property
    def models_by_name(self) -> Mapping[str, ReferenceModel]:
        """All reference models."""
        return self._by_name

    @property
    def models(self) -> tuple[ReferenceModel, ...]:
        """The models of the objects to evaluate, by name."""
        chosen = [
            m
            for m in self._by_name.values()
            if self._wanted is None or m.object_id in self._wanted or m.name in self._wanted
        ]
        return tuple(sorted(chosen, key=lambda m: m.name))

    def error(
        self,
        model: ReferenceModel,
        T_estimate: Float | None,
        T_truth: Float,
        equivalents: Iterable[Float64] = (),
    ) -> PoseError:
        """Errors of a pose (4, 4), or of a missing one (None). equivalents: declared `T_obj_obj` (4, 4)."""
        if T_estimate is None:
            return PoseError.missing()
        if model.name not in self._trees:
            self._trees[model.name] = cKDTree(model.eval_points)
        points = model.eval_points
        official = metrics.add(points, T_estimate, T_truth)
        declared = [T_truth @ T for T in equivalents]
        nearest = min([official, *(metrics.add(points, T_estimate, T) for T in declared)])
        right = self.right(model, T_estimate, T_truth, equivalents)
        adds = metrics.adds(points, T_estimate, T_truth, self._trees[model.name])
        return PoseError(nearest, adds, official, right)

    def right(
        self, model: ReferenceModel, T_estimate: Float, T_truth: Float, equivalents: Iterable[Float64] = ()
    ) -> bool:
        """Whether a pose (4, 4) is right, as in PoseError."""
        limit = metrics.RECALL_FRACTION * model.diameter_m
        labelled = [T_truth, *(T_truth @ T for T in equivalents)]
        return any(
            metrics.add(model.eval_points, T_estimate, T @ rotation) < limit
            for T in labelled
            for rotation in model.equivalents
        )


def posecnn_offset_m(model: ReferenceModel) -> Float64 | None:
    """Offset (3,) from the PoseCNN (YCB-Video) frame to the reference model's, added to points: that of the
    model, else that of BOP's mesh of the YCB object of that name; None for other objects."""
    known = ycb_named(model.name)
    if model.frame_offset_m is not None or known is None:
        return model.frame_offset_m
    return known.frame_offset_m


def object_number(model: ReferenceModel) -> int | str:
    """The object's id in results: its BOP id, or its name if it has none."""
    return model.name if model.object_id is None else model.object_id


Key = tuple[str, int, int]


def read_equivalents(path: Path | str) -> dict[Key, tuple[Float64, ...]]:
    """Transforms `T_obj_obj` (4, 4) by (scene, image, instance). Raises InputError, naming the entry."""
    result: dict[Key, tuple[Float64, ...]] = {}
    for key, entry in files.read_json(Path(path)).items():
        where = f"{path}, '{key}'"
        scene, _, rest = key.rpartition("/")[0].rpartition("/")
        parts = [rest, key.rpartition("/")[2]]
        if not scene or not all(part.isdigit() for part in parts):
            raise InputError(where, found="this key", expected="SCENE/IMAGE/INSTANCE, as in '000001/4/2'")
        transforms = files.field(entry, "T_obj_obj", where)
        try:
            array = np.asarray(transforms, dtype=np.float64).reshape(-1, 4, 4)
        except (TypeError, ValueError):
            array = np.full((1, 4, 4), np.nan)
        if not all(se3.is_rigid(T, 1e-3) for T in array):
            raise InputError(where, found="T_obj_obj that is no rigid transform", expected="4x4 matrices")
        result[scene, int(parts[0]), int(parts[1])] = tuple(se3.orthonormalised(T) for T in array)
    return result
