"""Files of poses as the command line names them: one file, or a folder with one for each sequence."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from huepose.datasets.fast_ycb import object_of
from huepose.evaluation.pose_files import (
    PoseTable,
    nvdu_from_reference,
    read_dope_poses,
    read_nvdu_frames,
    read_pose_csv,
)
from huepose.geometry.arrays import Float64
from huepose.model import ReferenceModel
from huepose.support.errors import InputError


class PoseTables:
    """Finds and reads them, in the reference models' frames or in NVIDIA's (`frame` is "nvdu")."""

    def __init__(self, frame: str, nvdu_frames: Path | None, models: Mapping[str, ReferenceModel]) -> None:
        self._models = models
        self._T_theirs_obj: dict[str, Float64] | None = None
        if frame == "nvdu":
            if nvdu_frames is None:
                raise InputError(
                    "--frame nvdu",
                    found="no description of that frame",
                    expected="--nvdu-frames FILE with posecnn_to_dope_R and posecnn_to_dope_t_m by object",
                )
            self._T_theirs_obj = self._nvdu(nvdu_frames)

    def _nvdu(self, path: Path) -> dict[str, Float64]:
        frames = read_nvdu_frames(path)
        result = {}
        for model in self._models.values():
            if model.name not in frames or model.frame_offset_m is None:
                raise InputError(
                    path if model.name not in frames else f"reference model '{model.name}'",
                    found=f"no frame of '{model.name}'" if model.name not in frames else "no frame offset",
                    fix="Give poses in the reference model's frame, without --frame nvdu.",
                )
            T_nvdu_obj = nvdu_from_reference(*frames[model.name], model.frame_offset_m)
            result[model.name] = T_nvdu_obj
            if model.object_id is not None:
                result[str(model.object_id)] = T_nvdu_obj
        return result

    def of(self, given: str, sequence: str) -> PoseTable:
        """The poses of a sequence. Raises InputError, listing where they were looked for."""
        path = self._find(Path(given), sequence)
        if path.suffix == ".csv":
            table = read_pose_csv(path)
        elif self._T_theirs_obj is None:
            raise InputError(
                path, found="poses in DOPE's form", expected="--frame nvdu", fix="Or convert them to CSV."
            )
        else:
            table = read_dope_poses(path, object_of(sequence))
        return table if self._T_theirs_obj is None else table.moved(self._T_theirs_obj)

    @staticmethod
    def _find(given: Path, sequence: str) -> Path:
        if given.is_file():
            return given
        places = [
            given / f"{sequence}.csv",
            given / f"{sequence}.txt",
            given / sequence / "poses.txt",
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
