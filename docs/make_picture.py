"""Makes docs/images/overview.jpg: a frame of the built-in scene, and the estimated poses.

    .venv/bin/python docs/make_picture.py

Left: the colour image with the poses found in disturbed boxes (outline, axes, error against the truth).
Right: its depth as a stereo camera measures it. Below: the colour pairs of the objects, and the models
rendered at their poses.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from huepose import Estimator, ObjectQuery, load_models
from huepose.colorpair.extract import extract
from huepose.datasets.boxes import disturbed
from huepose.drawing.contact_sheet import contact_sheet
from huepose.drawing.depth_color import depth_to_color
from huepose.drawing.overlay import Body, draw_poses
from huepose.evaluation.metrics import add
from huepose.geometry.arrays import Float, UInt8
from huepose.rendering.render import render
from huepose.scenes.builtin import SyntheticScene
from huepose_services.builtin import builtin_bundles

SEED, FRAME = 0, 150
COLORS = [(255, 196, 0), (0, 200, 255), (120, 255, 80), (255, 90, 160), (190, 140, 255)]


def main() -> None:
    """Estimate one frame, draw it, write the file."""
    scene, models = SyntheticScene(SEED), load_models(builtin_bundles(SEED))
    frame, truths = scene.frame(FRAME), scene.truths(FRAME)
    boxes = [
        disturbed(t.box_visib, "perturbed", 0, "picture", FRAME, t.instance, frame.camera) for t in truths
    ]
    queries = [ObjectQuery(t.object, box) for t, box in zip(truths, boxes, strict=True)]
    answers = Estimator(models).estimate(frame, queries)

    found = [(models[a.object].mesh, a.T_cam_obj) for a in answers if a.found]
    rendered = render(found, frame.camera)
    bodies, pairs_picture = [], (frame.color // 3).copy()
    for k, (truth, answer) in enumerate(zip(truths, answers, strict=True)):
        if not answer.found:
            continue
        model = models[answer.object]
        error_mm = 1000 * add(model.eval_points, answer.T_cam_obj, truth.T_cam_obj)
        label = f"{model.name} {error_mm:.1f} mm"
        bodies.append(Body(model.mesh, answer.T_cam_obj, COLORS[k % len(COLORS)], label))
        pairs = extract(frame.color, answer.mask)
        some = pairs[np.linspace(0, len(pairs) - 1, min(len(pairs), 120)).astype(int)]
        rgb = cv2.cvtColor(some.colors, cv2.COLOR_Lab2RGB)
        pairs_picture = draw_color_pairs(pairs_picture, some.pixels, np.rint(255 * rgb).astype(np.uint8))
    models_picture = np.where((rendered.depth > 0)[..., None], rendered.color, frame.color // 4)
    sheet = contact_sheet(
        [
            draw_poses(frame.color, frame.camera, bodies),
            depth_to_color(frame.depth),
            pairs_picture,
            models_picture,
        ],
        2,
        ["poses found, error against the truth", "depth", "colour pairs", "models at their poses"],
    )
    target = Path(__file__).parent / "images" / "overview.jpg"
    cv2.imwrite(str(target), np.ascontiguousarray(sheet[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 88])
    print(target)


def draw_color_pairs(image: UInt8, pixels: Float, colors: UInt8) -> UInt8:
    """The image (H, W, 3) with a disc at each of the pixels (N, 2), a half in each of its two colours (N, 2,
    3)."""
    picture, radius = image.copy(), 3
    for (u, v), (one, other) in zip(np.rint(pixels).astype(int).tolist(), colors.tolist(), strict=True):
        cv2.circle(picture, (u, v), radius + 1, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.ellipse(picture, (u, v), (radius, radius), 0, 90, 270, one, -1, cv2.LINE_AA)
        cv2.ellipse(picture, (u, v), (radius, radius), 0, -90, 90, other, -1, cv2.LINE_AA)
    return picture


if __name__ == "__main__":
    main()
