"""Writes frames, poses and events to a rerun recording, with bounded time and memory."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import rerun as rr

from huepose.geometry import Camera, se3
from huepose.geometry.arrays import Bool, Float, Float64
from huepose_protos.buffers import Array
from huepose_protos.fields import StateName
from huepose_protos.messages import FrameHeader, HypothesesMessage, PoseMessage
from huepose_services.convert import camera_from_wire, pose_from_wire, pose_of
from huepose_services.viewer import blueprint as place
from huepose_services.viewer.shapes import (
    Body,
    apart,
    axes,
    cloud,
    depth_range,
    drawable,
    label_size,
    outlines,
    yuv,
)

Instance = tuple[str, int]
Colour = tuple[int, int, int]

STATE_COLOURS: dict[StateName, Colour] = {
    "TRACKING": (64, 220, 120),
    "SUSPECT": (255, 190, 40),
    "LOST": (250, 80, 70),
    "SEARCHING": (150, 150, 150),
}
_LEVELS: dict[StateName, str] = {"TRACKING": "INFO", "SUSPECT": "WARN", "LOST": "ERROR", "SEARCHING": "TRACE"}
OTHER = (200, 120, 255)
"""The colour of other hypotheses than the published pose."""
AGREES, CONTRADICTS = (110, 255, 160), (255, 60, 60)
"""The colours of colour pairs that are found in the image, and of those where it has another colour."""
_AXES = ((235, 70, 60), (70, 200, 80), (70, 120, 250))
_PALETTE = (
    (86, 180, 233),
    (230, 159, 0),
    (0, 200, 150),
    (240, 228, 66),
    (204, 121, 167),
    (213, 94, 0),
    (120, 140, 255),
    (170, 220, 110),
)
_TRAIL = 90
_ABOVE = 30.0
"""Distance from the top of an outline up to the point below which its label is, pixels."""
_CLOUD_STRIDE = 3


class Show:
    """One recording. Static data (meshes, colours, the camera) are written when they are first needed."""

    def __init__(self, recording: Any, bodies: Mapping[str, Body]) -> None:
        self._recording = recording
        self._bodies = bodies
        self._drawn: set[Instance] = set()
        self._in_space: dict[Instance, Body] = {}
        self._colours: dict[Instance, Colour] = {}
        self._trails: dict[Instance, deque[Float]] = {}
        self._camera: Camera | None = None
        self._log("world", rr.ViewCoordinates.RDF, static=True)
        line = rr.SeriesLines(colors=[(120, 200, 255)], widths=[1.5], names=["capture to pose"])
        self._log(place.LATENCY, line, static=True)

    def _log(self, path: str, *what: Any, static: bool = False) -> None:
        self._recording.log(path, *what, static=static)

    def at(self, realtime_ns: int, frame_id: int) -> None:
        """Set the time (nanoseconds since 1970) and frame of all that is logged next."""
        self._recording.set_time(place.TIMELINE, timestamp=np.datetime64(realtime_ns, "ns"))
        self._recording.set_time("frame", sequence=frame_id)

    def colour_of(self, instance: Instance) -> Colour:
        """The colour of an instance in plots and trails: of the colours that the fewest instances have, the
        first one counted from its object's."""
        if instance not in self._colours:
            names, used = list(self._bodies), Counter(self._colours.values())
            first = names.index(instance[0]) if instance[0] in names else len(names)
            others = (_PALETTE[(first + k) % len(_PALETTE)] for k in range(len(_PALETTE)))
            self._colours[instance] = min(others, key=lambda colour: used[colour])
        return self._colours[instance]

    def frame(self, header: FrameHeader, color: Array, depth: Array, with_cloud: bool) -> None:
        """Write the colour image; with_cloud: also the point cloud, and every second pixel of depth."""
        camera = camera_from_wire(header.intrinsics)
        if camera != self._camera:
            self._camera = camera
            pinhole = rr.Pinhole(
                image_from_camera=camera.K,
                resolution=[camera.width, camera.height],
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.15,
            )
            self._log(place.CAMERA, pinhole, static=True)
        planes, width, height = yuv(color)
        # Not JPEG: a busy browser would decode it later than it draws the overlay.
        image = rr.Image(
            bytes=planes, width=width, height=height, pixel_format=rr.PixelFormat.Y_U_V12_LimitedRange
        )
        self._log(place.COLOR, image)
        if with_cloud:
            scale_m = header.intrinsics.depth_scale_m
            small = np.ascontiguousarray(depth[::2, ::2])
            shown = rr.DepthImage(
                small, meter=1.0 / scale_m, colormap="viridis", depth_range=depth_range(small)
            )
            self._log(place.DEPTH, shown)
            points, colors = cloud(color, depth, scale_m, camera, _CLOUD_STRIDE)
            self._log(place.CLOUD, rr.Points3D(points, colors=colors, radii=rr.Radius.ui_points(1.5)))

    def beliefs(self, poses: list[PoseMessage]) -> None:
        """Draw outlines, axes and names of a frame's poses into its image."""
        if self._camera is None:
            return
        lines, colors, tips, labels, label_colors, crosses = [], [], [], [], [], []
        for pose in poses:
            body, T_cam_obj = self._bodies.get(pose.object), pose_of(pose)
            if body is None or T_cam_obj is None:
                continue
            border = outlines(body.mesh, T_cam_obj, self._camera)
            if not border:
                continue
            colour = STATE_COLOURS[pose.state]
            lines += border
            colors += [colour] * len(border)
            highest = np.concatenate(border)
            tips.append((float(highest[:, 0].mean()), float(highest[:, 1].min()) - _ABOVE))
            why = f"\n{pose.reason}" if pose.reason else ""
            labels.append(f"{pose.object}  {pose.state.lower()} {pose.quality:.2f}{why}")
            label_colors.append(colour)
            cross = axes(T_cam_obj, self._camera, 0.35 * body.diameter_m, body.mesh.centre)
            crosses += cross or []
        tips = apart(tips, [label_size(label) for label in labels], self._camera.width, self._camera.height)
        width = rr.Radius.ui_points(1.5)
        self._log(f"{place.OVERLAY}/outlines", rr.LineStrips2D(lines, colors=colors, radii=width))
        self._log(
            f"{place.OVERLAY}/axes",
            rr.LineStrips2D(crosses, colors=_AXES * (len(crosses) // 3), radii=rr.Radius.ui_points(1.2)),
        )
        self._log(
            f"{place.OVERLAY}/names",
            rr.Points2D(tips, labels=labels, colors=label_colors, radii=rr.Radius.ui_points(1.0)),
        )

    def hypotheses(self, held: HypothesesMessage | None) -> None:
        """Draw outlines of the other hypotheses of a frame, with their shares."""
        camera = self._camera
        if camera is None:
            return
        lines, tips, labels = [], [], []
        for item in [] if held is None else held.objects:
            body = self._bodies.get(item.object)
            if body is None:
                continue
            for rank, one in enumerate(item.hypotheses[1:], 2):
                border = outlines(body.mesh, pose_from_wire(one.translation, one.quaternion), camera)
                if border:
                    lines += border
                    pixels = np.concatenate(border)
                    tips.append((float(pixels[:, 0].mean()), float(pixels[:, 1].max())))
                    labels.append(f"{item.object}  {rank}: {one.share:.0%} ({one.source})")
        tips = apart(tips, [label_size(label) for label in labels], camera.width, camera.height)
        path = f"{place.OVERLAY}/hypotheses"
        self._log(f"{path}/outlines", rr.LineStrips2D(lines, colors=[OTHER], radii=rr.Radius.ui_points(0.8)))
        self._log(
            f"{path}/shares", rr.Points2D(tips, labels=labels, colors=[OTHER], radii=rr.Radius.ui_points(1.0))
        )

    def pairs(self, pixels: Float64, elsewhere: Bool) -> None:
        """Draw colour pairs of the models in a frame. pixels (N, 2): where they are; elsewhere (N,):
        whether the image has another colour there."""
        colors = np.where(elsewhere[:, None], CONTRADICTS, AGREES).astype(np.uint8)
        self._log(
            f"{place.OVERLAY}/pairs", rr.Points2D(pixels, colors=colors, radii=rr.Radius.ui_points(2.0))
        )

    def pose(self, pose: PoseMessage) -> None:
        """Show the model and its trail in the 3D view, and plot its quality; without a pose the model is
        removed from the view."""
        instance = (pose.object, pose.instance)
        path = _path(place.OBJECTS, instance)
        self._draw_once(instance, path)
        T_cam_obj = pose_of(pose)
        if T_cam_obj is None:
            self.gone(instance)
        else:
            body = self._bodies.get(pose.object)
            trail = self._trails.setdefault(instance, deque(maxlen=_TRAIL))
            trail.append(se3.apply(T_cam_obj, np.zeros(3) if body is None else body.mesh.centre))
            rotation = rr.Quaternion(xyzw=pose.quaternion)
            self._log(path, rr.Transform3D(translation=pose.translation, rotation=rotation, scale=1.0))
            self._trail(instance, trail)
        self._log(_path(place.QUALITY, instance), rr.Scalars(pose.quality))

    def gone(self, instance: Instance) -> None:
        """Remove an instance and its trail from the 3D view, until it has a pose again."""
        self._trails.pop(instance, None)
        self._log(_path(place.OBJECTS, instance), rr.Transform3D(scale=0.0))
        self._trail(instance, ())

    def _trail(self, instance: Instance, trail: Collection[Float]) -> None:
        self._log(
            _path(place.TRAILS, instance),
            rr.LineStrips3D(
                [list(trail)] if len(trail) > 1 else [],
                colors=[self.colour_of(instance)],
                radii=rr.Radius.ui_points(1.5),
            ),
        )

    def _draw_once(self, instance: Instance, path: str) -> None:
        if instance not in self._drawn:
            self._drawn.add(instance)
            name = f"{instance[0]} {instance[1]}"
            line = rr.SeriesLines(colors=[self.colour_of(instance)], widths=[1.5], names=[name])
            self._log(_path(place.QUALITY, instance), line, static=True)
        # A model may be loaded after the first pose, or be replaced.
        body = self._bodies.get(instance[0])
        if body is not None and body is not self._in_space.get(instance):
            self._in_space[instance] = body
            self._log(f"{path}/mesh", rr.Mesh3D(**drawable(body.mesh)), static=True)

    def latency(self, milliseconds: float) -> None:
        """Plot the time from the capture of a frame to its first pose."""
        self._log(place.LATENCY, rr.Scalars(milliseconds))

    def event(self, text: str, state: StateName) -> None:
        """Write a line to the log of the page."""
        self._log(place.EVENTS, rr.TextLog(text, level=_LEVELS[state], color=STATE_COLOURS[state]))


def _path(of: str, instance: Instance) -> str:
    """The path under which data of an instance are logged."""
    return f"{of}/{instance[0]}_{instance[1]}"
