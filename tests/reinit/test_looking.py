"""Where a request looks when some objects are tracked already."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Box
from huepose.model import ReferenceModel
from huepose.perception.types import Detection
from huepose.profiles import profile
from huepose.reinit.looking import chosen
from huepose.reinit.loop import ReinitLoop
from huepose.reinit.types import ObjectSlot
from huepose.tracking import Correction, Tracker
from studies.live import HZ, NOWHERE, Sight, shown
from studies.stress.films import Seen
from studies.stress.play import followed
from tests.conftest import TakePicture
from tests.meshes import demo_objects
from tests.onboarded import onboarded

HERE, BESIDE, THERE, AWAY = (Box(x, 50, 60, 60) for x in (50, 60, 200, 400))


def _chosen(*tracked: tuple[str, Box], wanted: int = 1) -> list[Box]:
    seen = [Detection("can", box, score) for box, score in ((HERE, 0.9), (THERE, 0.5), (AWAY, 0.2))]
    return [d.box for d in chosen([Detection("cup", AWAY, 0.95), *seen], "can", wanted, tracked)]


def test_the_best_places_are_looked_at_and_no_more_than_wanted() -> None:
    assert _chosen() == [HERE]
    assert _chosen(("cup", Box(500, 300, 60, 60)), wanted=2) == [HERE, THERE]


def test_a_place_of_a_tracked_instance_is_not_looked_at() -> None:
    assert _chosen(("can", BESIDE)) == [THERE]
    assert _chosen(("can", HERE), ("can", THERE), ("can", AWAY)) == []


def test_its_best_place_is_looked_at_even_where_another_object_is() -> None:
    assert _chosen(("cup", BESIDE)) == [HERE, THERE]
    assert _chosen(("cup", THERE)) == [HERE], "the object is more likely elsewhere"
    assert _chosen(("cup", HERE), ("cup", THERE), wanted=2) == [HERE, AWAY]


@pytest.mark.parametrize("quality", [1.0, 0.5])
def test_a_look_alike_gives_way_to_the_object_that_is_there(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, quality: float
) -> None:
    """The look-alike is tracked first, in the pose of a box with another print. Alone it stays TRACKING or
    SUSPECT."""
    other = onboarded(demo_objects(1)["tea_box"], "other_box")
    models, rng = {"tea_box": tea_box, "other_box": other}, np.random.default_rng(0)
    picture = take_picture([(other.mesh, standing)])
    frames = [Seen(shown(picture, number, rng), NOWHERE, 1.0) for number in range(2 * HZ)]
    tracker = Tracker(models, profile("live").tracker)
    tracker.correct(Correction.first("tea_box", standing, frames[0].frame, quality))
    loop = ReinitLoop(objects=[ObjectSlot.of(model) for model in models.values()])
    played = [
        {p.object: p.state.value for p in poses if p.T_cam_obj is not None}
        for _, poses in followed(frames, tracker, loop, Sight(*models.values()))
    ]
    assert played[1] == {"tea_box": "TRACKING" if quality == 1.0 else "SUSPECT"}
    assert played[-1] == {"other_box": "TRACKING"}
