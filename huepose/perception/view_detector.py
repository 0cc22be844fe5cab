"""The default detector: finds objects in a whole frame by their reference models, without training on them.

Planes larger than any object are removed. In the rest, windows of the object's metric size are compared
with its rendered views by their codes (`propose.view_codes`), and the model's keypoints are matched. The
resulting poses are scored, aligned with the depth and refined. The best places are returned, each with the
box of what is visible there. An absent object gets places too, with low scores: the estimator decides.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from huepose.believe.logistic import probability
from huepose.believe.presence import logits_of
from huepose.colorpair.opponents import unveiled
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.judge.borders import Contours
from huepose.judge.silhouette import taken_by
from huepose.model.types import ReferenceModel, ReferenceModels
from huepose.perception.attention import Attention, attended
from huepose.perception.clear_view import ClearView, clear_view, thin, whole_view
from huepose.perception.config import DetectorConfig
from huepose.perception.lying import Lying
from huepose.perception.memory import Memory, features_of, next_look
from huepose.perception.presence import sights_of
from huepose.perception.scouting import EFFORTS, Effort, Proposal, propose, visible_part
from huepose.perception.types import Detection
from huepose.perception.window_table import window_table
from huepose.perception.windows import WindowsBySize
from huepose.propose.features import Features, FeatureSource, Sift
from huepose.propose.keypoint_reference import build_keypoints
from huepose.propose.keypoints import ImageFeatures, ModelKeypoints, consensus_poses, match
from huepose.rendering.render import render
from huepose.select.distinct import HALF, share_held
from huepose.support.kept import kept, once_for_each
from huepose.support.pool import Pool
from huepose.support.stages import stage

COMPETING = 3
"""At least this many places of each object compete with those of the others. Chosen for time."""

AT_ONCE = 6
"""Most places that are proposed because several instances of an object are wanted. Chosen for time: each
place takes an estimate."""

HOLE_PX = 9
"""Side of the square, pixels, by which the clear part grows into pixels without depth: specular highlights
leave holes."""


class ViewDetector:
    """Finds known objects in whole frames. Thread-safe. Stateless, unless `DetectorConfig.remembering` says
    that all frames come from one camera."""

    def __init__(self, models: Mapping[str, ReferenceModel], config: DetectorConfig | None = None) -> None:
        self.config = config or DetectorConfig()
        self._models = ReferenceModels({})
        self._features: FeatureSource = Sift()
        self._keypoints_of = once_for_each(self._kept_keypoints)
        self._lock = threading.Lock()
        self._memory: Memory | None = None
        self._attention = Attention()
        self._pool = Pool(self.config.threads)
        for model in models.values():
            self.add(model)

    def add(self, model: ReferenceModel) -> None:
        """Add an object, or replace its model."""
        with self._lock:
            self._models[model.name] = model

    def remove(self, name: str) -> None:
        """Remove an object; an unknown name is ignored."""
        with self._lock:
            self._models.pop(name, None)

    def detect(
        self,
        frame: RgbdFrame,
        names: Sequence[str],
        thorough: Collection[str] | None = None,
        followed: Mapping[str, Sequence[Float64]] | None = None,
        wanted: Mapping[str, int] | None = None,
        waiting: Sequence[str] = (),
    ) -> list[Detection]:
        """Boxes of the named objects, best first. Raises InputError for an unknown name.

        thorough: objects that get the full search if a first one does not find them; default all. The
        others get the first search alone, a third of the time. followed: poses T_cam_obj (4, 4) of known
        instances, by object; their depth is ignored, so that further instances are found. wanted: how many
        new instances of an object are searched for, default one; at least as many places are proposed, up
        to AT_ONCE. waiting: further objects. With `remembering`, those that something new in the image
        looks like are searched for as well, by a first search."""
        with self._lock:
            models = {name: self._models[name] for name in (*names, *waiting)}
            largest_m = max((model.diameter_m for model in self._models.values()), default=0.0)
        with stage("veil"):
            unveiled_frame = unveiled(frame)
        with stage("clear view"):
            view = clear_view(unveiled_frame, largest_m)
        by_keypoints = "keypoints" in self.config.sources
        thorough = list(names) if thorough is None else thorough
        flat = {name for name in names if by_keypoints and name in thorough and thin(models[name])}
        if view is None and flat:
            view = whole_view(unveiled_frame, largest_m)
        if view is None:
            return []
        memory = None
        if self.config.remembering:
            with stage("memory"):
                memory = next_look(self._memory, frame)
            if memory.look == 0:
                self._attention = Attention()
        features, windows = _FeaturesOnce(self._features, view, memory), WindowsBySize(view, memory)
        if memory is not None and waiting:
            with stage("attention"):
                names = [*names, *self._noticed(memory, windows, models, waiting)]
        several = {name: min((wanted or {}).get(name, 1), AT_ONCE) for name in names}
        proposals = {name: max(self.config.proposals, several[name]) for name in names}
        lying = Lying(self._features, view)

        def places_of(name: str) -> list[Proposal]:
            model, known = models[name], (followed or {}).get(name, ())
            most = max(proposals[name], COMPETING) if len(names) > 1 else proposals[name]
            free = view.without(taken_by(model, unveiled_frame, known)) if known else view
            proposed = propose(
                model,
                window_table(model),
                free,
                windows.of(model.diameter_m),
                most,
                self._efforts(name, thorough),
                partial(self._guessed, model, free, features) if by_keypoints else None,
                several[name],
            )
            with stage("presence"):
                rated = _rated(free, model, proposed)
            if name in flat and (found := lying.places(model, self._keypoints_of(model), known, most)):
                raised, proposed = found
                with stage("presence"):
                    rated += _rated(raised, model, [_supported(free, model, p) for p in proposed])
            return rated

        places = dict(zip(names, self._pool.map(places_of, names), strict=True))
        if memory is not None:
            kept = {**memory.windows, **windows.kept()}
            self._memory = replace(memory, windows=kept, features=features.kept)
        with stage("contest"):
            places = contested(places)
        found = [
            Detection(name, p.box, probability(p.score), p.T_cam_obj)
            for name, mine in places.items()
            for p in mine[: proposals[name]]
        ]
        return sorted((d for d in found if d.score >= self.config.min_score), key=lambda d: -d.score)

    def _noticed(
        self,
        memory: Memory,
        windows: WindowsBySize,
        missing: Mapping[str, ReferenceModel],
        waiting: Sequence[str],
    ) -> list[str]:
        """The waiting objects that are searched for in this frame as well: something new looks like
        them."""
        views = [(name, model.diameter_m, window_table(model)) for name, model in missing.items()]
        attention = attended(self._attention, memory, windows, views)
        picked = attention.picked(waiting)
        self._attention = attention.after((set(missing) - set(waiting)).union(picked), missing)
        return picked

    def _guessed(self, model: ReferenceModel, view: ClearView, features: _FeaturesOnce) -> Float64:
        """Poses (K, 4, 4) of an object from its keypoints in a view."""
        found, keypoints = features.spots(), self._keypoints_of(model)
        with stage("keypoints"):
            if view.taken is not None:
                found = ImageFeatures.of(found.features[view.free(found.features.pixels)])
            return consensus_poses(match(keypoints, found), view.crop.depth, view.crop.camera).poses

    def warm_up(self) -> None:
        """Load the views of all objects, and compile the kernels on a rendered frame of the first."""
        for model in list(self._models.values()):
            window_table(model)
            Contours.of(model)
            if "keypoints" in self.config.sources:
                self._keypoints_of(model)
        for model in list(self._models.values())[:1]:
            camera = Camera(300.0, 300.0, 159.5, 119.5, 320, 240)
            distance = max(0.5, 3.0 * model.diameter_m)
            T = se3.make(np.eye(3), np.array([0.0, 0.0, distance]) - model.mesh.centre)
            rendering = render([(model.mesh, T)], camera)
            depth = np.where(rendering.depth > 0, rendering.depth, np.float32(1.5 * distance))
            self.detect(RgbdFrame(rendering.color, depth.astype(np.float32), camera), [model.name])

    def _kept_keypoints(self, model: ReferenceModel) -> ModelKeypoints:
        return kept(ModelKeypoints, model.digest, partial(self._matching_keypoints, model))

    def _matching_keypoints(self, model: ReferenceModel) -> ModelKeypoints:
        found = model.keypoints
        if found.source != self._features.name:
            found = build_keypoints(model.mesh, model.diameter_m, self._features)
        return ModelKeypoints.of(found)

    def _efforts(self, name: str, thorough: Collection[str]) -> tuple[Effort, ...]:
        if "views" not in self.config.sources:
            return ()
        return EFFORTS if name in thorough else EFFORTS[:1]


class _FeaturesOnce:
    """The image features of a view, extracted at the first request. kept: what the memory keeps of them."""

    def __init__(self, source: FeatureSource, view: ClearView, memory: Memory | None) -> None:
        self._source, self._view, self._memory = source, view, memory
        self.kept = None if memory is None else memory.features
        self._spots: ImageFeatures | None = None
        self._lock = threading.Lock()

    def spots(self) -> ImageFeatures:
        """The features, with the neighbours of each."""
        with self._lock:
            if self._spots is None:
                with stage("features"):
                    self._spots = ImageFeatures.of(self._extracted())
            return self._spots

    def _extracted(self) -> Features:
        view, crop = self._view, self._view.crop
        near = cv2.dilate(view.clear.view(np.uint8), np.ones((HOLE_PX, HOLE_PX), np.uint8)) > 0
        shown = view.clear | (near & (crop.depth == 0))
        if self._memory is None:
            return self._source.extract(crop.color, shown)
        self.kept = features_of(self._memory, view, shown, self._source)
        found, corner = self.kept.features, np.array([crop.x0, crop.y0], np.float32)
        pixels = found.pixels - corner
        last = np.array([shown.shape[1] - 1, shown.shape[0] - 1])
        within = np.asarray(((pixels >= 0) & (pixels <= last)).all(1))
        return replace(found, pixels=pixels)[within]


def _supported(view: ClearView, model: ReferenceModel, proposal: Proposal) -> Proposal:
    """A proposal from another view of the frame, with its support counted in this view."""
    measured = replace(view, crop=replace(view.crop, depth=view.depth))
    visible = visible_part(model, measured, proposal.T_cam_obj)
    return replace(proposal, support=np.zeros(0, np.int64) if visible is None else visible[1])


def _rated(view: ClearView, model: ReferenceModel, proposals: Sequence[Proposal]) -> list[Proposal]:
    """The best pose at each place; its score is the log-odds that the object is there."""
    poses = [(model.name, p.T_cam_obj) for p in proposals]
    logits = logits_of(sights_of(view, {model.name: model}, poses, verifying=False))
    best: dict[int, Proposal] = {}
    for p, x in zip(proposals, logits, strict=True):
        if p.place not in best or x > best[p.place].score:
            best[p.place] = replace(p, score=float(x))
    return list(best.values())


LEAD = 0.7
"""A place is lost to another object that has log-odds higher by more than this and explains over half of
the same surface."""

FALL = 1.5
"""Penalty, in log-odds, of a place that is lost to another object."""


def contested(proposals: Mapping[str, Sequence[Proposal]]) -> dict[str, list[Proposal]]:
    """The proposals of each object, best first, after a penalty on places that another object explains
    better. Only the best place of an object counts against others."""
    leaders = {name: max(places, key=lambda p: p.score) for name, places in proposals.items() if places}
    out = {}
    for name, places in proposals.items():
        rivals = [leader for other, leader in leaders.items() if other != name]
        fallen = [replace(p, score=p.score - FALL) if _lost(p, rivals) else p for p in places]
        out[name] = sorted(fallen, key=lambda p: -p.score)
    return out


def _lost(place: Proposal, rivals: Sequence[Proposal]) -> bool:
    better = [rival.support for rival in rivals if rival.score > place.score + LEAD]
    return bool(better) and share_held(place.support, np.unique(np.concatenate(better))) > HALF
