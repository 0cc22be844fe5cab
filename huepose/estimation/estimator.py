"""The estimator: where is each of these objects in this frame, how probable is the pose, and how exact?

Every object is first estimated alone (`answer.answered`). Then the poses of the frame compete for its depth:
one surface, one pose. They are taken in order of their quality. A sure pose keeps the pixels that it
explains. A later pose that lies on such pixels, or is doubtful beside them, is estimated again in the frame
without them. The removed pixels count as "no reading": they are evidence neither for a pose nor against it,
as if occluded. So neighbours in a pile, which merge into one mask, are separated by those that are
recognised.

The estimates depend on the frame, the queries and the seed, not on the order of queries or on threads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from huepose.colorpair.opponents import unveiled
from huepose.estimation.answer import answered, check_masks, confirm, refine_prior
from huepose.estimation.apparent_size import looks, support
from huepose.estimation.config import EstimatorConfig
from huepose.estimation.explanation import Explanation
from huepose.estimation.methods import method_of
from huepose.estimation.present import PresenceIn
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.image_faults import bad_image
from huepose.judge.silhouette import projected_box, taken_by
from huepose.model.types import ReferenceModel, ReferenceModels
from huepose.perception.embedded import DepthSegmenter
from huepose.perception.types import Segmenter
from huepose.propose.templates import table_of
from huepose.rendering.render import render
from huepose.select.distinct import Ranked
from huepose.select.near_ties import contest, decided
from huepose.support.errors import require
from huepose.support.pool import Pool, Steps, finished
from huepose.support.stages import stage

SURE = 0.5
"""A pose keeps its pixels from this quality on; against other instances of its object it always does.
Chosen."""

CONTESTED = 0.25
"""A pose is estimated again if surer poses hold this share of its visible pixels. Chosen."""

DOUBTFUL, TAKEN = 0.8, 0.05
"""So is a pose under the quality DOUBTFUL if surer poses hold the share TAKEN of its box. Chosen."""

Answered = tuple[PoseEstimate, Explanation]
"""An estimate and its explanation."""

Answering = Callable[[RgbdFrame, ObjectQuery], Answered]


class Estimator:
    """Poses of known objects in single frames.

    models: by name; segmenter: segments an object in a box (the embedded depth segmenter by default).
    Thread-safe; kernels are compiled at the first call, or by `warm_up`.
    """

    def __init__(
        self,
        models: Mapping[str, ReferenceModel],
        config: EstimatorConfig | None = None,
        segmenter: Segmenter | None = None,
    ) -> None:
        self.config = config or EstimatorConfig()
        self._models = ReferenceModels(models)
        self._segmenter: Segmenter = segmenter or DepthSegmenter()
        self._method = method_of(self.config)
        self._pool = Pool(self.config.threads)

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the known objects."""
        return tuple(sorted(self._models))

    @property
    def diameters_m(self) -> tuple[float, ...]:
        """Diameters of the known objects, metres, in the order of `objects`."""
        return tuple(self._models[name].diameter_m for name in self.objects)

    def middle_obj(self, name: str) -> Float64:
        """The centre (3,) of the bounds of a known object, in its own axes."""
        return self._models[name].mesh.centre

    def add_object(self, model: ReferenceModel) -> None:
        """Add an object; a known one of that name is replaced."""
        self._models[model.name] = model
        if self._method is None:
            table_of(model)

    def remove_object(self, name: str) -> None:
        """Remove an object; nothing happens if it is not known."""
        self._models.pop(name, None)

    def estimate(self, frame: RgbdFrame, queries: Sequence[ObjectQuery]) -> list[PoseEstimate]:
        """One estimate per query, in the order of the queries, no two of them on the same surface. Raises
        InputError for an unknown object or an empty query."""
        return [answer for answer, _ in self.explained(frame, queries)]

    def explained(self, frame: RgbdFrame, queries: Sequence[ObjectQuery]) -> list[Answered]:
        """The same estimates, each with its explanation. If a pose was estimated again without the depth of
        others, the explanation is that of the second estimate."""
        require(frame, RgbdFrame, "frame", "an RgbdFrame")
        require(queries, Sequence, "queries", "a list of ObjectQuery")
        for query in queries:
            require(query, ObjectQuery, "query", "an ObjectQuery", "Make one: ObjectQuery(name, box).")
            self._models[query.object]  # raises before any work is done
            check_masks(frame, query)
        picture = frame
        if self.config.method == "full":
            with stage("veil"):
                frame = unveiled(frame)
        presence = None
        if any(query.searched for query in queries):
            with stage("presence"):
                presence = PresenceIn(frame, self._models, self.config.method)

        def look(seen: RgbdFrame, query: ObjectQuery) -> Steps[Answered]:
            if query.others:
                seen, query = _free_of(seen, query, taken_by(self._models[query.object], seen, query.others))
            answer, explanation = yield from self._explain(seen, query)
            if presence is not None and query.searched:
                with stage("presence"):
                    answer = presence.with_presence(answer)
            return answer, explanation

        answers = self._pool.map_steps(lambda query: look(frame, query), queries)

        def look_again(seen: RgbdFrame, query: ObjectQuery) -> Answered:
            return finished(look(seen, query))

        if len(queries) > 1 and not (self._method and self._method.bare):
            answers = compete(frame, queries, answers, look_again)
        if any(answer.found for answer, _ in answers):
            return answers
        names = {query.object for query in queries}
        faults = {name: bad_image(picture, self._models[name].diameter_m) for name in names}
        return [(replace(a, reason=faults[a.object] or a.reason), explanation) for a, explanation in answers]

    def explain(self, frame: RgbdFrame, query: ObjectQuery) -> Answered:
        """The estimate for one query, independent of other queries, and its explanation."""
        return finished(self._explain(frame, query))

    def _explain(self, frame: RgbdFrame, query: ObjectQuery) -> Steps[Answered]:
        model = self._models[query.object]
        return answered(frame, query, model, self._segmenter, self.config, self._method)

    def sizes_seen(self, frame: RgbdFrame, answers: Sequence[PoseEstimate]) -> list[Float64]:
        """The evidence of a frame's estimates about the camera matrix, for `apparent_size`."""
        return looks(frame, self._models, answers)

    def prepare(self, names: Sequence[str]) -> None:
        """Prepare what estimates of these objects need; otherwise the first estimate does it."""
        for name in names:
            if self._method is None:
                table_of(self._models[name])
            else:
                self._method.check(self._models[name])

    def warm_up(self, names: Sequence[str] | None = None) -> None:
        """Prepare models (all by default) and compile the kernels on a rendered frame of the one with most
        texture."""
        names = self.objects if names is None else list(names)
        self.prepare(names)
        if not names:
            return
        models = [self._models[name] for name in names]
        if self._method is not None:
            self._method.warm_up(models)
        warm_up(
            lambda frame, query: self.explained(frame, [query])[0],
            max(models, key=lambda m: len(m.pairs.points)),
            self._method is None,
        )


def compete(
    frame: RgbdFrame,
    queries: Sequence[ObjectQuery],
    answers: Sequence[Answered],
    look_again: Answering,
) -> list[Answered]:
    """Estimates, in the order of the queries, of which no two explain the same surface.

    `look_again` estimates a query in a frame without the depth of surer poses. A pose that lay on that depth
    is replaced by the new estimate; one that was only doubtful is replaced if the new one has a higher
    quality.
    """
    out = list(answers)
    before: list[PoseEstimate] = []
    for k in sorted(range(len(out)), key=lambda i: _rank(out[i][0])):
        sure = [o for o in before if o.quality >= SURE or o.object == queries[k].object]
        taken = np.zeros(frame.depth.shape, bool)
        for o in sure:
            if o.mask is not None:
                taken |= o.mask
        out[k] = _without(frame, queries[k], out[k], taken, look_again)
        before.append(out[k][0])
    return out


def _rank(answer: PoseEstimate) -> tuple[float, float, str, int]:
    """Surest first, whatever the order of the queries."""
    return -answer.quality, -answer.score, answer.object, answer.instance


def _without(
    frame: RgbdFrame, query: ObjectQuery, known: Answered, taken: Bool, look_again: Answering
) -> Answered:
    """The estimate, or a new one without the taken pixels that replaces it."""
    answer = known[0]
    contested = _share_of_mask(answer.mask, taken) > CONTESTED
    doubtful = answer.quality < DOUBTFUL and _share_of_box(query.box, taken) > TAKEN
    if not contested and not doubtful:
        return known
    again, look = look_again(*_free_of(frame, query, taken))
    again = replace(again, seconds=again.seconds + answer.seconds)
    return (again, look) if contested or again.quality > answer.quality else known


def _free_of(frame: RgbdFrame, query: ObjectQuery, taken: Bool) -> tuple[RgbdFrame, ObjectQuery]:
    """A frame, and a query in it, without the depth of the pixels (H, W) that are taken."""
    masks = tuple(np.asarray(m, bool) & ~taken for m in query.masks)
    return frame.without(taken), replace(query, masks=masks)


def _share_of_mask(mask: Bool | None, taken: Bool) -> float:
    size = 0 if mask is None else np.count_nonzero(mask)
    return 0.0 if mask is None or size == 0 else np.count_nonzero(mask & taken) / size


def _share_of_box(box: Box | None, taken: Bool) -> float:
    if box is None:
        return 0.0
    height, width = taken.shape
    inside = taken[box.slices(width, height)]
    return float(inside.mean()) if inside.size else 0.0


def warm_up(explain: Answering, model: ReferenceModel, full: bool) -> None:
    """Estimate an object in front of a wall, with the probability that it is there. full: the method is
    `full`, so a prior and a near tie of poses are processed as well."""
    camera = Camera(320.0, 320.0, 159.5, 119.5, 320, 240)
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 3.0 * model.diameter_m]) - model.mesh.centre)
    picture = render([(model.mesh, T)], camera)
    wall = np.float32(4.0 * model.diameter_m)
    frame = RgbdFrame(picture.color, np.where(picture.depth > 0, picture.depth, wall), camera)
    box = projected_box(model, frame, T)
    if box is None:
        return
    _, explanation = explain(frame, ObjectQuery(model.name, box, searched=True))
    if not full or explanation.evidence is None:
        return
    region = explanation.evidence.region
    refined = refine_prior(model, explanation.evidence, T)
    confirm(model, region, refined)
    pose = refined.poses[0]
    rotated = se3.perturb(pose, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1]))
    tie = Ranked.of(np.stack([pose, rotated]), np.array([2.0, 1.95]))
    decided(model, region, tie)
    contest(model, region, tie, shaded=True)
    support(frame, model, pose, picture.depth > 0)
