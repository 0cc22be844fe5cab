"""Reference models to measure errors on, scenes in memory, an estimator that returns given poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.datasets.types import GroundTruth
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.geometry import Box, Camera, Mesh, RgbdFrame, se3
from huepose.model.types import DistanceGrid, Keypoints, PairReference, ReferenceModel, Surface, ViewTemplates

CAMERA = Camera(120.0, 120.0, 79.5, 59.5, 160, 120)
HALF_TURN = se3.make(se3.rotation_exp([0, 0, np.pi]), [0, 0, 0])


def box_mesh(size: Sequence[float]) -> Mesh:
    """A closed box, untextured."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Mesh(
        (corners * size).astype(np.float32),
        np.array(faces, np.int32),
        np.zeros((len(faces), 3, 2), np.float32),
        np.full((2, 2, 3), 128, np.uint8),
    )


def reference_model(
    name: str,
    object_id: int | None,
    size: Sequence[float] = (0.06, 0.1, 0.16),
    equivalents: Sequence[np.ndarray] = (),
) -> ReferenceModel:
    """A box with points spread over its faces; the tables of estimation are empty."""
    mesh = box_mesh(size)
    grid = np.linspace(-0.5, 0.5, 12)
    faces = [
        np.insert([a, b], axis, side) for axis in range(3) for side in (-0.5, 0.5) for a in grid for b in grid
    ]
    points = (np.unique(np.array(faces), axis=0) * size).astype(np.float32)
    z = np.zeros
    one3, none3, none_i = z((1, 3), np.float32), z((0, 3), np.float32), z(0, np.int32)
    turns = np.stack([np.eye(4), *equivalents])
    return ReferenceModel(
        name=name,
        object_id=object_id,
        mesh=mesh,
        eval_points=points,
        diameter_m=float(np.linalg.norm(size)),
        symmetries=np.eye(4)[None],
        near_symmetries=np.eye(4)[None],
        equivalents=turns,
        frame_offset_m=np.zeros(3),
        surface=Surface(one3, one3, z((2, 1, 3), np.float32), none3, none_i, z(1, np.int32)),
        grid=DistanceGrid(np.zeros(3), 0.01, z((1, 1, 1), np.int16)),
        templates=ViewTemplates(none3, z((0, 1, 5, 1, 1), np.float16), none3, 1.2),
        pairs=PairReference(none3, none3, none3, z((0, 2, 3), np.float32), none_i),
        keypoints=Keypoints(none3, none3, z((0, 128), np.uint8), "sift"),
    )


@dataclass(frozen=True, eq=False)
class MemoryScene:
    """A scene whose labels are given; its images are empty."""

    name: str
    labels: Mapping[int, tuple[GroundTruth, ...]]
    stamps_ns: Mapping[int, int] = field(default_factory=dict)

    @property
    def image_ids(self) -> tuple[int, ...]:
        return tuple(sorted(self.labels))

    def stamp_ns(self, image: int) -> int:
        return self.stamps_ns.get(image, round(image * 1e9 / 30))

    def frame(self, image: int) -> RgbdFrame:
        return RgbdFrame(
            np.zeros((120, 160, 3), np.uint8),
            np.ones((120, 160), np.float32),
            CAMERA,
            image,
            self.stamp_ns(image),
        )

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        return self.labels[image]


class PartlyLabelled(MemoryScene):
    """A scene in which an image without labels counts as unlabelled, not as empty."""

    def has_labels(self, image: int) -> bool:
        return bool(self.labels[image])


def estimate_of(
    query: ObjectQuery, T: np.ndarray | None, quality: float = 0.9, score: float = 0.8
) -> PoseEstimate:
    """An estimate with this pose."""
    state = State.LOST if T is None else State.TRACKING if quality > 0.8 else State.SUSPECT
    found = T is not None
    return PoseEstimate(query.object, query.instance, found, T, quality, state, score, box=query.box)


@dataclass(eq=False)
class ScriptedEstimator:
    """Answers each query with a function of frame and query; keeps the queries in `asked`."""

    answer: Callable[[RgbdFrame, ObjectQuery], PoseEstimate]
    asked: list[tuple[int, ObjectQuery]] = field(default_factory=list)

    def estimate(self, frame: RgbdFrame, queries: Sequence[ObjectQuery]) -> list[PoseEstimate]:
        self.asked += [(frame.frame_id, query) for query in queries]
        return [self.answer(frame, query) for query in queries]


@pytest.fixture
def models() -> dict[str, ReferenceModel]:
    """A box with id 5, and a smaller one with id 7 that looks the same after a half turn."""
    return {
        "box": reference_model("box", 5),
        "brick": reference_model("brick", 7, (0.05, 0.08, 0.1), [HALF_TURN]),
    }


def truth(
    instance: int,
    object_id: int,
    T: np.ndarray,
    visib: float | None = None,
    box: Box | None = None,
    **more: object,
) -> GroundTruth:
    """A label."""
    return GroundTruth(instance, T, object_id=object_id, visib_fract=visib, box_visib=box, **more)


def pose_at(x: float, y: float = 0.0, z: float = 0.6, turn: float = 0.3) -> np.ndarray:
    """A pose in front of the camera."""
    return se3.make(se3.rotation_exp([0.4, turn, -0.2]), [x, y, z])
