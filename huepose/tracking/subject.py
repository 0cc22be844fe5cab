"""What a tracker prepares once for each object: its surface, its outlines, and the rotations that look
alike."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.mesh import Mesh
from huepose.geometry.symmetry import nearest_alike
from huepose.judge.borders import Contours
from huepose.judge.open_region import PreparedSurface
from huepose.model.types import ReferenceModel
from huepose.perception.window_table import WindowTable, window_table
from huepose.select.distinct import FINAL_TURN_RAD, RIGHT

SMALL_TURN = np.radians(45.1)
"""Near-symmetric rotations up to 45 degrees (with a tolerance for rounding) exist only about an axis of
revolution."""

POINTS = 48
"""Surface points over which the distance of two poses, or the spread of one, is averaged."""


@dataclass(frozen=True, eq=False)
class Subject:
    """The object. near_symmetries (M, 4, 4): rotations that nearly map its shape to itself, without the
    identity; other_turns: those of them after which a pose is wrong; small_turns: those of other_turns that
    are small, about an axis of revolution; slides (K, 4, 4): rotations about that axis that are tried while
    it is followed; rolls (L, 4, 4): rotations that move a slender object too little for the pose to be wrong;
    points (E, P, 3): points of its surface, after each of the rotations under which it looks the same, the
    identity first; contours: its outlines from all viewpoints."""

    model: ReferenceModel
    surface: PreparedSurface
    near_symmetries: Float64
    other_turns: Float64
    small_turns: Float64
    slides: Float64
    rolls: Float64
    points: Float64
    contours: Contours

    @staticmethod
    def of(model: ReferenceModel) -> Subject:
        """Prepare a reference model for tracking."""
        turns = np.asarray(model.near_symmetries[1:], np.float64)
        wrong_by, contours = _wrong_by(model, turns), Contours.of(model)
        wrong, right = turns[wrong_by >= RIGHT], turns[wrong_by < RIGHT]
        surface = contours.surface
        few = surface.arrays.points[:POINTS].astype(np.float64)
        points = np.stack([se3.apply(T, few) for T in model.equivalents])
        return Subject(
            model,
            surface,
            turns,
            wrong,
            wrong[_angles(wrong, np.eye(4)) <= SMALL_TURN],
            _slides(turns[wrong_by > ALIKE]),
            right[_angles(right, *model.equivalents) > FINAL_TURN_RAD],
            points,
            contours,
        )

    def like(self, T_cam_obj: Float64, T_near: Float64) -> Float64:
        """Of the poses (4, 4) that look the same as T_cam_obj, the one rotated least from T_near."""
        return nearest_alike(T_cam_obj, self.model.equivalents, T_near)

    def viewpoint(self, T_cam_obj: Float64, near: Float64) -> Float64:
        """Unit vector (3,) from the object to the camera, object axes; of those that look the same, the one
        nearest to `near`."""
        eye = -T_cam_obj[:3, :3].T @ self.surface.centre_cam(T_cam_obj)
        eye /= max(se3.length(eye), 1e-9)
        if len(self.model.equivalents) == 1:
            return np.asarray(eye)
        alike = (eye @ self._rotations_alike).reshape(-1, 3)
        return np.asarray(alike[np.argmax(alike @ near)])

    @cached_property
    def _rotations_alike(self) -> Float64:
        """The rotations of the model's `equivalents` side by side (3, 3 K): one product with a vector."""
        return np.ascontiguousarray(np.concatenate(list(self.model.equivalents[:, :3, :3]), axis=1))

    def closer(self, turns: Float64) -> Float64:
        """Rotations (M, 4, 4) and, for an object of revolution, those half a step further about its axis (2M,
        4, 4): between the stripes of a print a refinement does not converge from one step to the next."""
        return turns if not len(self.slides) else np.concatenate([turns, turns @ self.slides[HALF_STEP]])

    @property
    def mesh(self) -> Mesh:
        """The model's mesh."""
        return self.model.mesh

    @cached_property
    def views(self) -> WindowTable:
        """Its views from all sides, computed or loaded at the first use."""
        return window_table(self.model)

    def make_ready(self) -> None:
        """Load everything that is computed lazily, so that no frame waits for it."""
        _ = self.contours.lines, self.views


SLIDES = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)
"""Shares of the step between two near-symmetric rotations about an axis of revolution."""

HALF_STEP = SLIDES.index(0.5)
FAR_SLIDES = np.abs(SLIDES) > 0.5
"""Those of more than half a step: they change the belief in the orientation."""


def _slides(turns: Float64) -> Float64:
    """Rotations (K, 4, 4) about the axis of revolution, by SLIDES times the smallest of these rotations (M,
    4, 4); none without such an axis."""
    angles = _angles(turns, np.eye(4))
    if not len(turns) or angles.min() > SMALL_TURN:
        return np.zeros((0, 4, 4))
    step = se3.log(turns[int(np.argmin(angles))])
    return np.array([se3.exp(part * step) for part in SLIDES])


ALIKE = 0.01
"""Mean displacement of the surface, in diameters, up to which the object looks the same after a rotation. It
is not 0 because rotations about an axis of revolution are given in steps."""


def _wrong_by(model: ReferenceModel, turns: Float64) -> Float64:
    """Error of a right pose after each of these rotations (M, 4, 4): (M,) mean displacements of the surface
    in diameters, 0 for a true symmetry."""
    points = model.eval_points.astype(np.float64)
    apart = []
    for T in model.equivalents:
        off = turns - T
        shifts = points @ off[:, :3, :3].transpose(0, 2, 1) + off[:, None, :3, 3]
        apart.append(np.linalg.norm(shifts, axis=2).mean(1))
    return np.asarray(np.min(apart, axis=0) / model.diameter_m)


def _angles(turns: Float64, *others: Float64) -> Float64:
    """The angle (M,) of each of these rotations (M, 4, 4) to the nearest of others (4, 4), radians."""
    return np.asarray(np.min([se3.angles_to(turns[:, :3, :3], T[:3, :3]) for T in others], axis=0))
