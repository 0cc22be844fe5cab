"""What can be set about a tracker; the defaults are those of a live pipeline."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.support.errors import InputError


@dataclass(frozen=True)
class TrackerConfig:
    """Memory. history_frames, older_frames: frames that are kept for late corrections: the newest ones, and
    behind them others that lie a tenth and a sixth of a second apart, half of them each; catch_up_stride:
    most frames skipped at once while catching up.

    States. tracking_quality, suspect_quality: evidence over the first in two frames in a row leads to
    TRACKING, under the second to SUSPECT; confirmed_identity: how sure it must be that an acquired pose is
    the right one before it is TRACKING: less than one in twenty is wrong; confirmed_turn: how sure, which way
    round the object is; least_quality: no pose of a lower published quality is TRACKING; lost_quality: under
    it a frame gives no support; lost_after such looks in a row make an object LOST. A frame that comes less
    than a thirtieth of a second after the last one is a part of a look (`tracking.looks`).

    Looking further (totals of the judge, 0 to 1.9). doubtful_total: a pose that explains less is looked into;
    doubt: so is one this much under its baseline, long_doubt: after more than long_step_s, when there
    is time for a search, as there is when it moved by more than surprising_m; hidden: share of the surface
    behind something from which there is nothing to look for. max_search_m_s, max_search_rad_s: the fastest
    motion that the search covers; tries_per_s: how many costly proposals (a search or a part of a wide one,
    near-symmetric rotations) all objects together may make in a second of the frames' time, None for as many
    as they need. They cost 5 to 18 ms each, and a live step that takes longer than its frame makes the next
    one larger: so many take half of the time, and a step that is late is not given more than a third of a
    second's.

    odometry: fast motion of the camera is measured where its pose is not given (`tracking.odometry`)."""

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
