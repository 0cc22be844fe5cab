"""What all places of one question start from, and how poses become answers, as the estimator does it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from huepose.believe.quality import quality_fits
from huepose.estimation.answer import Levels, answer_of
from huepose.estimation.config import FullPathConfig
from huepose.estimation.explanation import Explanation
from huepose.estimation.full_path import Trail, estimate_full, finish
from huepose.estimation.types import ObjectQuery
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.judge.pair_kernel import PairPicture
from huepose.judge.pair_terms import pair_picture
from huepose.model.types import ReferenceModel
from huepose.perception.types import Segmenter
from huepose.propose.evidence import Evidence, gather
from huepose.propose.template_table import TemplateTable
from huepose.refine.final import settle_on_depth
from huepose.refine.on_edges import laid_on_edges
from huepose.select.config import NearTieConfig, NearTieWeights
from huepose.select.near_ties import decided
from huepose.support.stages import StageClock, listening

Found = tuple[Float64, Float64]
"""Different poses (K, 4, 4) and their totals (K,), best first."""


@dataclass(frozen=True, eq=False)
class Ended:
    """An answer: the pose (4, 4), None where nothing is said to be there; quality; seconds: CPU time of the
    ending alone."""

    T_cam_obj: Float64 | None
    quality: float
    seconds: float


@dataclass(eq=False)
class Shared:
    """One object of one frame, and what all places start from; `seconds` are CPU time by step: `before` of
    masks and evidence, `full` of the full method's search (`finish`: its last two steps), `picture` of what
    pairs are read in, `doubt` of the first answer, which says whether there is doubt."""

    frame: RgbdFrame
    box: Box
    model: ReferenceModel
    table: TemplateTable
    masks: tuple[Bool, ...]
    evidence: Evidence
    config: FullPathConfig
    seed: tuple[int, ...]
    found: Found = field(init=False)
    trail: Trail = field(init=False)
    picture: PairPicture = field(init=False)
    in_doubt: bool = field(init=False)
    seconds: dict[str, float] = field(default_factory=dict)
    _ended: dict[tuple[bytes, ...], Ended] = field(default_factory=dict)

    def __post_init__(self) -> None:
        with listening() as clock, self.timed("full"):
            poses, totals, self.trail, self.evidence = estimate_full(
                self.model, self.table, self.evidence, self.config, np.zeros((0, 4, 4))
            )
        self.found = poses, totals
        self.seconds["finish"] = _finish_seconds(clock)
        region = self.evidence.region
        with self.timed("picture"):
            self.picture = pair_picture(self.model, region.crop, region.median_depth_m)
        first = self.ended(poses, totals, NearTieWeights().pairs, "full", True)
        self.in_doubt = first.quality < quality_fits()["full"].level
        self.seconds["doubt"] = first.seconds

    @contextmanager
    def timed(self, step: str) -> Iterator[None]:
        """Keep the CPU time of a step."""
        start = time.thread_time()
        yield
        self.seconds[step] = time.thread_time() - start

    def spent(self, *steps: str) -> float:
        """Seconds of some steps together."""
        return sum(self.seconds[step] for step in steps)

    def finished(self, step: str, more: Float64) -> Found:
        """The full method's searched poses judged together with `more` (N, 4, 4)."""
        with self.timed(step):
            every = np.concatenate([self.trail.searched, more])
            return finish(self.model, self.evidence.region, every, self.config)

    def ended(self, poses: Float64, totals: Float64, weight: float, method: str, edges: bool) -> Ended:
        """The answer made of different poses (K, 4, 4) with totals (K,), of the full method decided with this
        weight of pairs; edges: whether they have the last word."""
        start = time.thread_time()
        if method == "full":
            weights = NearTieWeights(pairs=weight)
            poses, totals, _ = decided(
                self.model, self.evidence.region, poses, totals, NearTieConfig(weights=weights)
            )
        ordering = time.thread_time() - start
        key = (poses.tobytes(), totals.tobytes(), method.encode(), b"edges" if edges else b"")
        if key not in self._ended:
            self._ended[key] = self._answer(poses, totals, method, edges)
        ended = self._ended[key]
        return Ended(ended.T_cam_obj, ended.quality, ended.seconds + ordering)

    def _answer(self, poses: Float64, totals: Float64, method: str, edges: bool) -> Ended:
        fit, query = quality_fits()[method], ObjectQuery(self.model.name, box=self.box)
        explanation = Explanation(self.box, self.masks, self.evidence, poses, totals)
        start = time.thread_time()
        answer = answer_of(
            self.frame, query, self.model, explanation, fit, Levels(fit.level, fit.found), None
        )
        seconds = time.thread_time() - start
        if edges or not answer.found:
            return Ended(answer.T_cam_obj, answer.quality, seconds)
        best = se3.orthonormalised(poses[0])
        settled, mask = settle_on_depth(self.model, self.frame, self.evidence.region, best)
        start = time.thread_time()
        laid_on_edges(self.model, self.frame, mask, settled.T_cam_obj)
        return Ended(settled.T_cam_obj, answer.quality, seconds - (time.thread_time() - start))


def shared_of(
    frame: RgbdFrame,
    box: Box,
    model: ReferenceModel,
    table: TemplateTable,
    segmenter: Segmenter,
    seed: tuple[int, ...],
) -> Shared | None:
    """What all places of a question start from; None where there is no depth in the box."""
    start = time.thread_time()
    masks = tuple(segmenter.segment(frame, box, model.diameter_m))
    evidence = gather(frame, masks, box, model.diameter_m)
    before = time.thread_time() - start
    if evidence is None:
        return None
    return Shared(
        frame, box, model, table, masks, evidence, FullPathConfig(), seed, seconds={"before": before}
    )


def _finish_seconds(clock: StageClock) -> float:
    """CPU time of the last steps of the full method: judging, the fine search, the close look."""
    spans = clock.spans
    last = sum(cpu for name in ("judge", "contest") for _, cpu in spans.get(name, []))
    return last + (spans["search"][-1][1] if len(spans.get("search", [])) > 1 else 0.0)
