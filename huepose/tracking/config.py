"""Settings of a tracker; the defaults are those of a live pipeline."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.support.errors import InputError


@dataclass(frozen=True)
class TrackerConfig:
    """Memory. history_frames, older_frames: how many frames are stored for late corrections: the newest ones,
    and older ones, of which half are a tenth and half a sixth of a second apart; catch_up_stride: most frames
    that one step of catching up advances.

    States. tracking_quality, suspect_quality: evidence above the first in two looks in a row leads to
    TRACKING, evidence below the second to SUSPECT; confirmed_identity: identity that an acquired pose needs
    to be TRACKING: less than one in twenty is wrong; confirmed_turn: the same for the orientation;
    least_quality: no pose with a lower published quality is TRACKING; lost_quality: a frame with less
    evidence does not support the pose; after lost_after such looks in a row an object is LOST. A frame less
    than a thirtieth of a second after the last one is a part of a look (`tracking.looks`).

    Search (totals of the judge, 0 to 1.9). doubtful_total: if the best pose has a lower total, more poses are
    tried; doubt: also if its total is this much below the usual total; long_doubt: the same for a frame more
    than long_step_s after the last one, when there is time for a search. Then there is a search, too, if the
    pose is more than surprising_m from the expected one. hidden: if a larger share of the surface is
    occluded, a frame without such a gap makes no search. max_search_m_s, max_search_rad_s: the fastest motion
    that the search covers; tries_per_s: how many costly proposals (a search, a part of a wide search, or
    near-symmetric rotations) all objects together may make in a second of the frames' time, None for no
    limit. They cost 5 to 18 ms each, and a live step that takes longer than its frame makes the next one
    larger. 30 per second take half of the time, and a late step gets no more than those of a third of a
    second.

    odometry: fast camera motion is measured where no camera pose is given (`tracking.odometry`)."""

    history_frames: int = 20
    older_frames: int = 24
    catch_up_stride: int = 3
    tracking_quality: float = 0.6
    suspect_quality: float = 0.5
    lost_quality: float = 0.25
    confirmed_identity: float = 0.95
    confirmed_turn: float = 0.9
    least_quality: float = 0.75
    lost_after: int = 5
    doubtful_total: float = 0.9
    doubt: float = 0.2
    long_doubt: float = 0.1
    long_step_s: float = 0.1
    surprising_m: float = 0.03
    hidden: float = 0.6
    tries_per_s: float | None = 30.0
    max_search_m_s: float = 0.8
    max_search_rad_s: float = 7.0
    odometry: bool = True

    def __post_init__(self) -> None:
        if not self.history_frames >= 2:
            raise InputError(
                "tracker: history_frames", found=str(self.history_frames), expected="2 or more", fix="Use 20."
            )
        if self.older_frames < 0:
            raise InputError("tracker: older_frames", found=str(self.older_frames), expected="0 or more")
        if not 0 <= self.lost_quality <= self.suspect_quality <= self.tracking_quality <= 1:
            raise InputError(
                "tracker: qualities",
                found=f"{self.lost_quality}, {self.suspect_quality}, {self.tracking_quality}",
                expected="0 <= lost_quality <= suspect_quality <= tracking_quality <= 1",
                fix="Leave them at their defaults.",
            )
