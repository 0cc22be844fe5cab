"""One frame: which of the known objects are in it, and where.

huepose new tea_box examples/tea_box.obj
python examples/01_one_frame.py tea_box
"""

import sys
from pathlib import Path

from huepose import Estimator, ObjectQuery, load_models
from huepose.datasets.image_files import read_frame
from huepose.perception.view_detector import ViewDetector
from huepose.support.errors import InputError

if len(sys.argv) < 2:
    sys.exit(__doc__)
folder = Path(sys.argv[1])
try:
    models = load_models(folder / "bundles")
    frame = read_frame(folder / "color.png", folder / "depth.png", folder / "camera.json")
except InputError as error:  # says what to do
    sys.exit(str(error))

places = ViewDetector(models).detect(frame, sorted(models))  # needs no training; or use your own boxes
queries = [ObjectQuery(place.object, place.box, searched=True) for place in places]
for pose in Estimator(models).estimate(frame, queries):
    if pose.T_cam_obj is not None:
        print(pose.object, pose.state, f"{pose.quality:.2f}", pose.T_cam_obj[:3, 3].round(3), "m")
