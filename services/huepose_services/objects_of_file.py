"""The objects that pipeline.yaml names: their changes while the pipeline runs become orders to the list of
objects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from huepose.support.words import listed
from huepose_protos.messages import ControlRequest, ObjectEntry
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import ObjectConfig
from huepose_services.steering import ObjectList


def unlike_file(entries: Sequence[ObjectEntry], configured: Sequence[ObjectConfig]) -> str:
    """How the list that another worker remembers differs from that of the file, in one sentence: a command
    may have changed the list, or somebody the file. Empty if they agree, or if the file names no object."""
    known, named = {entry.object for entry in entries}, {item.name for item in configured}
    unlike = (("not in the file", known - named), ("only in the file", named - known))
    parts = [f"{what}: {listed(sorted(names))}" for what, names in unlike if names]
    if not named or not parts:
        return ""
    return f"objects are searched for as before the restart; {'; '.join(parts)} (huepose objects add, remove)"


class ObjectsOfFile:
    """Follows the objects of the file; those that were added by command stay. configured: as the file names
    them at the start; empty: all models are searched for."""

    def __init__(self, bus: Bus, objects: ObjectList, configured: Sequence[ObjectConfig]) -> None:
        self._bus, self._objects = bus, objects
        # Those that are searched for: a remembered list may have other names than the file.
        counts = {entry.object: entry.max_instances for entry in objects.entries()}
        self._names_objects = bool(configured)
        self._followed = {item.name: counts[item.name] for item in configured if item.name in counts}
        self._orders: dict[str, ControlRequest] = {}
        self._refused: list[str] = []

    def reload(self, configured: Sequence[ObjectConfig]) -> list[str]:
        """Note which objects were added to or removed from the file: each step changes one of them. Returns
        sentences on changes that cannot be made."""
        before, after = self._followed, {item.name: item.max_instances for item in configured}
        if self._names_objects != bool(after):
            return ["a change that waits for the next start: objects (from all models to some, or back)"]
        now = {entry.object: entry.max_instances for entry in self._objects.entries()}
        orders = {name: _order("remove", name) for name in before if name not in after and name in now}
        orders |= {
            name: _order("add", name, count)
            for name, count in after.items()
            if count not in (before.get(name), now.get(name))
        }
        self._followed = {name: count for name, count in after.items() if name not in orders}
        self._followed |= {name: before[name] for name in orders if name in before}
        self._orders, self._refused = orders, []
        self._bus.health.warn_while("objects", None)
        return []

    def step(self) -> None:
        """Change one object as the file says. Only one: to load many models takes longer than a worker may be
        silent."""
        if not self._orders:
            return
        name = next(iter(self._orders))
        order = self._orders.pop(name)
        done, text = self._objects.decide(order)
        if not done:
            # It is tried again when the file is next read: its model may be there by then.
            self._refused.append(text)
            self._bus.log.say(text, "warn")
            self._bus.health.warn_while("objects", "; ".join(self._refused))
        elif order.action == "add":
            self._followed[name] = order.max_instances
        else:
            self._followed.pop(name, None)


def _order(action: Literal["add", "remove"], name: str, count: int = 1) -> ControlRequest:
    return ControlRequest(publish_ns=now_ns(), action=action, object=name, max_instances=count)
