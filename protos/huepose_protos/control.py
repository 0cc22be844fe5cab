"""The objects that the pipeline looks for, and what a person may say about them."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from huepose_protos.fields import BoxXYWH, Count, Epoch, Index, Name, Text, check_box
from huepose_protos.parts import Message


class ObjectEntry(Struct, frozen=True, kw_only=True):
    """An object that the pipeline looks for; `searching`: how many of its instances were never seen yet.

    `resets`: how often it was told to be searched for anew; `retired`: [camera epoch, number], instances of
    that epoch below that number are over for that reason, null when there are none; `box`: where it was said
    to be at the last time, null when nothing was said; `reason`: why it is not seen, as far as perception
    knows, empty when all of it is."""

    object: Name
    max_instances: Annotated[int, Meta(ge=1, le=64)]
    searching: Count
    resets: Count = 0
    retired: tuple[Epoch, Index] | None = None
    box: BoxXYWH | None = None
    reason: Text = ""

    def __post_init__(self) -> None:
        check_box(self.box)


class ObjectsMessage(Message, frozen=True, kw_only=True):
    """The objects that the pipeline looks for, once a second and when the list changes."""

    objects: Annotated[list[ObjectEntry], Meta(max_length=256)]


class ControlRequest(Message, frozen=True, kw_only=True):
    """A query on `control`: what a person on the pipeline's machine wants of its list of objects.

    `list` names no object. `add` looks for one (up to max_instances of it), `remove` for it no longer,
    `reset` forgets where it was and searches anew; `box`: where it is in the image, as a hint for the
    detector."""

    action: Literal["list", "add", "remove", "reset"]
    object: Name | None = None
    max_instances: Annotated[int, Meta(ge=1, le=64)] = 1
    box: BoxXYWH | None = None

    def __post_init__(self) -> None:
        check_box(self.box)
        if (self.object is None) != (self.action == "list"):
            raise ValueError(f"{self.action} and object do not go together")


class ControlReply(Message, frozen=True, kw_only=True):
    """The answer: whether it was done, else why not; `objects` is the list as it is now."""

    done: bool
    text: Text
    objects: Annotated[list[ObjectEntry], Meta(max_length=256)]
