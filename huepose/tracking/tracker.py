"""The tracker: frames in, poses out; late corrections in between."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from huepose.believe.state import State
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.judge.borders import Contours
from huepose.judge.open_region import PreparedSurface
from huepose.judge.silhouette import silhouette_iou
from huepose.model.types import ReferenceModel, ReferenceModels
from huepose.support.errors import InputError, require
from huepose.support.stages import stage
from huepose.tracking.catching_up import Pursuit
from huepose.tracking.claims import contested, held
from huepose.tracking.config import TrackerConfig
from huepose.tracking.history import FrameHistory
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.looks import LOOK_S
from huepose.tracking.motion import about_origin
from huepose.tracking.odometry import Odometry
from huepose.tracking.stamps import refuse_another_image, repeats, without_time
from huepose.tracking.subject import Subject
from huepose.tracking.track import Track
from huepose.tracking.tries import Tries
from huepose.tracking.types import Applied, Correction, Doubt, Key, TrackedPose, Verdict
from huepose.tracking.warm_up import warm_up

SAME_SURFACE_IOU = 0.5
"""The measured motion moves a correction to the newest frame if the outlines of the tracked and the corrected
pose overlap by more than this IoU."""

CLOCK_GAP_NS = round(LOOK_S * 1e9)
"""Assumed time between two frames if the camera's clock was set back: 30 Hz."""


class Tracker:
    """Tracks instances of known objects through the frames of one camera. Deterministic; owns their states.

    A correction with the verdict ACQUIRE creates an instance, which keeps its number during a camera epoch.

        tracker = Tracker(load_models("bundles"))
        tracker.correct(first_pose)
        for frame in camera:
            for pose in tracker.step(frame):
                ...
    """

    def __init__(self, models: Mapping[str, ReferenceModel], config: TrackerConfig | None = None) -> None:
        self.config = config or TrackerConfig()
        self._subjects: dict[str, Subject] = {}
        self._tracks: dict[Key, Track] = {}
        self._pursuits: dict[Key, Pursuit] = {}
        self._seen_seq: dict[Key, int] = {}
        self._waiting: list[Correction] = []
        self._frames = FrameHistory(self.config.history_frames, self.config.older_frames)
        self._odometry = Odometry(self.config.odometry)
        self._tries = Tries(self.config.tries_per_s)
        self._whose_turn, self._pursuit_waits, self._no_time = 0, False, 0
        for model in ReferenceModels(models).values():
            self.add_object(model)

    def add_object(self, model: ReferenceModel) -> None:
        """Add an object. One of the same name is replaced and its instances are removed."""
        self.remove_object(model.name)
        self._subjects[model.name] = Subject.of(model)

    def remove_object(self, name: str) -> None:
        """Remove an object and its instances; an unknown name is ignored."""
        self._subjects.pop(name, None)
        self.remove_instances(name)

    def remove_instances(self, name: str) -> None:
        """Remove all instances of an object, also those that have no track yet."""
        for key in [k for k in self._seen_seq if k[0] == name]:
            self.remove_instance(*key)

    def remove_instance(self, name: str, instance: int) -> None:
        """Remove one instance."""
        for known in (self._tracks, self._pursuits, self._seen_seq):
            known.pop((name, instance), None)
        self._waiting = [c for c in self._waiting if c.key != (name, instance)]

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the known objects."""
        return tuple(self._subjects)

    def surface(self, name: str) -> PreparedSurface:
        """The prepared surface of a known object. Raises InputError for an unknown one."""
        return self._subject(name, "surface").surface

    def contours(self, name: str) -> Contours:
        """The contours of a known object. Raises InputError for an unknown one."""
        return self._subject(name, "contours").contours

    def _subject(self, name: str, asked: str) -> Subject:
        if name not in self._subjects:
            raise InputError(
                asked,
                found=f"object '{name}'",
                expected=f"one of {', '.join(self._subjects) or 'no objects at all'}",
                fix="Add the object to the tracker's models.",
            )
        return self._subjects[name]

    def doubt(self, name: str, instance: int) -> Doubt | None:
        """The one reason why an instance whose pose fits the frame is not `TRACKING`; None if there is
        none."""
        track = self._tracks.get((name, instance))
        return None if track is None or not track.hypotheses else track.belief.doubt

    @property
    def reach_s(self) -> float | None:
        """Time span of the stored frames, seconds; None until the history is full."""
        if len(self._frames) < self.config.history_frames + self.config.older_frames:
            return None
        newest, oldest = self._frames.newest, self._frames.oldest
        return 0.0 if newest is None or oldest is None else (newest.stamp_ns - oldest.stamp_ns) * 1e-9

    @property
    def instances(self) -> tuple[Key, ...]:
        """(object, instance) of everything that is or was tracked in this epoch."""
        return tuple(sorted(self._tracks))

    def hypotheses(self, name: str, instance: int) -> tuple[Hypothesis, ...]:
        """The hypotheses of an instance in the newest frame, best first; empty without a pose."""
        track = self._tracks.get((name, instance))
        return () if track is None else track.hypotheses

    def warm_up(self) -> None:
        """Compile kernels and load models, so that no frame waits for them. It takes seconds if nothing is
        cached, and does not change tracked instances."""
        double = Tracker({}, self.config)
        double._subjects = dict(self._subjects)
        warm_up(self._subjects, self.config, double.step, double.correct)

    def poses(self) -> list[TrackedPose]:
        """The poses of all instances at the newest frame, corrections included."""
        frame = self._frames.newest
        if frame is None:
            return []
        return [_published(self._tracks[key], frame) for key in self.instances]

    def step(self, frame: RgbdFrame) -> list[TrackedPose]:
        """Track all instances to a new frame and return their poses there.

        A frame of another epoch removes all instances. A frame that is not newer than the last one, or the
        same image with its timestamp and a later number, is ignored and gives an empty list. Another image
        with a later number but no later timestamp is the newest: the camera's clock was set back. Raises
        InputError for anything but a frame, for another image with the number and timestamp of the newest
        frame, and for the third frame in a row without time between them.
        """
        require(frame, RgbdFrame, "frame", "an RgbdFrame")
        newest = self._frames.newest
        if newest is not None and frame.epoch != newest.epoch:
            self._forget()
            newest = None
        elif newest is not None:
            earlier = frame.stamp_ns <= newest.stamp_ns
            if earlier and frame.frame_id <= newest.frame_id:
                refuse_another_image(newest, frame)
                return []
            self._no_time = without_time(self._no_time, newest, frame)
            if repeats(newest, frame):
                return []
            if earlier:
                self._set_back(newest.stamp_ns - frame.stamp_ns + CLOCK_GAP_NS)
                newest = None
        self._tries.earn(0.0 if newest is None else (frame.stamp_ns - newest.stamp_ns) * 1e-9)
        with stage("odometry"):
            frame = self._odometry.placed(frame, partial(self._boxes, frame))
        self._frames.append(frame)
        oldest = self._frames.oldest or frame
        with stage("follow"):
            self._look(frame)
            losing = contested(self._tracks, frame)
            for key, track in self._tracks.items():
                track.update_state(frame, key in losing, oldest.stamp_ns)
        self._apply_waiting(frame)
        with stage("catch up"):
            self._catch_up()
        return self.poses()

    def _boxes(self, frame: RgbdFrame) -> list[Box]:
        """Boxes of the tracked objects in the image, by their poses in the last frame."""
        posed = [(t.subject.surface, T) for t in self._tracks.values() if (T := t.T_cam_obj) is not None]
        boxes = (surface.box(T, frame.camera) for surface, T in posed)
        return [box for box in boxes if box is not None]

    def _look(self, frame: RgbdFrame) -> None:
        """Update every instance, beginning after the last one that used a costly proposal, so that all get
        their share. While a pursuit waits for one, lost objects get none: the estimate that it follows says
        where to look."""
        tracks = list(self._tracks.items())
        first = self._whose_turn % max(len(tracks), 1)
        for offset, (key, track) in enumerate(tracks[first:] + tracks[:first], 1):
            if track.T_cam_obj is None:
                tried = self._search(key, track, frame)
            else:
                tried = track.look(frame, self._tries.whole)
            self._tries.spend(tried)
            if tried:
                self._whose_turn = first + offset - track.halfway

    def _search(self, key: Key, track: Track, frame: RgbdFrame) -> float:
        """Look for a lost instance, but not where another instance of its object is TRACKING. Returns the
        number of costly proposals used."""
        tries = 0.0 if self._pursuit_waits else self._tries.whole
        twins = [
            other.T_cam_obj
            for (name, _), other in self._tracks.items()
            if name == key[0] and other.T_cam_obj is not None and other.belief.state is State.TRACKING
        ]
        tried = track.look(frame, tries, twins)
        if held(self._tracks, key, track, frame):
            track.give_back()
        return tried

    def correct(self, correction: Correction) -> Applied:
        """Apply perception's verdict on a past frame, or on one that has not arrived yet. Raises InputError
        for an unknown object, and for anything but a correction.

        AGREE keeps the pose and raises its quality. REJECT keeps it and lowers the belief in its orientation.
        Otherwise the new pose replaces the one of its frame. The motion measured since then moves it to the
        newest frame if it was measured on the same surface; else the object is tracked again through the
        stored frames (catching up). A correction whose `seq` was seen before changes nothing.
        """
        require(correction, Correction, "correction", "a Correction", "Make one: Correction.of(pose, frame).")
        key = correction.key
        self._subject(correction.object, f"correction {correction.seq}")
        newest = self._frames.newest
        if newest is not None and correction.epoch != newest.epoch:
            return Applied.REFUSED_EPOCH
        if key in self._seen_seq and correction.seq <= self._seen_seq[key]:
            return Applied.REPEATED
        if newest is None or correction.stamp_ns > newest.stamp_ns:
            self._seen_seq[key] = correction.seq
            self._waiting = [c for c in self._waiting if c.key != key] + [correction]
            return Applied.CATCHING_UP
        if not self._frames.covers(correction.stamp_ns):
            return Applied.REFUSED_OLD
        self._seen_seq[key] = correction.seq
        return self._apply(correction)

    def _apply_waiting(self, frame: RgbdFrame) -> None:
        """Apply corrections that arrived before their frame."""
        due = [c for c in self._waiting if c.stamp_ns <= frame.stamp_ns]
        self._waiting = [c for c in self._waiting if c.stamp_ns > frame.stamp_ns]
        for correction in due:
            if correction.epoch == frame.epoch:
                self._apply(correction)

    def _apply(self, correction: Correction) -> Applied:
        key = correction.key
        track = self._tracks.get(key)
        if correction.verdict in (Verdict.AGREE, Verdict.REJECT):
            if track is None:
                return Applied.REFUSED_OLD
            if correction.verdict is Verdict.AGREE:
                track.agree(correction)
            else:
                track.disagree(correction)
        elif track is None and key not in self._pursuits and correction.verdict is Verdict.CORRECT:
            return Applied.REFUSED_OLD
        elif track is None or not self._same_surface(track, correction):
            self._pursuits[key] = Pursuit(correction, self._subjects[key[0]], self.config, track)
            newest = self._frames.newest
            if newest is None or correction.stamp_ns < newest.stamp_ns:
                return Applied.CATCHING_UP
            self._pursue(key)
            return Applied.CATCHING_UP if key in self._pursuits else Applied.APPLIED
        else:
            track.replay(correction)
            self._pursuits.pop(key, None)
        track.applied_seq = max(track.applied_seq, correction.seq)
        return Applied.APPLIED

    def _same_surface(self, track: Track, correction: Correction) -> bool:
        """Whether the motion measured since a correction's frame can move it to the newest frame."""
        old, frame = track.history.at(correction.stamp_ns), self._frames.newest
        if old is None or track.T_cam_obj is None or frame is None:
            return False
        if not track.history.unbroken_since(correction.stamp_ns):
            return False
        belief, stamp_ns = track.belief, correction.stamp_ns
        if belief.found_since(stamp_ns) or belief.can_have_turned_since(stamp_ns):
            return False
        surface, camera = track.subject.surface, frame.camera
        new = correction.T_cam_obj
        shared = silhouette_iou(
            track.subject.mesh, old, new, surface.box(old, camera), surface.box(new, camera), camera
        )
        return shared > SAME_SURFACE_IOU

    def _catch_up(self) -> None:
        """Advance each pursuit whose object has no pose, and the oldest one."""
        self._pursuit_waits = False
        if not self._pursuits:
            return
        oldest = min(self._pursuits, key=lambda k: self._pursuits[k].correction.stamp_ns)
        for key in list(self._pursuits):
            track = self._tracks.get(key)
            if track is None or track.T_cam_obj is None:
                self._pursue(key)
        if oldest in self._pursuits:
            self._pursue(oldest)

    def _pursue(self, key: Key) -> None:
        """Advance one pursuit. When it reaches the newest frame, its pose is verified, and taken or dropped.
        If the camera has turned away from the object, the pursuit ends there."""
        newest, pursuit = self._frames.newest, self._pursuits[key]
        assert newest is not None
        reached = pursuit.track.frame
        if reached is None:
            kept = self._frames.from_nearest(pursuit.correction.stamp_ns)
        else:
            kept = self._frames.since(reached.stamp_ns)
        if self._tries.whole < 1.0 and pursuit.needs_search(kept):
            self._pursuit_waits = True
            return
        self._tries.spend(pursuit.follow(kept, self._tries.whole))
        if pursuit.supported and not pursuit.arrived(newest) and not pursuit.turned_away:
            return
        del self._pursuits[key]
        track = self._tracks.get(key)
        if not pursuit.turned_away:
            self._arrive(key, pursuit, newest)
        elif track is None or track.T_cam_obj is None:
            self._track_of(key, newest).lose_from_view(pursuit.track, pursuit.correction)
        track = self._tracks.get(key)
        if track is not None:
            track.applied_seq = max(track.applied_seq, pursuit.correction.seq)

    def _track_of(self, key: Key, frame: RgbdFrame) -> Track:
        """The track of an instance; if there is none, a new one without a pose on `frame`."""
        if key not in self._tracks:
            self._tracks[key] = track = Track(self._subjects[key[0]], *key, self.config)
            track.history.append(frame.frame_id, frame.stamp_ns, None)
        return self._tracks[key]

    def _arrive(self, key: Key, pursuit: Pursuit, frame: RgbdFrame) -> None:
        """Take the pose of a pursuit that reached the newest frame if the frame supports it, no other
        instance holds its surface, and it is better than the instance's own pose. Else drop it. An instance
        that held its surface until now is not believed any more."""
        correction, found = pursuit.correction, pursuit.track
        if not pursuit.supported or held(self._tracks, key, found, frame):
            return
        track = self._track_of(key, frame)
        if track.T_cam_obj is not None and track.worth > found.worth:
            track.contradict(found, correction.quality)
            return
        track.place(found, correction, frame)
        for loser in contested(self._tracks, frame):
            self._tracks[loser].belief.give_way()
        for stamp_ns, T in pursuit.poses:
            track.history.put(stamp_ns, T)

    def _set_back(self, by_ns: int) -> None:
        """Handle a camera clock that was set back by `by_ns`: clear the stored frames, and continue the
        tracks as if the last frame had come that much earlier."""
        self._frames.clear()
        self._pursuits.clear()
        self._waiting.clear()
        for track in self._tracks.values():
            track.set_back(by_ns)

    def _forget(self) -> None:
        """Clear everything at a new camera epoch: poses and frame numbers are not valid any more."""
        self._frames.clear()
        self._tracks.clear()
        self._pursuits.clear()
        self._seen_seq.clear()
        self._waiting.clear()
        self._odometry = Odometry(self.config.odometry)
        self._tries = Tries(self.config.tries_per_s)
        self._whose_turn, self._pursuit_waits, self._no_time = 0, False, 0


def _published(track: Track, frame: RgbdFrame) -> TrackedPose:
    """The pose message of a track for a frame."""
    T = track.T_cam_obj
    return TrackedPose(
        track.object,
        track.instance,
        frame.epoch,
        frame.frame_id,
        frame.stamp_ns,
        track.belief.state,
        T,
        None if T is None else about_origin(track.subject.surface, T, track.velocity),
        track.belief.quality,
        track.covariance,
        track.applied_seq,
    )
