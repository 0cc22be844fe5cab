"""The estimator: where is each of these objects in this frame, how sure, and how exact?

Every query is first answered alone; then the poses of the frame compete for its depth (`competition`). The
answers depend on the frame, the queries and the seed, not on the order of queries or on threads.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from zlib import crc32

import numpy as np

from huepose.believe.quality import quality_fits
from huepose.estimation.answer import Levels, answer_of, bare_answer
from huepose.estimation.competition import compete
from huepose.estimation.config import EstimatorConfig
from huepose.estimation.explanation import Explanation
from huepose.estimation.full_path import confirm, estimate_full, looks_in_full, refine_prior, table_of
from huepose.estimation.methods import method_of
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.estimation.warm_up import warm_up
from huepose.geometry.arrays import Bool
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.judge.silhouette import projected_box
from huepose.model.types import ReferenceModel, model_named
from huepose.perception.embedded import DepthSegmenter
from huepose.perception.types import Segmenter
from huepose.propose.evidence import gather
from huepose.select.near_ties import decided
from huepose.support.errors import InputError
from huepose.support.pool import Pool
from huepose.support.stages import stage


class Estimator:
    """Poses of known objects in single frames.

    models: by name; segmenter: outlines an object in a box (the embedded depth segmenter by default).
    Thread-safe; kernels are compiled at the first call, or by `warm_up`.
    """

    def __init__(
        self,
        models: Mapping[str, ReferenceModel],
        config: EstimatorConfig | None = None,
        segmenter: Segmenter | None = None,
    ) -> None:
        self.config = config or EstimatorConfig()
        self._models = dict(models)
        self._segmenter: Segmenter = segmenter or DepthSegmenter()
        self._method = method_of(self.config)
        self._pool = Pool(self.config.threads)

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the known objects."""
        return tuple(sorted(self._models))

    def add_object(self, model: ReferenceModel) -> None:
        """Know one more object; a known one of that name is replaced."""
        self._models[model.name] = model
        if self._method is None:
            table_of(model)

    def remove_object(self, name: str) -> None:
        """Forget an object; nothing happens when it is not known."""
        self._models.pop(name, None)

    def estimate(self, frame: RgbdFrame, queries: Sequence[ObjectQuery]) -> list[PoseEstimate]:
        """One answer a query, in their order, no two of them on the same surface. Raises InputError for an
        unknown object or an empty query."""
        return [answer for answer, _ in self.explained(frame, queries)]

    def explained(
        self, frame: RgbdFrame, queries: Sequence[ObjectQuery]
    ) -> list[tuple[PoseEstimate, Explanation]]:
        """The same answers, each with what led to it: of a pose that was looked for again without the depth
        of others, what was seen then."""
        for query in queries:
            self._model(query.object)
        looks = self._alone(frame, queries)
        if len(queries) < 2 or not self.config.competing or self._bare:
            return looks
        again: list[tuple[PoseEstimate, Explanation]] = []

        def look_again(free: RgbdFrame, query: ObjectQuery) -> PoseEstimate:
            again.append(self.explain(free, query))
            return again[-1][0]

        answers = compete(
            frame, queries, [answer for answer, _ in looks], look_again, self.config.competition
        )
        return [
            (answer, next((x for a, x in again if _same(a, answer)), explanation))
            for answer, (_, explanation) in zip(answers, looks, strict=True)
        ]

    def _alone(
        self, frame: RgbdFrame, queries: Sequence[ObjectQuery]
    ) -> list[tuple[PoseEstimate, Explanation]]:
        """One answer a query, as if there were no other."""
        return self._pool.map(lambda query: self.explain(frame, query), queries)

    def _model(self, name: str) -> ReferenceModel:
        return model_named(self._models, name)

    @property
    def _bare(self) -> bool:
        return self._method is not None and self._method.bare

    def explain(self, frame: RgbdFrame, query: ObjectQuery) -> tuple[PoseEstimate, Explanation]:
        """The answer to one query, as if there were no other, and what led to it."""
        start = time.perf_counter()
        look = self._look(frame, query)
        answer = None
        if look.confirmed:
            answer = self._answer(frame, query, look)
        if answer is None or answer.state != "TRACKING":
            look = self._found(frame, query, replace(look, confirmed=False))
            with stage("answer"):
                answer = self._answer(frame, query, look)
        return replace(answer, seconds=time.perf_counter() - start), look

    def _look(self, frame: RgbdFrame, query: ObjectQuery) -> Explanation:
        """What there is to see, and the refined prior, with its rivals where it is confirmed."""
        model = self._model(query.object)
        box, masks = self._box_and_masks(frame, query, model)
        with stage("evidence"):
            evidence = gather(frame, masks, box, model.diameter_m, self.config.evidence)
        look = Explanation(box, tuple(masks), evidence)
        if evidence is None or query.prior is None or self._method is not None:
            return look
        with stage("prior"):
            prior = refine_prior(model, evidence, query.prior.T_cam_obj, self.config.full)
            look = replace(look, prior=prior)
            if looks_in_full(frame.frame_id, self.config.confirm.look_anew_every):
                return look
            confirmed = confirm(model, evidence.region, prior, self.config.confirm)
            return look if confirmed is None else replace(look, ranked=confirmed, confirmed=True)

    def _found(self, frame: RgbdFrame, query: ObjectQuery, look: Explanation) -> Explanation:
        """The same with the poses that the method finds."""
        model, method, evidence = self._model(query.object), self._method, look.evidence
        if method is not None:
            method.check(model)
        if evidence is None:
            return look
        if method is not None:
            seed = [self.config.seed, crc32(query.object.encode()), _content_seed(frame)]
            return replace(look, ranked=method.poses(model, evidence, np.random.default_rng(seed)))
        found, trail = estimate_full(model, evidence, self.config.full, look.prior)
        with stage("contest"):
            ranked, held = decided(model, evidence.region, found, self.config.near_ties)
        return replace(look, ranked=ranked, trail=trail, contest=held)

    def prepare(self, names: Sequence[str]) -> None:
        """Derive from models what answers about them need, which the first of them does otherwise."""
        for name in names:
            if self._method is None:
                table_of(self._model(name))
            else:
                self._method.check(self._model(name))

    def warm_up(self, names: Sequence[str] | None = None) -> None:
        """Prepare models (all by default) and compile the kernels on an artificial view of the one with most
        texture."""
        names = self.objects if names is None else list(names)
        self.prepare(names)
        if not names:
            return
        models = [self._model(name) for name in names]
        if self._method is not None:
            self._method.warm_up(models)
        warm_up(self.explain, max(models, key=lambda m: len(m.pairs.points)), self._method is None)

    def _box_and_masks(
        self, frame: RgbdFrame, query: ObjectQuery, model: ReferenceModel
    ) -> tuple[Box, list[Bool]]:
        """Box and candidate masks of a query: what it gives, else what the segmenter or its prior says."""
        box, masks = query.box, [np.asarray(m, dtype=bool) for m in query.masks]
        for mask in masks:
            if mask.shape != frame.depth.shape:
                raise InputError(
                    f"mask of '{query.object}'",
                    found=f"{mask.shape}",
                    expected=f"{frame.depth.shape}, the size of the frame",
                )
        if box is None and masks:
            box = Box.of_mask(np.any(masks, axis=0))
        if box is None and query.prior is not None:
            box = projected_box(model, frame, query.prior.T_cam_obj)
        if box is None:
            if query.prior is None and not masks:
                raise InputError(
                    f"query for '{query.object}'",
                    found="neither box, masks nor prior",
                    expected="at least one of them",
                    fix="Ask a detector for a box first.",
                )
            return Box(0.0, 0.0, 0.0, 0.0), masks
        if not masks:
            with stage("masks"):
                masks = self._segmenter.segment(frame, box, model.diameter_m)
        return box, masks

    def _answer(self, frame: RgbdFrame, query: ObjectQuery, look: Explanation) -> PoseEstimate:
        model = self._model(query.object)
        if self._bare:
            return bare_answer(frame, query, model, look)
        config, fit = self.config, quality_fits()[self.config.method]
        levels = Levels(
            fit.level if config.acquisition_level is None else config.acquisition_level,
            fit.found if config.found_level is None else config.found_level,
            config.confirm.margin,
        )
        return answer_of(frame, query, model, look, fit, levels)


def _same(one: PoseEstimate, other: PoseEstimate) -> bool:
    """Whether these are one answer, up to the time it took."""
    return one.T_cam_obj is not None and one.T_cam_obj is other.T_cam_obj


def _content_seed(frame: RgbdFrame) -> int:
    """A number that depends on what the frame shows."""
    return crc32(np.ascontiguousarray(frame.depth[::8, ::8]).tobytes())
