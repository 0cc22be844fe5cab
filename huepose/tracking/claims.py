"""Which track holds a surface: tracks compete for what they explain, and one that is `TRACKING` has a bonus.
Pure functions."""

from __future__ import annotations

from collections.abc import Mapping

from huepose.believe.state import State
from huepose.geometry.frame import RgbdFrame
from huepose.tracking.competition import Claim, losers
from huepose.tracking.track import Track
from huepose.tracking.types import Key

TRACKING_BONUS = 0.1
"""Bonus, in units of the total, of a TRACKING pose when two compete for a surface."""

TWIN_BONUS = 1.0
"""Bonus, in units of the total, of a tracked instance against a new one of the same object at its place."""


def contested(tracks: Mapping[Key, Track], frame: RgbdFrame) -> set[Key]:
    """Instances whose surface another instance explains better."""
    keys = [k for k, t in tracks.items() if t.T_cam_obj is not None]
    claims = [_claim(tracks[key]) for key in keys]
    return {keys[i] for i in losers(claims, frame.depth, frame.camera)}


def held(tracks: Mapping[Key, Track], key: Key, found: Track, frame: RgbdFrame) -> bool:
    """Whether another instance explains the surface better on which this one was found. A tracked instance of
    the same object keeps its surface."""
    if found.T_cam_obj is None:
        return False
    claims = [
        _claim(other, TWIN_BONUS if name == key[0] else 0.0)
        for (name, instance), other in tracks.items()
        if (name, instance) != key and other.T_cam_obj is not None
    ]
    # The found pose gets no bonus, whatever the state of its instance elsewhere.
    mine = Claim(found.subject.surface, found.T_cam_obj, found.terms.total)
    return len(claims) in losers([*claims, mine], frame.depth, frame.camera)


def _claim(track: Track, bonus: float = 0.0) -> Claim:
    """The claim of a track with a pose. TRACKING gives a bonus: else two instances with the same pose would
    lose in turns."""
    assert track.T_cam_obj is not None
    confirmed = TRACKING_BONUS if track.belief.state is State.TRACKING else 0.0
    return Claim(track.subject.surface, track.T_cam_obj, track.terms.total + confirmed + bonus)
