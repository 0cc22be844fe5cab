"""What shading shows of a surface whose shape is known."""

import numpy as np

from huepose.drawing.shading import shaded

SIZE, PIXEL_M, STEP_M = 40, 0.001, 0.002
GREY = np.full((SIZE, SIZE, 3), 200, np.uint8)


def plane(right_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth and normals of a plane that goes away from the camera to the right."""
    turn = np.radians(right_deg)
    depth = np.broadcast_to(1.0 + PIXEL_M * np.tan(turn) * np.arange(SIZE), (SIZE, SIZE))
    normal = np.array([np.sin(turn), 0.0, -np.cos(turn)])
    return depth.astype(np.float32), np.broadcast_to(normal, (SIZE, SIZE, 3)).astype(np.float32)


def test_what_faces_the_camera_keeps_its_colour() -> None:
    assert (shaded(GREY, *plane(0.0), PIXEL_M, STEP_M) == GREY).all()


def test_what_turns_away_is_darker_evenly() -> None:
    """To the left it turns towards the light; a slanted surface is no step."""
    levels = []
    for degrees in (10.0, 40.0, 70.0):
        picture = shaded(GREY, *plane(degrees), PIXEL_M, STEP_M)
        assert np.unique(picture[2:-2, 2:-2]).size == 1
        levels.append(int(picture[20, 20, 0]))
    assert 200 > levels[0] > levels[1] > levels[2] >= 90
    assert shaded(GREY, *plane(-10.0), PIXEL_M, STEP_M)[20, 20, 0] == 200


def test_the_far_side_of_a_step_is_dark_and_nothing_else() -> None:
    depth, normals = plane(0.0)
    for step_m, dark in ((0.003, 2), (0.001, 0)):
        stepped = depth.copy()
        stepped[:, 20:] += np.float32(step_m)
        columns = np.flatnonzero((shaded(GREY, stepped, normals, PIXEL_M, STEP_M) < 200).any((0, 2)))
        assert columns.tolist() == [20, 21][:dark]


def test_what_is_nothing_stays_as_it_is() -> None:
    depth, normals = (array.copy() for array in plane(60.0))
    depth[:, 20:], normals[:, 20:] = 0.0, 0.0
    picture = shaded(GREY, depth, normals, PIXEL_M, STEP_M)
    assert (picture[:, 20:] == 200).all()
    assert np.unique(picture[:, :20]).size == 1
