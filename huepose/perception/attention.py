"""Chooses which of many objects to search for first: those that something new in the image looks like.

Comparing some windows of the image with the views of twenty objects takes as long as searching for a few of
them. So if many are missing, windows that have changed are compared with all of them, once. Objects that
these windows look like are searched for at once, the others in their turn. If the camera moves, everything
is new in each look: then objects of one size after another are compared, as time allows.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from huepose.geometry.arrays import Bool
from huepose.perception.config import PICKED
from huepose.perception.memory import CHANGED, Memory
from huepose.perception.stillness import changed_shares
from huepose.perception.window_table import LIKE, WindowTable, compared, promising
from huepose.perception.windows import Windows, WindowsBySize

EACH, CODED, EARNED = 20, 240, 60
"""EACH: windows that are compared with one object, those on separate pieces or with its hues first, as in a
first search. CODED: about the most windows that are encoded for this in one look (0.1 CPU seconds). EARNED:
by how many that number grows from look to look. Chosen for time."""


@dataclass(frozen=True)
class Attention:
    """What was compared. looks: by size of window, the look in which everything new was compared; likeness:
    by object, of what is new and was not searched for yet; searched: by object, of what was searched for in
    vain; left: windows that may still be encoded. A likeness is the highest of a window and a view."""

    looks: Mapping[int, int] = field(default_factory=dict)
    likeness: Mapping[str, float] = field(default_factory=dict)
    searched: Mapping[str, float] = field(default_factory=dict)
    left: int = CODED

    def picked(self, waiting: Collection[str]) -> list[str]:
        """The waiting objects that are searched for now, most similar first: something new looks like them,
        and at least as much as anything that was searched for in vain."""
        likely = {name: self.likeness.get(name, 0.0) for name in waiting}
        some = [name for name, x in likely.items() if x >= max(LIKE, self.searched.get(name, 0.0))]
        return sorted(some, key=lambda name: -likely[name])[:PICKED]

    def after(self, searched: Collection[str], missing: Collection[str]) -> Attention:
        """The state after a search for some of the missing objects. Objects that are no longer missing are
        forgotten."""
        known = {
            name: max(self.searched.get(name, 0.0), self.likeness.get(name, 0.0) if name in searched else 0.0)
            for name in missing
        }
        left = {name: x for name, x in self.likeness.items() if name in missing and name not in searched}
        return replace(self, likeness=left, searched=known)


def attended(
    before: Attention,
    memory: Memory,
    windows: WindowsBySize,
    missing: Sequence[tuple[str, float, WindowTable]],
) -> Attention:
    """The state after comparing what is new in a look. missing: objects, their diameters in metres and
    their views. Sizes for which there is no time come first in the next look."""
    looks, likeness = dict(before.looks), dict(before.likeness)
    left = min(before.left + EARNED, CODED)
    of_size: dict[int, list[tuple[str, WindowTable]]] = {}
    for name, diameter_m, table in missing:
        of_size.setdefault(windows.size_of(diameter_m), []).append((name, table))
    for size in sorted(of_size, key=lambda size: (looks.get(size, -1), size)):
        if left <= 0:
            break
        here = windows.at(size)
        new = _new(memory, here, looks.get(size))
        looks[size] = memory.look
        if not new.any():
            continue
        for name, table in of_size[size]:
            order = promising(table, here)
            some = order[new[order]][:EACH]
            left -= here.uncoded(some)
            likeness[name] = max(likeness.get(name, 0.0), float(compared(table, here, some).max()))
    return Attention(looks, likeness, before.searched, left)


def _new(memory: Memory, windows: Windows, look: int | None) -> Bool:
    """Which windows (W,) have changed since a look; all of them if it is not remembered."""
    if look is None or look not in memory.tiles:
        return np.ones(len(windows), bool)
    changed = memory.changed_since(look)
    if not changed.any():
        return np.zeros(len(windows), bool)
    return np.asarray(changed_shares(changed, windows.frame_pixels, windows.span_px) > CHANGED)
