"""The sources of poses that the command line names: labels, our estimates, or files of poses."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

from huepose.datasets.fast_ycb import object_of
from huepose.datasets.ycb_objects import T_posecnn_obj, ycb_named
from huepose.estimation import Estimator, EstimatorConfig
from huepose.evaluation.pose_files import PoseTable, read_dope_poses, read_pose_csv
from huepose.evaluation.sources import EstimatorSource, FileSource, PoseSource, TruthSource
from huepose.evaluation.targets import posecnn_offset_m
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.model import ReferenceModel
from huepose.support.errors import InputError
from huepose.tracking import Tracker, TrackerConfig

_FRAME_OF = {"poses_ycb.txt": "posecnn", "poses.txt": "nvdu"}
"""The model frame of the poses in files of Fast-YCB and ROFT, by file name."""


class PoseSources:
    """The sources of poses by name: `gt`, `estimate`, or a path (one file for all sequences, or a folder).

    Poses in a CSV are in the reference models' own frame. The name of a file of DOPE says which frame."""

    def __init__(self, models: Mapping[str, ReferenceModel], config: EstimatorConfig) -> None:
        self._models, self._config = models, config

    def of(self, name: str, sequence: str, seed: int) -> PoseSource:
        """The source for a sequence. Raises InputError if a file is missing or broken."""
        if name == "gt":
            return TruthSource()
        if name == "estimate":
            return EstimatorSource(self._estimator, seed)
        return FileSource(self._table(Path(name), sequence))

    @cached_property
    def _estimator(self) -> Estimator:
        estimator = Estimator(self._models, self._config)
        estimator.warm_up()
        return estimator

    def _table(self, given: Path, sequence: str) -> PoseTable:
        """The poses of a sequence. Raises InputError that lists where they were looked for."""
        path = self._find(given, sequence)
        ours = path.suffix == ".csv"
        table = read_pose_csv(path) if ours else read_dope_poses(path, object_of(sequence))
        if not ours and path.name not in _FRAME_OF:
            raise InputError(path, found="poses in DOPE's form", expected=f"a name of {', '.join(_FRAME_OF)}")
        shown = {name for model in self._models.values() for name in (model.name, str(model.object_id))}
        if not shown & {name for _, name in table.poses}:
            raise InputError(path, found=f"no pose of {', '.join(self._models)}", fix="Give another file.")
        return table if ours else table.moved(self._T_theirs_obj(_FRAME_OF[path.name], table))

    def _T_theirs_obj(self, frame: str, table: PoseTable) -> dict[str, Float64]:
        """Transforms (4, 4) from the reference model's frame to the table's, by the table's object names."""
        called = {name for _, name in table.poses}
        result: dict[str, Float64] = {}
        for model in self._models.values():
            keys = {model.name, str(model.object_id)} & called
            if keys:
                result |= dict.fromkeys(keys, self._T_frame_obj(frame, model))
        return result

    def _T_frame_obj(self, frame: str, model: ReferenceModel) -> Float64:
        offset_m = posecnn_offset_m(model)
        fix = "Give poses in the reference model's frame, as CSV."
        if offset_m is None:
            raise InputError(f"reference model '{model.name}'", found="no frame offset", fix=fix)
        T_posecnn = T_posecnn_obj(offset_m)
        if frame == "posecnn":
            return T_posecnn
        known = ycb_named(model.name)
        T_nvdu = None if known is None else known.T_nvdu_posecnn
        if T_nvdu is None:
            raise InputError("NVDU's model frames", found=f"none of '{model.name}'", fix=fix)
        return se3.compose(T_nvdu, T_posecnn)

    @staticmethod
    def _find(given: Path, sequence: str) -> Path:
        if given.is_file():
            return given
        places = [
            given / f"{sequence}.csv",
            given / sequence / "poses.txt",
            given / sequence / "dope" / "poses_ycb.txt",
            given / sequence / "dope" / "poses.txt",
        ]
        for place in places:
            if place.is_file():
                return place
        raise InputError(
            given,
            found="no such file" if not given.is_dir() else f"no poses of sequence {sequence}",
            expected="a file, or a folder with " + " or ".join(str(p.relative_to(given)) for p in places),
        )


def warm_tracker(models: Mapping[str, ReferenceModel], config: TrackerConfig) -> Tracker:
    """Our tracker, warmed up."""
    tracker = Tracker(models, config)
    tracker.warm_up()
    return tracker
