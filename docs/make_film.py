"""Makes docs/images/demo.webp: the demo's scene with the poses that the pipeline publishes.

    .venv/bin/python docs/make_film.py

Runs the workers on the built-in scene as `huepose demo` does, and subscribes to the poses. Left: the camera's
image with the outline of each model at the pose published for this frame, in the colour of its state. Right:
the models at these poses with the points of the depth image, from the side, and the paths of the models. The
film begins half a second before the first object is found. `docs/make_film.py FOLDER` also writes single
images.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import yaml
from PIL import Image, ImageDraw, ImageFont

from huepose.drawing.canvas import Colour
from huepose.drawing.overlay import draw_mask_outline, silhouette, tint
from huepose.geometry import Camera, RgbdFrame, se3
from huepose.geometry.arrays import Float64, UInt8
from huepose.model import ReferenceModel, load_models
from huepose.rendering.render import render
from huepose.scenes.builtin import SyntheticScene
from huepose.scenes.camera import RATE_HZ
from huepose.scenes.motion import UP_ROOM
from huepose_protos.client import Reader
from huepose_protos.messages import PoseMessage, TruthMessage
from huepose_services.builtin import builtin_bundles
from huepose_services.convert import pose_of
from huepose_services.demo.run import pipeline
from huepose_services.runtime.config_file import load
from huepose_services.runtime.supervisor import Supervisor
from huepose_services.viewer.shapes import cloud
from huepose_services.viewer.show import STATE_COLOURS

SEED, SECONDS, BEFORE_S, EVERY = 0, 6.0, 0.5, 3
SIZE, LEFT_PX = (880, 428), 507  # of the film and of its left half
SIDE = Camera(430.0, 430.0, 184.5, 189.5, 370, 380)  # of the right half
EYE, LOOK_AT = np.array([0.75, -0.25, 0.35]), np.array([-0.03, 0.02, 0.80])  # m, in the camera's axes
GROUND: Colour = (20, 22, 27)
TRAIL = 45  # frames
FONT = ImageFont.load_default(15)
Poses = Mapping[str, PoseMessage]


def main() -> None:
    """Run the pipeline, draw the published poses, write the film."""
    published = listen()
    scene, models = SyntheticScene(SEED), load_models(builtin_bundles(SEED))
    pictures, trails = [], {name: list[Float64]() for name in models}
    for number, (image, poses) in enumerate(published):
        for name, pose in poses.items():
            T_cam_obj = pose_of(pose)
            at = [] if T_cam_obj is None else [T_cam_obj[:3, 3]]
            trails[name] = (trails[name] + at)[-TRAIL:] if at else []
        if number % EVERY == 0:
            pictures.append(drawn(scene.frame(image), models, poses, trails))
    target = Path(__file__).parent / "images" / "demo.webp"
    film = [Image.fromarray(p) for p in pictures]
    duration_ms = round(1000 * EVERY / RATE_HZ)
    film[0].save(
        target, save_all=True, append_images=film[1:], duration=duration_ms, loop=0, quality=25, method=6
    )
    print(f"{target}: {len(film)} pictures, {target.stat().st_size / 1e6:.2f} MB")
    if len(sys.argv) > 1:
        for k, picture in enumerate(film):
            picture.save(Path(sys.argv[1]) / f"{k:03d}.png")


def listen() -> list[tuple[int, Poses]]:
    """For each frame in order: the number of its image in the scene's loop, and its poses by object."""
    images, poses = dict[int, int](), dict[int, dict[str, PoseMessage]]()
    first, n_frames = None, round(SECONDS * RATE_HZ)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pipeline.yaml"
        path.write_text(yaml.safe_dump(pipeline(SEED)))
        config = load(path)
        supervisor = Supervisor(config, path)
        supervisor.start()
        try:
            with Reader(
                [config.endpoint(w) for w in config.workers], config.keys.poses, config.keys.truth
            ) as reader:
                while first is None or max(images) < first + n_frames + RATE_HZ:
                    supervisor.poll(0.0)
                    if supervisor.exit_code is not None:
                        sys.exit("the pipeline has ended")
                    message = reader.next(0.1)
                    if isinstance(message, TruthMessage):
                        images[message.frame_id] = message.image
                    elif isinstance(message, PoseMessage):
                        poses.setdefault(message.frame_id, {})[message.object] = message
                        if first is None and message.translation is not None:
                            first = message.frame_id - round(BEFORE_S * RATE_HZ)
        finally:
            supervisor.stop()
    ids = [i for i in sorted(images) if first <= i < first + n_frames]
    return [(images[i], poses.get(i, {})) for i in ids]


def drawn(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], poses: Poses, trails: Mapping[str, list]
) -> UInt8:
    """One image of the film (H, W, 3)."""
    height = SIDE.height
    picture = cv2.resize(left(frame, models, poses), (LEFT_PX, height), interpolation=cv2.INTER_AREA)
    film = Image.new("RGB", SIZE, GROUND)
    film.paste(Image.fromarray(picture))
    film.paste(Image.fromarray(right(frame, models, poses, trails)), (SIZE[0] - SIDE.width, 0))
    pen = ImageDraw.Draw(film)
    for k, name in enumerate(models):
        pose = poses.get(name)
        state, quality = ("SEARCHING", 0.0) if pose is None else (pose.state, pose.quality)
        x, y = k * SIZE[0] / len(models) + 12, height + 5
        pen.text((x, y), name, (225, 225, 225), FONT)
        T_cam_obj = None if pose is None else pose_of(pose)
        pen.text(
            (x, y + 19),
            f"{state}  {quality:.2f}" if T_cam_obj is not None else state,
            STATE_COLOURS[state],
            FONT,
        )
        if T_cam_obj is not None:
            corners = frame.camera.project(se3.apply(T_cam_obj, models[name].mesh.vertices))
            at = (corners[:, 0].mean(), corners[:, 1].min()) * np.array(LEFT_PX / frame.camera.width)
            label(pen, name, (at[0], max(at[1] - 5, 22)), STATE_COLOURS[state])
    return np.asarray(film)


def label(pen: ImageDraw.ImageDraw, text: str, foot: tuple[float, float], colour: Colour) -> None:
    """Text on a plate above a point."""
    half = pen.textlength(text, FONT) / 2
    x = float(np.clip(foot[0], half + 6, LEFT_PX - half - 6))
    pen.rounded_rectangle((x - half - 5, foot[1] - 20, x + half + 5, foot[1]), 5, GROUND)
    pen.text((x, foot[1] - 10), text, colour, FONT, anchor="mm")


def left(frame: RgbdFrame, models: Mapping[str, ReferenceModel], poses: Poses) -> UInt8:
    """The camera's image with the models' outlines."""
    picture = frame.color
    for name, pose in poses.items():
        T_cam_obj = pose_of(pose)
        if T_cam_obj is not None:
            mask = silhouette(models[name].mesh, T_cam_obj, frame.camera)
            colour = STATE_COLOURS[pose.state]
            picture = draw_mask_outline(tint(picture, mask, colour, 0.15), mask, colour, 3)
    return picture


def right(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], poses: Poses, trails: Mapping[str, list]
) -> UInt8:
    """The models at their poses with the points of the depth image, from the side."""
    T_side_cam = looking(EYE, LOOK_AT)
    picture: UInt8 = np.full((SIDE.height, SIDE.width, 3), GROUND, np.uint8)
    depth_mm = np.rint(1000 * frame.depth).astype(np.uint16)
    points, colors = cloud(frame.color, depth_mm, 0.001, frame.camera, stride=2)
    at_side = se3.apply(T_side_cam, points)
    u, v = np.rint(SIDE.project(at_side)).astype(int).T
    far_first = np.argsort(-at_side[:, 2])
    far_first = far_first[((u >= 0) & (v >= 0) & (u < SIDE.width - 2) & (v < SIDE.height - 2))[far_first]]
    for dv, du in np.ndindex(3, 3):
        picture[v[far_first] + dv, u[far_first] + du] = colors[far_first] * 0.6
    found = [(models[n].mesh, T_side_cam @ T) for n, p in poses.items() if (T := pose_of(p)) is not None]
    rendered = render(found, SIDE)
    picture = np.where((rendered.depth > 0)[..., None], rendered.color, picture)
    for name, trail in trails.items():
        if len(trail) > 1:
            line(picture, se3.apply(T_side_cam, np.array(trail)), STATE_COLOURS[poses[name].state])
    return picture


def line(picture: UInt8, points_side: Float64, colour: Colour) -> None:
    """Draw a line through points (N, 3) into the right half."""
    pixels = np.rint(16 * SIDE.project(points_side)).astype(np.int32)
    cv2.polylines(picture, [pixels], False, colour, 2, cv2.LINE_AA, 4)


def looking(eye: Float64, at: Float64) -> Float64:
    """T_side_cam of a camera at one point that looks at another, with the room's up at the top."""
    z = (at - eye) / np.linalg.norm(at - eye)
    x = np.cross(-UP_ROOM, z)
    x /= np.linalg.norm(x)
    R_cam_side = np.stack([x, np.cross(z, x), z], axis=1)
    return se3.inverse(se3.make(R_cam_side, eye))


if __name__ == "__main__":
    main()
