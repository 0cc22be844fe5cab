"""Choose the objects of the next request, and when it is sent: the time that perception takes is measured,
and deadlines follow from it.

The configured times suit a computer that keeps up. On a slower one, repeating a request before it is answered
would add work to processes that are already late."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from huepose.believe.state import State
from huepose.reinit.config import ReinitConfig
from huepose.reinit.types import ObjectSlot, Prior, RequestedObject
from huepose.tracking.types import Key, TrackedPose

NEVER = -1


@dataclass(frozen=True)
class Candidate:
    """An object that could be requested. rank: 0 lost or never seen, 1 doubtful, 2 tracked; looked_ns: when
    it was last requested, or first seen; decides: another estimate of it is probably decisive."""

    rank: int
    looked_ns: int
    requested: RequestedObject
    decides: bool = False


def missing(slot: ObjectSlot, tracks: Mapping[Key, TrackedPose], arriving: Mapping[str, int]) -> int:
    """How many instances of an object are lost or were never seen, of as many as there may be. arriving: how
    many of each object are acquired but not yet tracked."""
    posed = sum(t.T_cam_obj is not None for key, t in tracks.items() if key[0] == slot.object)
    return max(0, slot.max_instances - posed - arriving.get(slot.object, 0))


def doubtful(track: TrackedPose, config: ReinitConfig) -> bool:
    """Whether a pose is so improbable that its object is searched for elsewhere, too."""
    return track.state is State.SUSPECT and track.quality < config.least_quality


class Unsettled:
    """Which instances have been SUSPECT or LOST for a short time only: another estimate of these decides more
    than one of an object that was not found before, or of a known one."""

    def __init__(self) -> None:
        self._since: dict[Key, int] = {}

    def keys(self, now_ns: int, tracks: Mapping[Key, TrackedPose], config: ReinitConfig) -> set[Key]:
        """The instances in this state for less than `eager_ms`."""
        unsettled = [key for key, track in tracks.items() if track.state is not State.TRACKING]
        self._since = {key: self._since.get(key, now_ns) for key in unsettled}
        return {key for key, since_ns in self._since.items() if now_ns - since_ns < config.eager_ms * 1e6}


class Elsewhere:
    """For which objects a better place is searched for: those with an improbable pose for the time between
    two searches for a missing object."""

    def __init__(self) -> None:
        self._since: dict[Key, int] = {}

    def names(
        self,
        now_ns: int,
        tracks: Mapping[Key, TrackedPose],
        looked_ns: Mapping[tuple[str, int | None], int],
        config: ReinitConfig,
    ) -> set[str]:
        """Objects that get such a search now. looked_ns: when each was last searched for."""
        unlikely = [key for key, track in tracks.items() if doubtful(track, config)]
        self._since = {key: self._since.get(key, now_ns) for key in unlikely}
        waits_ns = config.patient_ms * 1e6
        return {
            name
            for (name, _), since_ns in self._since.items()
            if now_ns - max(since_ns, looked_ns.get((name, None), NEVER)) >= waits_ns
        }


class Patience:
    """Which objects were searched for without success for so long that they get a turn only now and then: a
    search of the whole image for an object that is not in it costs more than tracking five objects for as
    long."""

    def __init__(self) -> None:
        self._since: dict[str, tuple[int, int]] = {}

    def rests(self, now_ns: int, name: str, count: int, looked_ns: int, config: ReinitConfig) -> bool:
        """Whether an object with `count` missing instances is left out of the next request. looked_ns: when
        they were last searched for."""
        before, since_ns = self._since.get(name, (0, now_ns))
        if count > before:
            since_ns = now_ns
        self._since[name] = (count, since_ns)
        waits = now_ns - looked_ns < config.patient_ms * 1e6
        return waits and now_ns - since_ns >= config.eager_ms * 1e6

    def forget(self, name: str) -> None:
        """Forget an object: the search for it begins again."""
        self._since.pop(name, None)


def waiting(
    slots: Sequence[ObjectSlot],
    tracks: Mapping[Key, TrackedPose],
    counts: Mapping[str, int],
    chosen: Sequence[RequestedObject],
) -> tuple[RequestedObject, ...]:
    """The missing objects that this request does not search for. counts: how many instances of each are
    missing."""
    asked = {one.object for one in chosen if one.instance is None}
    return tuple(
        _new_instances(slot.object, counts[slot.object], _followed(slot.object, tracks))
        for slot in slots
        if counts.get(slot.object, 0) > 0 and slot.object not in asked
    )


def _followed(name: str, tracks: Mapping[Key, TrackedPose]) -> dict[TrackedPose, Prior]:
    """The instances of an object that have a pose."""
    return {
        t: Prior(t.T_cam_obj, t.velocity, t.covariance, t.stamp_ns)
        for key, t in tracks.items()
        if key[0] == name and t.T_cam_obj is not None
    }


def _new_instances(name: str, count: int, followed: Mapping[TrackedPose, Prior]) -> RequestedObject:
    """A request for `count` new instances of an object, beside those that are followed."""
    others = tuple(prior for t, prior in followed.items() if t.state is State.TRACKING)
    return RequestedObject(name, None, None, count, others=others)


def candidates(
    slots: Sequence[ObjectSlot],
    tracks: Mapping[Key, TrackedPose],
    wanted: Mapping[str, int],
    looked_ns: Mapping[tuple[str, int | None], int],
    elsewhere: Collection[str] = (),
    sighted: Collection[str] = (),
    unsettled: Collection[Key] = (),
) -> list[Candidate]:
    """All objects that could be requested. wanted: how many missing instances of each are searched for now;
    elsewhere: objects with doubtful instances only, for which a better place is searched for now; sighted:
    objects with a first uncertain sighting that waits for a second one; unsettled: see `Unsettled`."""
    lost = {name for name, instance in unsettled if tracks[name, instance].T_cam_obj is None}
    decide = {*sighted, *lost}
    out = []
    for slot in slots:
        followed, count = _followed(slot.object, tracks), wanted.get(slot.object, 0)
        if count > 0 or slot.object in elsewhere:
            asked = _new_instances(slot.object, max(count, 1), followed)
            rank = 0 if count > 0 else 1
            looked = looked_ns.get((slot.object, None), NEVER)
            out.append(Candidate(rank, looked, asked, count > 0 and slot.object in decide))
        for t, prior in followed.items():
            rank = 1 if t.state is State.SUSPECT else 2
            asked = RequestedObject(slot.object, t.instance, prior, known=t.state is State.TRACKING)
            looked = looked_ns.get(t.key, NEVER)
            out.append(Candidate(rank, looked, asked, t.key in unsettled))
    return out


def choose(
    now_ns: int, options: Sequence[Candidate], config: ReinitConfig, before: int
) -> list[RequestedObject]:
    """Lost objects first, then doubtful ones, then those not looked at for longest; ties go to the longest
    wait.

    So that objects that cannot be found do not starve the others, one that was not looked at for `stale_ms`
    gets the last place; if there is only one place, it gets that in every other request. before: number of
    requests so far. Objects for which another estimate is decisive come before all others, as many as of the
    others.
    """
    order = sorted(
        options, key=lambda c: (c.rank, c.looked_ns, c.requested.object, c.requested.instance or 0)
    )
    deciding = [c for c in order if c.decides][: config.objects_per_request]
    others = [c for c in order if c not in deciding]
    usual = others[: config.objects_per_request]
    due = [c for c in others if c.rank > 0 and now_ns - c.looked_ns >= config.stale_ms * 1e6]
    starving = [c for c in due if c not in usual]
    its_turn = len(usual) > 1 or before % 2 == 1
    if starving and usual and usual[-1].rank == 0 and its_turn:
        usual[-1] = min(starving, key=lambda c: (c.looked_ns, c.rank))
    room = config.objects_per_request - len(deciding)
    usual = [c for k, c in enumerate(usual) if k < room or c.rank == 0 or c in due]
    return [c.requested for c in (*deciding, *usual)]


LONGEST_S = 10.0
"""Longest deadline, seconds."""

PATIENCE = 1.5
"""Ratio of the deadline to the duration of the last answers."""

EACH_MORE_S = 0.15
"""Time that each object beyond the usual number adds to a deadline, seconds: four times the search for one on
two x86-64 cores, for slower ones."""


class Pace:
    """Measures how long answers to requests take."""

    def __init__(self) -> None:
        self._asked: deque[tuple[int, int]] = deque(maxlen=64)
        self._took_s = self._age_s = 0.0

    def asked(self, number: int, now_ns: int) -> None:
        """Note that a request is sent."""
        self._asked.append((number, now_ns))

    def answered(self, number: int, now_ns: int, stamp_ns: int) -> None:
        """Note an answer for a frame with that timestamp. The estimated duration rises at once and falls
        slowly."""
        self._age_s = max(0.0, (now_ns - stamp_ns) * 1e-9)
        took_s = next(((now_ns - ns) * 1e-9 for asked, ns in self._asked if asked == number), 0.0)
        self._took_s = max(took_s, 0.5 * (self._took_s + took_s))

    def expired(self, waited_s: float) -> None:
        """Note that no answer came in that time. If earlier answers took less, a process has died, and the
        next deadline stays short."""
        if waited_s >= self.deadline_s(0.0):
            self._took_s = 0.0

    @property
    def took_s(self) -> float:
        """How long the last answers took, from the request on, seconds."""
        return self._took_s

    @property
    def age_s(self) -> float:
        """Age of the frame at the last answer about it, seconds."""
        return self._age_s

    def deadline_s(self, configured_s: float, more: int = 0) -> float:
        """Deadline of the next request, seconds. more: number of objects beyond the usual number."""
        known_s = 0.0 if self._took_s <= configured_s else min(PATIENCE * self._took_s, LONGEST_S)
        return max(configured_s, known_s) + more * EACH_MORE_S

    def between_s(self, period_s: float) -> float:
        """Expected time between answers, seconds."""
        return max(period_s, min(self._took_s, LONGEST_S))
