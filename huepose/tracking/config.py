"""What can be set about a tracker; the defaults are those of a live pipeline."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.propose.flow import FlowSource, compute
from huepose.support.errors import InputError


@dataclass(frozen=True)
class TrackerConfig:
    """history_frames, older_frames: frames that are kept for late corrections: the newest ones, and behind
    them others that lie a tenth and a sixth of a second apart, half of them each.
    tracking_quality, suspect_quality: a pose over the first goes to TRACKING, one under the second to
    SUSPECT. confirmed_identity: how sure it must be that an acquired pose is the right one before it is
    TRACKING. lost_quality: under it a frame gives no support; lost_after such frames in a row make an object
    LOST. search: whether the tracker may look for an object on its own when the step was too large.
    searches_per_step: for how many objects in one step; None for all that need it. A search takes several
    frames' time, so in a live pipeline many of them would make the next step too large as well, and so on.
    max_search_m_s, max_search_rad_s: the fastest motion that the search covers.
    catch_up_stride: most frames skipped at once while catching up. flow: where optical flow comes from.
    """

    history_frames: int = 20
    older_frames: int = 24
    tracking_quality: float = 0.6
    suspect_quality: float = 0.5
    lost_quality: float = 0.25
    confirmed_identity: float = 0.9
    lost_after: int = 5
    search: bool = True
    searches_per_step: int | None = 1
    max_search_m_s: float = 0.8
    max_search_rad_s: float = 7.0
    catch_up_stride: int = 3
    flow: FlowSource = compute

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
