"""The re-initialisation loop: a scheduler and a judge, as a pure state machine; the time is an argument.

    request = loop.tick(now_ns, tracks)          # at least at the period; None: nothing to ask
    for c in loop.repeats(now_ns): ...           # corrections that were not acknowledged yet
    for c in loop.answer(now_ns, result): ...    # when perception answers

`tracks` are the newest published poses. The loop publishes only corrections; `searching` lists the objects
that are still missing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from huepose.believe.state import State
from huepose.estimation.types import PoseEstimate
from huepose.perception.config import PICKED
from huepose.reinit.answered import Answered, Frame, held
from huepose.reinit.config import ReinitConfig
from huepose.reinit.judge import acquires, assign, denies_orientation, judge_tracked, near, pose_of, usable
from huepose.reinit.newest_frame import Began, NewestFrame
from huepose.reinit.outbox import Outbox
from huepose.reinit.published_history import PublishedHistory
from huepose.reinit.schedule import (
    NEVER,
    Elsewhere,
    Pace,
    Patience,
    Unsettled,
    candidates,
    choose,
    doubtful,
    missing,
    waiting,
)
from huepose.reinit.sightings import Sightings
from huepose.reinit.types import Counters, ObjectSlot, PerceptionResult, Request, Searching
from huepose.tracking.types import Correction, Key, TrackedPose, Verdict

PATIENCE_PERIODS = 2.0
"""For this many periods after an acquisition its instance counts as arriving, and no other one is requested
in its place."""

ADOPTED_BELOW = 2**20
"""Tracks with instance numbers below this are adopted from an earlier loop. Higher ones, from whatever
source, are ignored, which leaves two thousand million numbers for new instances."""


class ReinitLoop:
    """Decides what perception looks for, and what its estimates mean for the tracks."""

    def __init__(
        self, config: ReinitConfig | None = None, objects: Iterable[ObjectSlot | tuple[str, int]] = ()
    ) -> None:
        self.config = config or ReinitConfig()
        self.counters = Counters()
        self._slots: dict[str, ObjectSlot] = {}
        self._tracks: dict[Key, TrackedPose] = {}
        self._past = PublishedHistory()
        self._outbox = Outbox()
        self._pace = Pace()
        self._patience, self._elsewhere, self._unsettled = Patience(), Elsewhere(), Unsettled()
        self._answered = Answered()
        self._sightings = Sightings()
        self._last_instance: dict[str, int] = {}
        self._over: dict[str, int] = {}
        self._judged_ns: dict[str, int] = {}
        self._looked_ns: dict[tuple[str, int | None], int] = {}
        self._in_flight: Request | None = None
        self._now_ns = self._next_ns = self._asked_ns = 0
        self._newest = NewestFrame()
        for slot in objects:
            self.add(slot if isinstance(slot, ObjectSlot) else ObjectSlot(*slot))

    def add(self, slot: ObjectSlot) -> None:
        """Search for an object, or change how many instances of it are searched for."""
        self._slots[slot.object] = slot

    def begin_at(self, name: str, number: int) -> None:
        """Give no new instance of an object a number lower than this: an earlier loop has ended those."""
        self._over[name] = number - 1
        self._last_instance[name] = max(self._last_instance.get(name, -1), number - 1)

    def remove(self, name: str, now_ns: int = 0) -> tuple[int, int] | None:
        """Stop searching for an object. Returns which instances this ends, as `forget` does."""
        self._slots.pop(name, None)
        return self.forget(name, now_ns)

    def forget(self, name: str, now_ns: int = 0) -> tuple[int, int] | None:
        """Search for an object again: its instances end, and no answer for a frame before `now_ns` counts.

        Returns the camera epoch and the lowest number that a new instance of it may get: from now on the
        caller passes no track of that epoch with a lower one to `tick`. None before the first epoch."""
        self._tracks = {key: track for key, track in self._tracks.items() if key[0] != name}
        self._past.forget(name)
        self._patience.forget(name)
        self._answered.forget(name)
        self._looked_ns = {asked: at_ns for asked, at_ns in self._looked_ns.items() if asked[0] != name}
        arriving = [k[1] for k in self._outbox.instances if k[0] == name]
        last = max([self._last_instance.get(name, -1), *arriving])
        self._last_instance[name] = self._over[name] = last
        self._outbox.forget(name)
        self._sightings.forget(name)
        self._judged_ns[name] = max(now_ns, self._judged_ns.get(name, 0))
        epoch = self._newest.epoch
        return None if epoch is None else (epoch, last + 1)

    def searching(self) -> list[Searching]:
        """Objects of which instances were never seen in this epoch."""
        out = []
        for slot in self._slots.values():
            missing = slot.max_instances - sum(key[0] == slot.object for key in self._tracks)
            if missing > 0:
                out.append(Searching(slot.object, missing))
        return out

    def tick(self, now_ns: int, tracks: Sequence[TrackedPose], frame: Frame | None = None) -> Request | None:
        """Take over the newest published poses. Returns the next request if one is due and none is in flight.
        frame: the newest frame of the camera as far as known, for the counters only."""
        self._now_ns = now_ns
        self._observe(now_ns, tracks)
        self._outbox.acknowledge(self._tracks)
        for correction in self._outbox.give_up(now_ns, self.config.give_up_ms * 1e6):
            self.counters.given_up += 1
            if correction.verdict is Verdict.ACQUIRE:
                # For a tracked instance perception has no news before the next frame.
                self._answered.forget(correction.object)
        if self._in_flight is not None and now_ns >= self._in_flight.deadline_ns:
            was_held = held(self._in_flight, self._tracks.values(), frame)
            self.counters.held += was_held
            self.counters.expired += not was_held
            self._pace.expired((self._in_flight.deadline_ns - self._asked_ns) * 1e-9)
            self._in_flight = None
        if self._in_flight is not None or now_ns < self._next_ns:
            return None
        elsewhere = self._elsewhere.names(now_ns, self._tracks, self._looked_ns, self.config)
        counts = self._missing()
        wanted = self._wanted(now_ns, counts)
        unsettled = self._unsettled.keys(now_ns, self._tracks, self.config)
        sighted = self._sightings.due()
        slots = list(self._slots.values())
        options = candidates(slots, self._tracks, wanted, self._looked_ns, elsewhere, sighted, unsettled)
        chosen = choose(now_ns, options, self.config, self.counters.requests)
        if not chosen:
            return None
        for asked in chosen:
            self._looked_ns[asked.object, asked.instance] = now_ns
            if asked.instance is None:
                self._sightings.asked(asked.object, self.counters.requests + 1)
        period_ns = round(self.config.period_ms * 1e6)
        # Ticks are not exact: a request that is a little late does not delay the next ones.
        in_rhythm = now_ns - self._next_ns < period_ns
        self._next_ns = (self._next_ns if in_rhythm else now_ns) + period_ns
        self.counters.requests += 1
        self._asked_ns = now_ns
        self._pace.asked(self.counters.requests, now_ns)
        others, more = waiting(slots, self._tracks, counts, chosen), 0
        if self.counters.answers:  # Until then perception may not be running: request again soon.
            more = max(0, len(chosen) - self.config.objects_per_request) + min(len(others), PICKED)
        deadline_ns = now_ns + round(self._pace.deadline_s(1e-3 * self.config.deadline_ms, more) * 1e9)
        # In each request one missing object is searched for everywhere, in turns; one turn is spare.
        seen = self._answered.seen(chosen, self.config.objects_per_request + 1)
        self._in_flight = Request(
            self.counters.requests, self._newest.epoch, deadline_ns, tuple(chosen), seen, others
        )
        return self._in_flight

    def perception_begins(self) -> None:
        """A perception worker has started: it did not receive earlier requests, so the next tick makes one.
        Before the first answer, the time of the searches so far does not count."""
        self._in_flight, self._next_ns = None, 0
        if not self.counters.answers:
            self._patience = Patience()

    def _missing(self) -> dict[str, int]:
        """How many instances of each object are missing."""
        arriving = self._arriving()
        return {name: missing(slot, self._tracks, arriving) for name, slot in self._slots.items()}

    def _wanted(self, now_ns: int, counts: Mapping[str, int]) -> dict[str, int]:
        """How many missing instances of each object may be requested now: none of an object that rests
        (`Patience`), unless a first uncertain sighting of it waits for a second one."""
        out = {}
        for name, count in counts.items():
            looked_ns = self._looked_ns.get((name, None), NEVER)
            rests = self._patience.rests(now_ns, name, count, looked_ns, self.config)
            out[name] = 0 if rests and not self._sightings.recent(name, now_ns) else count
        return out

    @property
    def answer_age_s(self) -> float:
        """Age of the frame of perception's last answer when that came, seconds."""
        return self._pace.age_s

    @property
    def answer_took_s(self) -> float:
        """How long perception's last answers took, from the request on, seconds."""
        return self._pace.took_s

    def repeats(self, now_ns: int) -> list[Correction]:
        """Corrections that no pose has acknowledged for a period, to be sent again."""
        out = self._outbox.due(now_ns, self.config.period_ms * 1e6)
        self.counters.resent += len(out)
        return out

    def answer(self, now_ns: int, result: PerceptionResult) -> list[Correction]:
        """Judge an answer. Returns the corrections to send now. An answer to an expired request is still used
        if nothing newer was judged meanwhile. An answer for another epoch, or from before the clock was set
        back, is not used."""
        self._now_ns = now_ns
        self.counters.answers += 1
        self._pace.answered(result.request, now_ns, result.stamp_ns)
        if self._in_flight is not None and result.request == self._in_flight.number:
            self._answered.note(self._in_flight.objects, (result.epoch, result.frame_id))
            self._in_flight = None
        else:
            self.counters.late += 1
        frame = (result.epoch, result.frame_id, result.stamp_ns)
        self._observe_frame(*frame)
        if not self._newest.is_of(*frame):
            self.counters.wrong_epoch += 1
            return []
        out = []
        for name in dict.fromkeys(e.object for e in result.estimates):
            slot = self._slots.get(name)
            if slot is None or result.stamp_ns < self._judged_ns.get(name, 0):
                continue
            self._judged_ns[name] = result.stamp_ns
            estimates = [e for e in result.estimates if e.object == name]
            out += self._judge(slot, estimates, result)
        for correction in out:
            self._outbox.send(correction, now_ns)
            self._looked_ns[correction.key] = now_ns
        return out

    def _judge(
        self, slot: ObjectSlot, estimates: list[PoseEstimate], result: PerceptionResult
    ) -> list[Correction]:
        """Verdicts on all estimates of one object."""
        found = [e for e in estimates if usable(e, self.config)]
        self.counters.rejected += len(estimates) - len(found)
        tracked = [t for t in self._tracks.values() if t.object == slot.object and t.T_cam_obj is not None]
        priors = [self._past.at(t, result.stamp_ns, slot.middle_obj) for t in tracked]
        poses = [pose_of(e) for e in found]
        expected = [prior.predicted(result.stamp_ns, slot.middle_obj) for prior in priors]
        sure = [t.state is State.TRACKING and slot.max_instances > 1 for t in tracked]
        assigned = assign(poses, priors, result.stamp_ns, slot, sure)
        out = []
        for estimate, which in zip(found, assigned, strict=True):
            if which is not None:
                track = tracked[which]
                compared = estimate
                if estimate.instance != track.instance:  # scored against another instance's pose
                    compared = replace(estimate, prior_score=None, prior_T_cam_obj=None)
                verdict = judge_tracked(
                    compared, priors[which], result.stamp_ns, track.state, slot, self.config
                )
                self._count(verdict)
                if verdict is not Verdict.REJECT or denies_orientation(
                    compared, priors[which], result.stamp_ns, slot
                ):
                    key = (slot.object, track.instance)
                    out.append(self._correction(key, estimate, result, verdict))
            elif any(near(pose_of(estimate), T, slot) for T in expected):
                # A second estimate of an instance that already has one.
                self._count(Verdict.REJECT)
            else:
                correction = self._acquire(slot, estimate, result, out)
                if correction is not None:
                    out.append(correction)
        return out

    def _acquire(
        self, slot: ObjectSlot, estimate: PoseEstimate, result: PerceptionResult, before: Sequence[Correction]
    ) -> Correction | None:
        """The correction for an estimate of no tracked instance: of a lost one, or of one never seen; None
        while it is held back."""
        T = pose_of(estimate)
        taken = [c for c in before if c.verdict is Verdict.ACQUIRE]
        if any(near(T, c.T_cam_obj, slot) for c in taken):
            self._count(Verdict.REJECT)
            return None
        key = self._free_instance(slot, {c.key for c in taken})
        if key is None:
            self._count(Verdict.REJECT)
            return None
        if not acquires(estimate, self.config):
            # In each request perception searches for one object with full effort, in turns.
            wait_s = (2 + len(self._slots)) * self._pace.between_s(1e-3 * self.config.period_ms)
            first = self._sightings.confirming(slot, estimate, result.stamp_ns, result.request, wait_s)
            if first is None:
                self.counters.unconfirmed += 1
                return None
            # Two estimates from one viewpoint repeat the same errors: together they count as the better one.
            known = [e.present for e in (estimate, first) if e.present is not None]
            quality, present = max(estimate.quality, first.quality), max(known, default=None)
            estimate = replace(estimate, quality=quality, present=present)
        self._sightings.forget(slot.object)
        self._last_instance[slot.object] = max(self._last_instance.get(slot.object, -1), key[1])
        self._count(Verdict.ACQUIRE)
        return self._correction(key, estimate, result, Verdict.ACQUIRE)

    def _free_instance(self, slot: ObjectSlot, taken: set[Key]) -> Key | None:
        """The instance of a new pose: the lost one with the newest timestamp; else a new number if there may
        be more; else the most doubtful one. None if all are tracked or arriving."""
        mine = [t for t in self._tracks.values() if t.object == slot.object]
        coming = {*self._fresh(), *taken}
        here = {t.key for t in mine if t.T_cam_obj is not None} | {k for k in coming if k[0] == slot.object}
        lost = [t for t in mine if t.T_cam_obj is None and (slot.object, t.instance) not in coming]
        if lost and len(here) < slot.max_instances:
            return (slot.object, max(lost, key=lambda t: (t.stamp_ns, -t.instance)).instance)
        never_came = [
            k
            for k in self._outbox.instances
            if k[0] == slot.object and k not in coming and k not in self._tracks
        ]
        if never_came:
            return max(never_came)
        arriving = [k for k in (*self._outbox.instances, *taken) if k[0] == slot.object]
        known = {t.key for t in mine} | set(arriving)
        if len(known) >= slot.max_instances:
            unlikely = [
                t for t in mine if doubtful(t, self.config) and (slot.object, t.instance) not in coming
            ]
            worst = min(unlikely, key=lambda t: t.quality, default=None)
            return None if worst is None else (slot.object, worst.instance)
        numbers = [k[1] for k in known] + [self._last_instance.get(slot.object, -1)]
        return (slot.object, max(numbers) + 1)

    def _correction(
        self, key: Key, estimate: PoseEstimate, result: PerceptionResult, verdict: Verdict
    ) -> Correction:
        seq = self._outbox.next_seq(key, self._now_ns)
        frame = (result.epoch, result.frame_id, result.stamp_ns)
        return Correction(
            *key,
            *frame,
            pose_of(estimate),
            estimate.quality,
            verdict,
            seq,
            reason=estimate.reason,
            present=estimate.present,
        )

    def _arriving(self) -> dict[str, int]:
        """How many instances of each object are acquired but have no published pose yet."""
        tracked = {key for key, track in self._tracks.items() if track.T_cam_obj is not None}
        return Counter(key[0] for key in self._fresh() if key not in tracked)

    def _fresh(self) -> tuple[Key, ...]:
        """Instances with a correction that the tracker may still apply."""
        return self._outbox.arriving(self._now_ns, PATIENCE_PERIODS * self.config.period_ms * 1e6)

    def _observe(self, now_ns: int, tracks: Sequence[TrackedPose]) -> None:
        """Take over the published poses of the newest epoch. An instance without a published pose is no
        longer tracked."""
        for track in sorted(tracks, key=lambda t: t.stamp_ns):
            self._observe_frame(track.epoch, track.frame_id, track.stamp_ns)
        self._tracks = {t.key: t for t in tracks if self._may_be_tracked(t)}
        for track in self._tracks.values():
            self._past.note(track)
        for name, instance in self._tracks:
            # New ones come before those that were requested now.
            self._looked_ns.setdefault((name, instance), now_ns - 1)
            self._last_instance[name] = max(self._last_instance.get(name, -1), instance)

    def _may_be_tracked(self, track: TrackedPose) -> bool:
        """Whether a track is of this epoch and clock, and of an instance that a loop may have made."""
        mine = track.instance <= self._last_instance.get(track.object, -1)
        counts = self._newest.is_of(track.epoch, track.frame_id, track.stamp_ns)
        return counts and (mine or track.instance < ADOPTED_BELOW)

    def _observe_frame(self, epoch: int, frame_id: int, stamp_ns: int) -> None:
        """A newer epoch deletes everything about the older one. A clock that was set back deletes everything
        about earlier timestamps."""
        began = self._newest.note(epoch, frame_id, stamp_ns)
        if began is Began.NOTHING:
            return
        self._past.clear()
        self._outbox.clear()
        self._sightings.clear()
        self._judged_ns.clear()
        if began is Began.EPOCH:
            self._tracks.clear()
            # Numbers begin again, but not those that `forget` has ended.
            self._last_instance = dict(self._over)
            self._looked_ns.clear()
            self._patience, self._elsewhere, self._unsettled = Patience(), Elsewhere(), Unsettled()

    def _count(self, verdict: Verdict) -> None:
        c = self.counters
        c.agreed += verdict is Verdict.AGREE
        c.corrected += verdict is Verdict.CORRECT
        c.acquired += verdict is Verdict.ACQUIRE
        c.rejected += verdict is Verdict.REJECT
