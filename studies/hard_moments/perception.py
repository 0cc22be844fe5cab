"""What perception says of a frame of a moment: an oracle that is nearly right, or the project's estimator.

The oracle finds every object that is seen well enough, with small errors: with it the tracker and the loop
are measured. The estimator is asked in disturbed true boxes, as a detector would give them; where the object
is not to be seen, in the box of what looks like it, or where it is tracked. It says what it says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from huepose.datasets.boxes import disturbed, projected_box
from huepose.datasets.types import VISIBLE
from huepose.estimation import Estimator, ObjectQuery
from huepose.estimation.types import PoseEstimate, PosePrior
from huepose.geometry.arrays import Float64
from huepose.geometry.box import Box
from huepose.model.types import ReferenceModel
from huepose.profiles import profile
from huepose.reinit.association import displacement_m
from huepose.reinit.types import ObjectSlot, Request, RequestedObject
from studies.hard_moments.film import Seen, Shown, noisy
from studies.hard_moments.scripts import Script

SHIFT_M, TURN_RAD = 0.002, 0.02
SCORE, SCORE_PER_DIAMETER = 1.9, 2.5
"""Scores of the oracle's judge: of a right pose, and what is lost per diameter of displacement, up to 1.2."""

LEAST_BOX_PX = 12.0


class Perception(Protocol):
    """Anything that answers a request about a frame."""

    starts_known: bool
    """Whether a film begins with the true poses; otherwise the objects are to be found first."""

    def answer(self, request: Request, seen: Seen) -> list[PoseEstimate]:
        """Estimates of what was asked for and is there."""
        ...


def slots_of(objects: Sequence[str], models: Mapping[str, ReferenceModel]) -> list[ObjectSlot]:
    """What the loop looks for in a film of these objects (a name stands there once per instance)."""
    return [
        ObjectSlot(name, list(objects).count(name), models[name].diameter_m, tuple(models[name].equivalents))
        for name in dict.fromkeys(objects)
    ]


class Oracle:
    """The true pose with normal errors, and a fair comparison of it with a tracked one."""

    starts_known = True

    def __init__(self, script: Script | Shown, models: Mapping[str, ReferenceModel], seed: int = 0) -> None:
        self._objects = script.objects
        self._slots = {slot.object: slot for slot in slots_of(script.objects, models)}
        self._rng = np.random.default_rng([seed, 50])

    def answer(self, request: Request, seen: Seen) -> list[PoseEstimate]:
        """See Perception."""
        found: list[PoseEstimate] = []
        taken: set[int] = set()
        for asked in request.objects:
            for k in _candidates(asked, self._objects, seen, taken):
                taken.add(k)
                found.append(self._estimate(asked, seen.T_cam_obj[k], seen.frame.stamp_ns))
        return found

    def _estimate(self, asked: RequestedObject, truth: Float64, stamp_ns: int) -> PoseEstimate:
        T, prior_score, prior = noisy(truth, self._rng, SHIFT_M, TURN_RAD), None, None
        if asked.prior is not None:
            slot, prior = self._slots[asked.object], asked.prior.predicted(stamp_ns)
            off = displacement_m(prior, truth, slot) / slot.diameter_m
            prior_score = SCORE - min(SCORE_PER_DIAMETER * max(off - 0.1, 0.0), 1.2)
        instance = -1 if asked.instance is None else asked.instance
        covariance = np.diag([SHIFT_M**2] * 3 + [TURN_RAD**2] * 3)
        return PoseEstimate(
            asked.object, instance, True, T, 0.95, "TRACKING", SCORE, 0.3, covariance, None, None,
            prior_score, prior, (), 0.1,
        )  # fmt: skip


class OwnEstimates:
    """The project's estimator, from the first frame on."""

    starts_known = False

    def __init__(self, script: Script, models: Mapping[str, ReferenceModel], seed: int = 0) -> None:
        self._script, self._models, self._seed = script, models, seed
        known = {name: models[name] for name in dict.fromkeys(script.objects)}
        self._estimator = Estimator(known, profile("live").estimator)

    def answer(self, request: Request, seen: Seen) -> list[PoseEstimate]:
        """See Perception."""
        queries: list[ObjectQuery] = []
        taken: set[int] = set()
        for asked in request.objects:
            mine = _candidates(asked, self._script.objects, seen, taken)
            taken |= set(mine)
            boxes = [self._box(asked.object, seen.T_cam_obj[k], seen, k) for k in mine]
            if not mine:
                boxes = self._decoys(asked.object, seen)
            prior = None
            if asked.prior is not None:
                T = asked.prior.predicted(seen.frame.stamp_ns)
                prior = PosePrior(T, asked.prior.covariance)
                # A detector that finds nothing elsewhere looks where the object is tracked.
                boxes = boxes[:1] or [self._box(asked.object, T, seen, 90)]
            instance = -1 if asked.instance is None else asked.instance
            queries += [
                ObjectQuery(asked.object, box, prior=prior, instance=instance) for box in boxes if box
            ]
        return self._estimator.estimate(seen.frame, queries) if queries else []

    def _decoys(self, name: str, seen: Seen) -> list[Box | None]:
        """Boxes of what can be taken for the object."""
        k = self._script.shown[seen.frame.frame_id]
        return [
            self._box(name, self._script.stage.T_room_mesh[number, k], seen, 50 + number)
            for own, number in self._script.decoys
            if own == name
        ]

    def _box(self, name: str, T_cam_obj: Float64, seen: Seen, number: int) -> Box | None:
        camera, frame = seen.frame.camera, seen.frame.frame_id
        if T_cam_obj[2, 3] <= 0.0:
            return None
        box = projected_box(self._models[name].mesh, T_cam_obj, camera)
        box = None if box is None else box.clipped(camera.width, camera.height)
        if box is None or min(box.w, box.h) < LEAST_BOX_PX:
            return None
        return disturbed(box, "perturbed", self._seed, self._script.name, frame, number, camera)


def _candidates(asked: RequestedObject, objects: Sequence[str], seen: Seen, taken: set[int]) -> list[int]:
    """Which of the film's objects an answer can be about: all that are seen well enough, or the one that is
    nearest to the prior."""
    mine = [
        k
        for k, name in enumerate(objects)
        if name == asked.object and k not in taken and seen.visib_fract[k] >= VISIBLE
    ]
    if asked.prior is None:
        return mine
    prior = asked.prior.predicted(seen.frame.stamp_ns)
    nearest = sorted(mine, key=lambda k: float(np.linalg.norm(seen.T_cam_obj[k][:3, 3] - prior[:3, 3])))
    return nearest[:1]
