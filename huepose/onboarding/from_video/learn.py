"""Reconstruct a mesh from a recording: track the object by its reconstruction so far, close loops, fuse the
views, texture the mesh."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.icosphere import directions
from huepose.geometry.mesh import Mesh
from huepose.judge.open_region import PreparedSurface
from huepose.onboarding.from_video.fusion import FEW_CELLS, Fused, fused, painted
from huepose.onboarding.from_video.masks import cut, object_mask, view_at, window_of
from huepose.onboarding.from_video.registration import (
    Edge,
    Registered,
    followed,
    registered,
    relaxed,
    surface_of,
    turned_about,
)
from huepose.onboarding.from_video.selection import Selection, first_mask
from huepose.onboarding.from_video.views import RIM_PX, View, eroded
from huepose.onboarding.reference import Report, silent
from huepose.support.errors import InputError

VIEW_STEP = np.radians(5.0)
"""Rotation after which a frame is kept as a new view, radians."""

LOCAL = np.radians(90.0)
"""Rotation, radians, up to which earlier views are consistent with the newest one before a loop is
closed."""

AGAIN = np.radians(30.0)
"""Two views with a smaller difference in rotation show mostly the same surface, radians."""

SEEN = 0.5
"""Least share of the surface that depth must confirm at an accepted pose."""

COLORED = 0.2
"""Least colour correlation of an accepted pose: at wrong poses, round and flat sides may agree in depth,
too."""

CLOSES = 0.9
"""A loop is accepted if the total of its pose against the old views is at least this share of the total
against the recent ones."""

POLISHES = 2
"""Rounds of bundle refinement: fuse all views, then register each with the fusion of the others."""

WIDE = 0.3
"""Radius around a view direction that counts as covered by a view, radians."""

FEWEST_FOLLOWED = 0.5
"""Least share of the frames that must be tracked."""


@dataclass(frozen=True, eq=False)
class Learned:
    """mesh: metres, origin at the centre of its bounds, z up from the ground (without a ground: axes of the
    camera in the first frame); seen (V,): vertices that were measured, the others come from the visual
    hull. T_cam_obj: poses of the tracked frames, by their index in the recording. frames: number of all
    frames; views: number of frames that were kept as views; directions: share of all directions from which
    the object was seen, 0..1; surface: share of the mesh that was measured; closing_m: largest gap of a
    loop before it was closed, None without loops."""

    mesh: Mesh
    seen: Bool
    T_cam_obj: dict[int, Float64]
    frames: int
    views: int
    directions: float
    surface: float
    closing_m: float | None


def learn(frames: Iterable[RgbdFrame], selection: Selection, report: Report = silent) -> Learned:
    """Mesh of the object that is selected in the first frame. report: called before each step after the
    last frame, which take some seconds each. Raises InputError that says how to record instead,
    ModuleNotFoundError without the extra `onboard`."""
    track: _Track | None = None
    count, where = 0, {}
    for count, frame in enumerate(frames, 1):
        if track is None:
            track = _Track.begun(frame, selection)
        elif not track.follow(frame):
            continue
        where[count - 1] = track.since_view()
    if track is None:
        raise InputError("the recording", found="no frame")
    if len(where) < FEWEST_FOLLOWED * count:
        raise InputError(
            "the recording",
            found=f"an object that could be tracked in only {len(where)} of {count} frames; " + track.why_not,
            fix="Turn it more slowly, about 45 degrees a second, in full view of the camera.",
        )
    if len(track.views) == 1:
        raise InputError(
            "the recording",
            found=f"an object that rotated by less than {np.degrees(VIEW_STEP):.0f} degrees",
            expected="one that rotates in front of the camera, best all round",
        )
    polished = _polished(track.views, track.radius_m, report)
    views = _showing(polished)
    report("fusing the views and closing the surface")
    shape = fused(views, closed=True)
    report("texturing the mesh")
    T_old_new = _frame_of(shape, views[0], track.ground)
    mesh = painted(_moved(shape, se3.inverse(T_old_new)), [v.at(v.T_cam_obj @ T_old_new) for v in views])
    poses = {
        number: T_now_then @ polished[k].T_cam_obj @ T_old_new for number, (k, T_now_then) in where.items()
    }
    return Learned(
        mesh,
        shape.seen,
        poses,
        count,
        len(views),
        _directions(views, shape),
        _share_seen(shape),
        max(track.closing_m, default=None),
    )


@dataclass(eq=False)
class _Track:
    """The state of tracking. path: sum of the rotations up to each view, radians; total: of the last pose
    in its frame."""

    ground: Float64 | None
    radius_m: float
    views: list[View]
    frame: RgbdFrame
    mask: Bool
    T_cam_obj: Float64
    shape: Fused
    surface: PreparedSurface
    surface_T: Float64
    edges: list[Edge] = field(default_factory=list)
    path: list[float] = field(default_factory=lambda: [0.0])
    closing_m: list[float] = field(default_factory=list)
    misses: dict[str, int] = field(default_factory=dict)
    total: float = 0.0

    @staticmethod
    def begun(frame: RgbdFrame, selection: Selection) -> _Track:
        """The state after the first frame. Raises InputError."""
        mask, near, ground = first_mask(frame, selection)
        rows, columns = np.nonzero(eroded(mask))
        if not len(rows):
            raise InputError(
                "the first frame",
                found=f"an object that is {2 * RIM_PX} pixels thick at most, so that all of it is border",
                expected="one that is thicker in the image",
                fix="Record it from a shorter distance.",
            )
        points = frame.camera.backproject(np.stack([columns, rows], 1), frame.depth[rows, columns])
        T = se3.make(np.eye(3), np.median(points, axis=0))
        radius = float(np.percentile(np.linalg.norm(points - T[:3, 3], axis=1), 99))
        window = window_of(frame, T, 2 * radius)
        if window is None:
            raise InputError(
                "the first frame",
                found=f"a surface {2 * radius:.1f} m across, {T[2, 3]:.1f} m from the camera",
                expected="one object, at a distance of more than twice its own size",
                fix="Point at the object, or mark it with --box X Y W H.",
            )
        part = cut(frame, *window)
        view = View(part, mask[window], ~near[window], T, ground)
        shape = fused([view])
        surface = surface_of(shape, [view], T)
        if surface is None:
            raise InputError("the first frame", found="no surface", fix="Record it from a shorter distance.")
        return _Track(ground, radius, [view], frame, mask, T, shape, surface, T)

    def since_view(self) -> tuple[int, Float64]:
        """The index of the newest view, and the motion of the object since then: T_now_then (4, 4), camera
        axes. It stays valid when a loop is closed later, which moves both poses alike."""
        return len(self.views) - 1, self.T_cam_obj @ se3.inverse(self.views[-1].T_cam_obj)

    @property
    def why_not(self) -> str:
        """The most frequent reason why a frame was not tracked."""
        return max(self.misses, key=lambda why: self.misses[why])

    def follow(self, frame: RgbdFrame) -> bool:
        """Track the object to the next frame; keep the frame as a view if it shows something new. False if
        the pose is not accepted."""
        flowed = followed(self.frame, self.mask, self.T_cam_obj, frame)
        guesses = [T for T in (flowed, self.T_cam_obj) if T is not None]
        found = registered(self.surface, frame, guesses)
        if _doubt(found):
            found = registered(self.surface, frame, turned_about(guesses[0]))
        why = _doubt(found)
        if found is None or why:
            self.misses[why] = self.misses.get(why, 0) + 1
            return False
        T = found.T_cam_obj
        view = view_at(frame, T, self.local(), self.ground, self.radius_m)
        if view is None:
            self.misses["it left the image"] = self.misses.get("it left the image", 0) + 1
            return False
        self.frame, self.T_cam_obj, self.total = frame, T, found.terms.total
        self.mask = np.zeros(frame.depth.shape, bool)
        window = window_of(frame, T, 1.6 * self.radius_m)
        assert window is not None
        self.mask[window] = view.mask
        turned = [se3.rotation_angle(v.T_cam_obj[:3, :3], T[:3, :3]) for v in self.local()]
        if min(turned) > VIEW_STEP and view.inner.any():  # a mask that is all border shows nothing new
            self._keep(view)
        if se3.rotation_angle(self.surface_T[:3, :3], T[:3, :3]) > VIEW_STEP:
            self._look_from(self.T_cam_obj)
        return True

    def local(self) -> list[View]:
        """Views whose poses are consistent with the newest: the last ones, and those that loops connect to
        them."""
        recent = {k for k, way in enumerate(self.path) if self.path[-1] - way <= LOCAL}
        joined = {edge.a for edge in self.edges if edge.loop and edge.b in recent}
        near = {k for j in joined for k, way in enumerate(self.path) if abs(way - self.path[j]) <= LOCAL / 2}
        return [self.views[k] for k in sorted(recent | near)]

    def _look_from(self, T_cam_obj: Float64) -> None:
        surface = surface_of(self.shape, self.local(), T_cam_obj)
        if surface is not None:
            self.surface, self.surface_T = surface, T_cam_obj

    def _keep(self, view: View) -> None:
        last = self.views[-1]
        self.edges.append(_edge(len(self.views) - 1, last, len(self.views), view, loop=False))
        turn = se3.rotation_angle(last.T_cam_obj[:3, :3], view.T_cam_obj[:3, :3])
        self.path.append(self.path[-1] + turn)
        self.views.append(view)
        reach = np.linalg.norm(view.points_obj, axis=1)
        self.radius_m = max(self.radius_m, float(np.percentile(reach, 99)))
        if self._close():
            self.T_cam_obj = self.views[-1].T_cam_obj
        self.shape = fused(self.local(), cells=FEW_CELLS)
        self._look_from(self.T_cam_obj)

    def _close(self) -> bool:
        """Close a loop: connect the newest view to an old one that shows the same side, if there is one
        that is not connected yet."""
        newest, number = self.views[-1], len(self.views) - 1
        R, known = newest.T_cam_obj[:3, :3], {id(view) for view in self.local()}
        others = [
            (se3.rotation_angle(R, view.T_cam_obj[:3, :3]), k)
            for k, view in enumerate(self.views)
            if id(view) not in known
        ]
        if not others or min(others)[0] > AGAIN:
            return False
        k = min(others)[1]
        beside = [
            v for v, way in zip(self.views, self.path, strict=True) if abs(way - self.path[k]) < LOCAL / 2
        ]
        surface = surface_of(fused(beside, cells=FEW_CELLS), beside, newest.T_cam_obj)
        found = None if surface is None else registered(surface, newest.frame, turned_about(newest.T_cam_obj))
        if found is None or _doubt(found) or found.terms.total < CLOSES * self.total:
            return False
        apart = se3.inverse(found.T_cam_obj) @ newest.T_cam_obj
        ends = se3.apply(apart, newest.points_obj) - newest.points_obj
        self.closing_m.append(float(np.linalg.norm(ends, axis=1).mean()))
        self.edges.append(_edge(k, self.views[k], number, newest.at(found.T_cam_obj), loop=True))
        self.views = relaxed(self.views, self.edges, self.radius_m)
        return True


def _edge(a: int, view_a: View, b: int, view_b: View, loop: bool) -> Edge:
    return Edge(a, b, view_b.T_cam_obj @ se3.inverse(view_a.T_cam_obj), loop)


def _doubt(found: Registered | None) -> str:
    """Why a pose is not accepted; empty if it is."""
    if found is None:
        return "it left the image"
    if found.terms.blind > SEEN:
        return "it had no depth"
    if found.terms.hidden > SEEN:
        return "it was occluded"
    if found.terms.seen < SEEN or found.terms.color < COLORED:
        return "it rotated or moved too far from one frame to the next"
    return ""


def _polished(views: Sequence[View], radius_m: float, report: Report) -> list[View]:
    """Views with poses and masks that are consistent with all others. A view that turns out to show nothing
    gets an empty mask and is not used any more."""
    out = list(views)
    for number in range(1, POLISHES + 1):
        showing = _showing(out)
        report(f"registering {len(showing)} views with each other, {number} of {POLISHES}")
        shape = fused(showing)
        moved = [_moved_to_fit(view, shape, showing) if view.mask.any() else view for view in out]
        others = _showing(moved)
        out = [_masked_by(view, others, radius_m) if view.mask.any() else view for view in moved]
        if not _showing(out):
            raise InputError(
                "the recording",
                found="views that contradict each other, so that no surface is left",
                fix="Record it again: turn the object slowly, in full view of the camera, and let nothing "
                "else move with it.",
            )
    return out


def _showing(views: Sequence[View]) -> list[View]:
    """The views that show the object."""
    return [view for view in views if view.mask.any()]


def _moved_to_fit(view: View, shape: Fused, views: Sequence[View]) -> View:
    """A view registered with the fused surface of all; unchanged if the new pose is not accepted."""
    surface = surface_of(shape, views, view.T_cam_obj)
    found = None if surface is None else registered(surface, view.frame, [view.T_cam_obj])
    return view if found is None or _doubt(found) else view.at(found.T_cam_obj)


def _masked_by(view: View, views: Sequence[View], radius_m: float) -> View:
    """A view with a new mask, from the votes of all views."""
    mask, denied = object_mask(view.frame, view.T_cam_obj, views, view.ground, radius_m)
    return replace(view, mask=mask, denied=denied)


def _frame_of(shape: Fused, first: View, ground: Float64 | None) -> Float64:
    """T_old_new (4, 4): z axis up from the ground in the first view, origin at the centre of the bounds."""
    R = np.eye(3)
    if ground is not None:
        up = first.T_cam_obj[:3, :3].T @ ground[:3]
        right = np.cross(first.T_cam_obj[2, :3], up)  # horizontal and across the line of sight
        right = right if np.linalg.norm(right) > 1e-3 else np.cross(first.T_cam_obj[1, :3], up)
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(up, right), up], 1)
    turned = shape.vertices @ R
    return se3.make(R, R @ ((turned.min(0) + turned.max(0)) / 2))


def _moved(shape: Fused, T: Float64) -> Fused:
    return replace(shape, vertices=se3.apply(T, shape.vertices), normals=shape.normals @ T[:3, :3].T)


def _directions(views: Sequence[View], shape: Fused) -> float:
    centre = (shape.vertices.min(0) + shape.vertices.max(0)) / 2
    eyes = np.array([se3.inverse(view.T_cam_obj)[:3, 3] - centre for view in views])
    eyes /= np.linalg.norm(eyes, axis=1, keepdims=True)
    return float(((directions(3) @ eyes.T).max(1) > np.cos(WIDE)).mean())


def _share_seen(shape: Fused) -> float:
    corners = shape.vertices[shape.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return float((areas * shape.seen[shape.faces].mean(1)).sum() / areas.sum())
