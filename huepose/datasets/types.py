"""Types that all data sets share: frames and their ground truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame

VISIBLE, GONE = 0.3, 0.1
"""Visible shares of an object: from the first on it counts as visible, under the second as gone; between
them as neither. BOP's targets are labels from the second on."""


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """One labelled object of one frame.

    object_id: the BOP id, None if the data set has only names; object: the reference model's name, None if
    the data set has only ids; instance: index among the labels of the frame (BOP: in `scene_gt.json`);
    T_cam_obj (4, 4): metres, of the reference model's frame, None if the pose is not labelled; visib_fract:
    visible share of the outline, 0..1, None if unknown; box_visib: bounds of the visible pixels from the
    data set; mask_loader: reads the visible mask (H, W).
    """

    instance: int
    T_cam_obj: Float64 | None
    object_id: int | None = None
    object: str | None = None
    visib_fract: float | None = None
    box_visib: Box | None = None
    mask_loader: Callable[[], Bool] | None = field(default=None, repr=False)

    def mask(self) -> Bool | None:
        """The visible mask (H, W); None if the data set has none. Raises InputError for a broken file."""
        return None if self.mask_loader is None else self.mask_loader()

    def shows(self, share: float) -> bool:
        """At least this share, 0..1, is visible; unknown counts as visible."""
        return self.visib_fract is None or self.visib_fract >= share

    @property
    def visible(self) -> bool:
        """At least the share VISIBLE is visible; unknown counts as visible."""
        return self.shows(VISIBLE)

    @property
    def gone(self) -> bool:
        """Less than the share GONE is visible; unknown does not count as gone."""
        return self.visib_fract is not None and self.visib_fract < GONE


@dataclass(frozen=True, eq=False)
class Sample:
    """One frame with its labels. scene: the folder's name; image: the number in the file name."""

    frame: RgbdFrame
    truths: tuple[GroundTruth, ...]
    scene: str
    image: int

    @staticmethod
    def of(scene: Scene, image: int) -> Sample:
        """The sample of a scene's image. Raises InputError for a broken file."""
        return Sample(scene.frame(image), scene.truths(image), scene.name, image)


class Scene(Protocol):
    """Interface of readers of recorded scenes. `image` is always the number in the file name."""

    @property
    def name(self) -> str:
        """The folder's name."""
        ...

    @property
    def image_ids(self) -> tuple[int, ...]:
        """Numbers of the images on disk, ascending."""
        ...

    def stamp_ns(self, image: int) -> int:
        """Capture time: that of the data set, else the time of the image number at 30 Hz."""
        ...

    def frame(self, image: int) -> RgbdFrame:
        """Colour and depth, read from disk. Raises InputError, naming the file, if one is broken."""
        ...

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        """The labels; no image is read."""
        ...


class SomeImages:
    """A scene limited to some of its images."""

    def __init__(self, scene: Scene, image_ids: Sequence[int]) -> None:
        self.image_ids = tuple(image_ids)
        self.name, self.frame, self.truths = scene.name, scene.frame, scene.truths
        self.stamp_ns = scene.stamp_ns
