"""Point pair features of OpenCV-contrib, in a separate environment: pickled requests in, answers out.

Run by `ppf_rival.py` with the Python of `make_env.sh`; needs numpy and opencv-contrib only. Lengths in mm.
"""

from __future__ import annotations

import pickle
import sys
import time

import cv2
import numpy as np

SAMPLING = 0.08
"""In diameters. With the usual 0.05 the hash table of a box takes minutes to fill: its sides are similar."""


def main() -> None:
    """Serve until the pipe closes. Requests: ("train", name, Nx6) and ("pose", name, Nx6)."""
    cv2.setNumThreads(1)
    models: dict[str, tuple[object, np.ndarray]] = {}
    requests, answers = sys.stdin.buffer, sys.stdout.buffer
    while True:
        try:
            kind, name, points = pickle.load(requests)
        except EOFError:
            return
        start = time.process_time()
        if kind == "train":
            detector = cv2.ppf_match_3d_PPF3DDetector(SAMPLING, SAMPLING)
            detector.trainModel(points)
            models[name] = detector, points
            found = None
        else:
            found = _pose(*models[name], points)
        pickle.dump((found, time.process_time() - start), answers)
        answers.flush()


def _pose(detector: object, model: np.ndarray, scene: np.ndarray) -> tuple[np.ndarray, float] | None:
    """T_cam_obj (4, 4) in mm and the residual of the best of five hypotheses after ICP."""
    try:
        hypotheses = list(detector.match(scene, 1.0 / 5.0, SAMPLING / 2))[:5]
    except cv2.error:
        return None
    if not hypotheses:
        return None
    _, refined = cv2.ppf_match_3d_ICP(100).registerModelToScene(model, scene, hypotheses)
    best = min(refined, key=lambda pose: pose.residual)
    return np.array(best.pose), float(best.residual)


if __name__ == "__main__":
    main()
