"""Static objects have poses again after the tracker died."""

import json
import os
import shutil
import signal

import pytest

from huepose_services.runtime.running import pick
from huepose_services.watch import Watch
from tests.services.conftest import patient_pipeline

pytestmark = [pytest.mark.live, pytest.mark.timeout(180)]


def test_a_static_object_is_tracked_again_after_the_tracker_died(recording, tmp_path, huepose, wait_until):
    """Perception then agrees with the last poses, which no tracker tracks any more."""
    folder, _, _ = recording
    still = tmp_path / "still"
    for part in ("rgb", "depth"):
        (still / part).mkdir(parents=True)
        shutil.copy(folder / "scene" / part / "000000.png", still / part)
    cameras = json.loads((folder / "scene" / "scene_camera.json").read_text())
    (still / "scene_camera.json").write_text(json.dumps({"0": cameras["0"]}))
    path = tmp_path / "pipeline.yaml"
    path.write_text(json.dumps(patient_pipeline(folder / "bundles", still)))
    huepose("up", path)

    def tracked_since(stamp_ns):
        watch.look(0.1)
        poses = watch.view().poses.values()
        return any(p.state == "TRACKING" and p.capture_ns > stamp_ns for p in poses)

    def tracker():
        watch.look(0.1)
        return watch.view().health.get("tracker")

    with Watch(pick(path)) as watch:
        wait_until(lambda: tracked_since(0) and tracker() is not None, 90.0)
        first = tracker()
        os.kill(first.pid, signal.SIGKILL)
        wait_until(lambda: (now := tracker()) is not None and now.pid != first.pid, 60.0)
        began_ns = tracker().publish_ns
        wait_until(lambda: tracked_since(began_ns), 60.0)
