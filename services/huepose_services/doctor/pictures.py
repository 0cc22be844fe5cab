"""Checks of a camera's images: whether they arrive, brightness, distance, unit of depth, alignment of depth
to colour, and whether the configured objects are found in them."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

import cv2
import numpy as np

from huepose.datasets.image_files import FARTHEST_M, NEAREST_M
from huepose.datasets.types import Scene
from huepose.estimation import Estimator, ObjectQuery
from huepose.estimation.apparent_size import doubted_in
from huepose.estimation.frame_offset import frame_offset
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.image_faults import (
    IF_IN_PLAIN_VIEW,
    LEAST_DEPTH,
    all_grey,
    camera_doubted,
    dark,
    depth_doubted,
    readings,
    some_of,
)
from huepose.model import ReferenceModel
from huepose.perception.exchanged import PLAIN, order_of_channels
from huepose.perception.view_detector import ViewDetector
from huepose.profiles import profile
from huepose.support.errors import InputError
from huepose.support.words import beside, rounded
from huepose_services import models
from huepose_services.camera.condition import Condition
from huepose_services.camera.live import LiveSource
from huepose_services.camera.reader import Reader
from huepose_services.camera.sources import open_source
from huepose_services.convert import LARGEST_STEP
from huepose_services.doctor.checks import Finding
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import LIVE_SOURCES, CameraConfig

LOOK_S = 3.0
_OPENING_S = 10.0
_FRAMES = 10
_GLARE = 255
FEWEST_PIXELS = 400
"""An object with fewer visible pixels is seldom found, and its pose is seldom right."""

REACH_PX = 8
"""Largest offset between depth and colour that `edge_offset` looks for, either way."""
EDGE = 0.03
"""Least depth step between neighbours at an edge, as a share of the distance. Slopes have smaller steps."""
SHADOW_PX = 12
CLEAR_PX, CLEAR_SIGMAS = 3.0, 4.0
_RELATED_PX = 6.0
"""Correlation length along an edge: nearer pixels are not independent."""
MOST_EDGES = 5000
"""Most edge pixels of a frame that are used: about as many as a desk has. Noisy depth has 30 times more."""


_REGISTER = {
    "realsense": "set camera.device.align to true; if it is, calibrate the camera.",
    "python": "frames() must return depth in the pixels of the colour image.",
}
"""What aligns depth to colour, by `camera.source`."""


def pictures(config: Config) -> Iterator[Finding]:
    """Open the configured camera, read it for some seconds, and check its frames."""
    try:
        source = open_source(config)
        live = config.camera.source in LIVE_SOURCES
        frames, findings = _live(source, config) if live else (_recorded(source), [])
    except InputError as error:
        yield Finding("camera", "bad", str(error))
        return
    yield from findings
    if not frames and not findings:
        yield Finding("camera", "bad", f"no image in {LOOK_S:g} s", "Is another program using it?")
    if not frames:
        return
    frames = [frame for frame in frames if frame.depth.shape == frames[-1].depth.shape]
    camera = frames[0].camera
    matrix = f"{camera.width} x {camera.height}, fx {camera.fx:.1f} fy {camera.fy:.1f}"
    doubt = camera_doubted(camera)
    yield Finding("camera", "note" if doubt else "ok", matrix, doubt or "")
    yield brightness(frames)
    measured = list(depth(frames, config.camera))
    yield from measured
    aligned = alignment(frames, config.camera.source)
    yield aligned
    if any(finding.bad for finding in measured):
        if config.bundles is not None:
            fix = "Correct depth first, which is BAD above: distance, size and pose of objects depend on it."
            yield Finding("objects", "note", "not searched for", fix)
        return
    yield from distance(frames, config)
    if config.bundles is not None:
        with suppress(InputError):  # missing reference models are reported by `checks.bundles`
            yield from objects_in(frames[-1], models.load(config), aligned.bad)


def _live(source: LiveSource, config: Config) -> tuple[list[RgbdFrame], list[Finding]]:
    """Some frames of a live camera, and the faults that its worker would report."""
    settings = config.camera
    condition = Condition(float(settings.rate), LARGEST_STEP * settings.depth_scale_m, settings.check)
    frames: list[RgbdFrame] = []
    complaints: dict[str, str] = {}
    youngest_ms, most_ms = math.inf, config.tracker.max_age_ms
    reader = Reader(source, float(settings.rate))  # it does not wait for an SDK that hangs
    if not reader.started:
        reader.start()
    until, opened = time.monotonic() + _OPENING_S, False
    try:
        while time.monotonic() < until:
            if reader.openings and not opened:
                until, opened = time.monotonic() + LOOK_S, True
            over, taken = reader.over, reader.take(0.25)
            if taken is None:
                failed = reader.trouble is not None and reader.stuck_s() == 0.0
                if over or (failed and not frames):
                    break
                continue
            shot = taken.shot
            condition.look(shot, now_ns(), taken.device_clock_is_host)
            if taken.device_clock_is_host:
                youngest_ms = min(youngest_ms, (shot.arrived_ns - shot.device_ns) * 1e-6)
            condition.count(reader.pictures, now_ns())
            complaints |= condition.complaints(now_ns())
            # The last ones: the first are dark until the exposure has settled.
            frames = [*frames, RgbdFrame(shot.color, shot.depth, shot.camera)][-_FRAMES:]
        if (trouble := reader.trouble) is not None:
            complaints["trouble"] = trouble
        if most_ms < youngest_ms < math.inf and "clock" not in complaints:
            complaints["age"] = (
                f"its images are {rounded(youngest_ms)} ms old when they arrive, by their timestamps: no "
                f"pose older than tracker.max_age_ms ({most_ms:g}) is TRACKING"
            )
    finally:
        reader.close()
    return frames, [Finding("camera", "bad", text) for text in complaints.values()]


def _recorded(source: Scene) -> list[RgbdFrame]:
    ids = source.image_ids
    return [source.frame(i) for i in ids[:: max(1, len(ids) // _FRAMES)]][:_FRAMES]


def brightness(frames: Sequence[RgbdFrame]) -> Finding:
    """Whether images are too dark or too bright to show colours, or have none."""
    colors = np.stack([frame.color[::4, ::4] for frame in frames])
    brightest, black = colors.max(-1), float(dark(colors).mean())
    glare = float((brightest >= _GLARE).mean())
    found = f"median {np.median(brightest):.0f} of 255; {100 * black:.0f} % black, {100 * glare:.0f} % white"
    if black > 0.5:
        return Finding("image", "bad", found, "Too dark: add light, or expose longer (device.options).")
    if all(all_grey(frame.color) for frame in frames):
        fix = "The image has no colour: does it come from an infrared or a monochrome sensor?"
        return Finding("image", "bad", found, fix)
    if glare > 0.25:
        return Finding(
            "image", "note", found, "Too bright: reduce light, or expose shorter (device.options)."
        )
    return Finding("image", "ok", found)


def depth(frames: Sequence[RgbdFrame], camera: CameraConfig) -> Iterator[Finding]:
    """Whether there is depth, in the right unit, and in the range that can be sent."""
    values = np.stack([some_of(frame.depth) for frame in frames])
    there = readings(values)
    share = float(there.mean())
    if share < LEAST_DEPTH:
        yield Finding("depth", "bad", f"{100 * share:.1f} % of the image", "Check lenses and projector.")
        return
    median_m = float(np.median(values[there]))
    found = f"{100 * share:.0f} % of the image, half of it nearer than {median_m:.3g} m"
    if not NEAREST_M <= median_m <= FARTHEST_M:
        fix = "correct depth_scale of the recording, or the camera's depth_units."
        if camera.source == "python":
            fix = "frames() must return metres."
        yield Finding("depth", "bad", found, f"Depth is in another unit: {fix}")
        return
    note = "Much of it is missing." if share < 0.5 else depth_doubted(frames[-1]) or ""
    yield Finding("depth", "note" if note else "ok", found, note)
    reach_m = LARGEST_STEP * camera.depth_scale_m
    beyond = float((values[there] >= reach_m).mean())
    if beyond > 0.01:
        fix = f"Set camera.depth_scale_m to {10 * camera.depth_scale_m:g}, which reaches ten times as far."
        yield Finding("depth", "note", f"{100 * beyond:.0f} % is over {reach_m:.1f} m and is not sent", fix)


def alignment(frames: Sequence[RgbdFrame], source: str) -> Finding:
    """Whether depth edges lie on colour edges. source: `camera.source`."""
    other = "calibrate the camera." if source in LIVE_SOURCES else "check the calibration of the recording."
    fix = f"Depth is not registered to colour: {_REGISTER.get(source, other)}"
    far = frame_offset(frames[-1])
    if far is not None:
        return Finding("alignment", "bad", str(far), fix)
    offset = edge_offset(frames)
    if offset is None:
        return Finding("alignment", "none", "too few edges to say whether depth is aligned to colour")
    right, down, sigmas = offset
    off = beside(right, down)
    found = f"colour edges are {off or 'on'} depth edges"
    if np.hypot(right, down) >= CLEAR_PX and sigmas >= CLEAR_SIGMAS:
        return Finding("alignment", "bad", found, fix)
    return Finding("alignment", "ok", found + (", too little to be sure" if off else ""))


def edge_offset(frames: Sequence[RgbdFrame]) -> tuple[float, float, float] | None:
    """The offset (right, down) in pixels from depth edges to colour edges, and its significance in standard
    errors; None if there are too few edges. It is the shift at which colour edges are strongest."""
    ticks = range(-REACH_PX, REACH_PX + 1)
    rows, total = [], 0
    for frame in frames:
        inside = np.s_[REACH_PX:-REACH_PX, REACH_PX:-REACH_PX]
        v, u = (axis + REACH_PX for axis in np.nonzero(_edges(frame.depth)[inside]))
        v, u = (axis[:: -(-len(axis) // MOST_EDGES) or 1] for axis in (v, u))
        strength = _strength(frame)
        rows.append(np.stack([strength[v + dy, u + dx] for dy in ticks for dx in ticks], 1))
        total += len(v)
    if total < 200:
        return None
    at = np.concatenate(rows).astype(np.float64)
    places = [(dx, dy) for dy in ticks for dx in ticks]
    best = int(np.argmax(at.mean(0)))
    gain: Float64 = at[:, best] - at[:, places.index((0, 0))]
    error = float(gain.std()) * np.sqrt(_RELATED_PX / len(gain)) + 1e-9
    return (float(places[best][0]), float(places[best][1]), float(gain.mean() / error))


def _edges(depth: Float32) -> Bool:
    """The near sides of steps in depth (H, W): where a surface ends in front of another one.

    `frame_offset.steps_of_depth` needs readings right beside the step, which real depth often lacks. In 5
    scenes of YCB-Video, 11 of 30 shifts of 5 and 6 px are detected with its steps, 23 with these."""
    out = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        for step in (1, -1):
            other = np.roll(depth, step, axis)
            # Stereo cameras often have no depth of the background right beside a near surface.
            other = np.where(other > 0.0, other, np.roll(depth, SHADOW_PX * step, axis))
            out |= (depth > 0.0) & (other > 0.0) & (other - depth > EDGE * depth)
    return out


def _strength(frame: RgbdFrame) -> Float32:
    """The colour gradient at each pixel (H, W), over all channels, relative to its mean around that pixel.

    The mean is around the pixel, not around the depth edge: else colour edges farther from a depth edge
    would seem stronger, and depth that is so noisy that it has edges everywhere would seem shifted."""
    smooth = cv2.GaussianBlur(frame.color.astype(np.float32), (0, 0), 0.8)
    slopes = [cv2.Sobel(smooth, cv2.CV_32F, *axes) for axes in ((1, 0), (0, 1))]
    change = np.asarray(np.sqrt(sum((s**2).sum(-1) for s in slopes)), np.float32)
    side = 4 * REACH_PX + 1
    return np.asarray(change / (cv2.blur(change, (side, side)) + 1e-3), np.float32)


def distance(frames: Sequence[RgbdFrame], config: Config) -> Iterator[Finding]:
    """Whether the objects would be large enough in the image at its median depth."""
    values = np.stack([some_of(frame.depth) for frame in frames])
    if config.bundles is None or not (values > 0.0).any():
        return
    median_m, camera = float(np.median(values[values > 0.0])), frames[0].camera
    for name, one in models.outlines(config).items():
        # From any side an object covers about half of the square of its diameter.
        pixels = 0.5 * camera.fx * camera.fy * (one.diameter_m / median_m) ** 2
        if pixels < FEWEST_PIXELS:
            near_m = median_m * np.sqrt(pixels / FEWEST_PIXELS)
            fix = f"Bring it, or the camera, nearer than {near_m:.1f} m, or set a higher resolution."
            yield Finding(
                "distance", "note", f"{name} would show {pixels:.0f} pixels at {median_m:.1f} m", fix
            )


MOST = 5
"""Most objects that are searched for, so that the check takes seconds with any number of objects."""


def objects_in(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], misaligned: bool = False
) -> Iterator[Finding]:
    """Whether the first objects by name are found, and what their poses say about the camera. misaligned:
    depth is known not to be aligned to colour."""
    names = sorted(models)[:MOST]
    live = profile("live")
    detector = ViewDetector({name: models[name] for name in names}, live.detector)
    seen = detector.detect(frame, names)
    places = [place for place in seen if place.score >= PLAIN]
    scores = dict.fromkeys(names, 0.0) | {place.object: place.score for place in seen[::-1]}
    why = order_of_channels(frame, detector, names, scores).exchanged
    if why:
        yield Finding("camera", "bad", "red and blue seem to be exchanged", why)
    if not places:
        text = f"none of {', '.join(names)} was found in the last image"
        yield Finding("objects", "none", text, IF_IN_PLAIN_VIEW)
        return
    best = {place.object: place for place in places[::-1]}
    estimator = Estimator(models, live.estimator)
    answers = estimator.estimate(
        frame, [ObjectQuery(name, best[name].box, searched=True) for name in sorted(best)]
    )
    said = ", ".join(f"{answer.object} {answer.state} {answer.quality:.2f}" for answer in answers)
    size, doubted = doubted_in(frame, models, answers)
    if size:
        yield Finding("camera", "bad", "sizes do not fit", size.said(frame.camera))
    for k, of_object in doubted.items():
        yield Finding("objects", "bad", f"{answers[k].object} does not fit", of_object.said_of_one())
    if misaligned or size or why:
        yield Finding("objects", "note", said, "Found, but these poses are wrong: correct what is BAD above.")
    elif all(answer.state == "TRACKING" for answer in answers):
        yield Finding("objects", "ok", said)
    else:
        fix = f"An object that is not TRACKING has an uncertain pose here. {IF_IN_PLAIN_VIEW}"
        yield Finding("objects", "note", said, fix)
