"""One frame from files: the forms of the camera's JSON, rectification, broken input."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.datasets.files import read_color
from huepose.datasets.image_files import read_camera, read_frame
from huepose.datasets.rectify import Rectifier, checked_coefficients
from huepose.geometry import Camera
from huepose.support.errors import InputError

from .conftest import HEIGHT, WIDTH, color_of, depth_of, write

OWN = {
    "fx": 20.0,
    "fy": 21.0,
    "cx": 7.5,
    "cy": 5.5,
    "width": WIDTH,
    "height": HEIGHT,
    "depth_scale_m": 0.0001,
}
BOP = {"fx": 20.0, "fy": 21.0, "cx": 7.5, "cy": 5.5, "width": WIDTH, "height": HEIGHT, "depth_scale": 0.1}
MATRIX = {"cam_K": [20.0, 0, 7.5, 0, 21.0, 5.5, 0, 0, 1], "depth_scale": 0.1}


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path, Path]:
    color, depth, camera = tmp_path / "000004.png", tmp_path / "depth.png", tmp_path / "camera.json"
    write(color, color_of(4))
    write(depth, depth_of(4))
    camera.write_text(json.dumps(OWN))
    return color, depth, camera


@pytest.mark.parametrize(
    "form",
    [
        OWN,
        BOP,
        MATRIX,
        {"3": {}, "4": MATRIX},
        {**OWN, "distortion_model": "none"},
        {**OWN, "distortion_model": None, "distortion": None},
        {**OWN, "distortion": None},
        {**OWN, "distortion_model": "inverse_brown_conrady", "distortion": [0.0] * 5},
        {**OWN, "distortion_model": "distortion.inverse_brown_conrady", "distortion": [0] * 5},
        {**OWN, "distortion_model": "Modified Brown Conrady", "distortion": [0.0] * 5},
        {**OWN, "distortion_model": "distortion.brown_conrady", "distortion": [0.0] * 5},
        {**OWN, "depth_scale": 0.1},
        {"K": [[20.0, 0, 7.5], [0, 21.0, 5.5], [0, 0, 1]], "depth_scale_m": 0.0001},
        {"intrinsic_matrix": [20.0, 0, 0, 0, 21.0, 0, 7.5, 5.5, 1], "depth_scale_m": 0.0001},
    ],
)
def test_every_form_of_intrinsics_gives_the_same_frame(files, form: dict) -> None:
    color, depth, camera = files
    camera.write_text(json.dumps(form))
    frame = read_frame(color, depth, camera)
    assert frame.camera == Camera(20.0, 21.0, 7.5, 5.5, WIDTH, HEIGHT)
    np.testing.assert_array_equal(frame.color, color_of(4))
    np.testing.assert_allclose(frame.depth, depth_of(4) * 1e-4, atol=1e-7)
    assert frame.frame_id == 4


@pytest.mark.parametrize(
    ("form", "named"),
    [
        ({k: v for k, v in OWN.items() if k != "fy"}, "fy"),
        ({k: v for k, v in OWN.items() if k != "depth_scale_m"}, "depth_scale_m"),
        ({**OWN, "depth_scale": 0.0001}, "'depth_scale_m': 0.0001 beside 'depth_scale': 0.0001"),
        ({**OWN, "width": 640}, "640 x 12"),
        ({**OWN, "fx": "wide"}, "fx"),
        ({**OWN, "fx": -1.0}, "fx"),
        ({**OWN, "distortion_model": "fisheye", "distortion": [1]}, "fisheye"),
        # Without coefficients, a fisheye lens is still no pinhole.
        ({**OWN, "distortion_model": "fisheye", "distortion": [0.0] * 4}, "fisheye"),
        (
            {**OWN, "distortion_model": "inverse_brown_conrady", "distortion": [0.1, 0, 0, 0, 0]},
            "'inverse_brown_conrady'.*librealsense: rs2_project_point_to_pixel",
        ),
        ({**OWN, "distortion_model": "inverse_brown_conrady", "distortion": "none"}, "inverse_brown_conrady"),
        ({**OWN, "distortion_model": "rational", "distortion": [0.1] * 5}, "8 numbers"),
        ({**OWN, "distortion_model": "none", "distortion": [0.1]}, "none"),
        ({"9": MATRIX}, r"image 4; expected one of its entries, 9\. The number at the end"),
        ({}, "fx"),
        (
            {**OWN, "distortion": [0.1, 0, 0, 0]},
            r"with distortion_model 'none'; expected distortion_model: brown_conrady",
        ),
        ({**MATRIX, "cam_K": [20.0, 0, 0, 0, 21.0, 0, 7.5, 5.5, 1]}, r"row by row"),
        ({**MATRIX, "cam_K": [20.0, 3.0, 7.5, 0, 21.0, 5.5, 0, 0, 1]}, r"a skew of 3 beside"),
        ({**MATRIX, "cam_K": [20.0, 0, 7.5, -2.0, 21.0, 5.5, 0, 0, 1]}, r"a skew of -2 beside"),
        ({"camera_matrix": {"data": [1.0] * 9}}, r"keys camera_matrix; .*intrinsic_matrix"),
        *(
            (
                {**OWN, key: value},
                f"found the key '{key}'; .*'distortion'.*brown_conrady, plumb_bob, rational",
            )
            for key, value in (("dist", [0.1] * 5), ("D", [0.0] * 5), ("coeffs", [0.1] * 5), ("k1", 0.1))
        ),
    ],
)
def test_the_error_names_the_wrong_key_of_a_camera_file(files, form: dict, named: str) -> None:
    color, depth, camera = files
    camera.write_text(json.dumps(form))
    with pytest.raises(InputError, match=named):
        read_frame(color, depth, camera)


def test_a_wrong_colour_image_is_named_before_its_entry_in_a_camera_file(files) -> None:
    color, depth, camera = files
    camera.write_text(json.dumps({"4": {"cam_K": MATRIX["cam_K"], "depth_scale": 1.0}}))
    with pytest.raises(InputError, match=f"^{re.escape(str(color.parent))}: "):
        read_frame(color.parent, depth, camera)


def test_the_error_for_a_ros_camera_file_lists_the_supported_forms(tmp_path: Path) -> None:
    path = tmp_path / "ros.yaml"
    path.write_text("image_width: 640\ncamera_matrix:\n  data: [20.0, 0.0, 7.5]\n")
    with pytest.raises(
        InputError, match=r"no valid JSON .*A camera file is JSON with fx, fy, cx, cy \(or K or cam_K"
    ):
        read_camera(path)


def test_the_ros_name_of_a_distortion_model_means_the_same(files) -> None:
    frames = []
    for model in ("brown_conrady", "plumb_bob"):
        record = {**OWN, "distortion_model": model, "distortion": [0.2, 0.05, 0.0, 0.0, 0.0]}
        files[2].write_text(json.dumps(record))
        frames.append(read_frame(*files))
    np.testing.assert_array_equal(frames[0].color, frames[1].color)
    assert not np.array_equal(frames[0].color, color_of(4))


@pytest.mark.parametrize(
    ("values", "name", "says"),
    [
        (np.ones((HEIGHT, WIDTH), np.float32), "depth.tif", r"float32 .* \(depth \* 1000\)\.astype"),
        (np.ones((HEIGHT, WIDTH), np.uint8), "depth.png", r"uint8 values in 1 channel; .*256 steps"),
        (np.ones((HEIGHT, WIDTH, 3), np.uint8), "depth.png", r"3 channels; .*coloured image"),
    ],
)
def test_the_error_for_depth_of_another_type_says_what_to_save(files, values, name: str, says: str) -> None:
    depth = files[1].with_name(name)
    write(depth, values)
    with pytest.raises(InputError, match=says):
        read_frame(files[0], depth, files[2])


def test_the_error_for_a_numpy_file_says_what_to_save(files) -> None:
    depth = files[1].with_name("depth.npy")
    np.save(depth, np.ones((HEIGHT, WIDTH), np.float32))
    with pytest.raises(InputError, match=r"array of numpy; .*\(depth \* 1000\)\.astype"):
        read_frame(files[0], depth, files[2])


def test_the_error_names_missing_and_mismatched_images(files, tmp_path: Path) -> None:
    color, depth, camera = files
    with pytest.raises(InputError, match=r"gone\.png"):
        read_frame(tmp_path / "gone.png", depth, camera)
    cv2.imwrite(str(depth), np.ones((5, 5), np.uint16))
    with pytest.raises(InputError, match=r"depth\.png.*5 x 5.*16 x 12"):
        read_frame(color, depth, camera)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("brown_conrady", [-0.25, 0.08, 1e-3, -2e-3, 0.01]),
        ("rational", [0.3, 0.1, 1e-3, -1e-3, 0.02, 0.5, 0.2, 0.05]),
    ],
)
def test_rectified_pixels_lie_on_the_pinhole_rays(model: str, coefficients: list[float]) -> None:
    """Rectification moves spots from their distorted projections to their pinhole projections."""
    camera = Camera(200.0, 210.0, 159.5, 119.5, 320, 240)
    points = np.array([[x, y, 1.0] for x in (-0.5, 0.0, 0.5) for y in (-0.35, 0.0, 0.35)])
    seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.K, np.array(coefficients))
    v, u = np.mgrid[:240, :320]
    image, depth = np.zeros((240, 320, 3)), np.zeros((240, 320), np.float32)
    for k, (x, y) in enumerate(seen[:, 0]):
        distance = np.hypot(u - x, v - y)
        image[..., 0] += 255 * np.exp(-((distance / 2.5) ** 2))
        depth[distance < 4] = 0.5 + 0.1 * k
    rectifier = Rectifier.of(camera, checked_coefficients(model, coefficients, "test"))
    color, moved = rectifier.color(np.clip(image, 0, 255).astype(np.uint8)), rectifier.depth(depth)
    assert set(np.unique(moved)) <= set(np.unique(depth))  # readings are moved, never mixed
    for k, (x, y) in enumerate(camera.project(points)):
        weight = color[..., 0] * (np.hypot(u - x, v - y) < 10)
        centre = [(weight * u).sum() / weight.sum(), (weight * v).sum() / weight.sum()]
        np.testing.assert_allclose(centre, [x, y], atol=0.25)
        assert moved[round(y), round(x)] == pytest.approx(0.5 + 0.1 * k)


def test_distorted_files_are_rectified(files) -> None:
    color, depth, camera = files
    coefficients = [0.2, 0.05, 0.0, 0.0]
    camera.write_text(json.dumps({**OWN, "distortion_model": "brown_conrady", "distortion": coefficients}))
    frame = read_frame(color, depth, camera)
    rectifier = Rectifier.of(frame.camera, np.array(coefficients))
    np.testing.assert_array_equal(frame.color, rectifier.color(color_of(4)))
    assert not np.array_equal(frame.color, color_of(4))


def test_a_camera_file_without_a_size_takes_that_of_the_image(files) -> None:
    camera = files[2]
    camera.write_text(json.dumps(MATRIX))
    assert read_camera(camera).camera(32, 20, files[0]).width == 32


@pytest.mark.parametrize("scale_m", [1.0, 1e-7])
def test_depth_in_wrong_units_is_an_error(files, scale_m: float) -> None:
    color, depth, camera = files
    camera.write_text(json.dumps({**OWN, "depth_scale_m": scale_m}))
    with pytest.raises(InputError, match=r"a median depth of .* Correct the depth scale in .*camera.json"):
        read_frame(color, depth, camera)


def test_a_depth_image_given_as_colour_is_an_error(files) -> None:
    _, depth, camera = files
    with pytest.raises(InputError, match=r"found uint16 values; expected a colour image with 8 bit values"):
        read_frame(depth, depth, camera)


def test_a_depth_image_without_any_reading_is_an_error(files) -> None:
    color, depth, camera = files
    write(depth, np.zeros((HEIGHT, WIDTH), np.uint16))
    with pytest.raises(InputError, match=r"depth.png: found no depth in any pixel"):
        read_frame(color, depth, camera)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"fx": ' + "9" * 5000 + "}", '{"distortion": 7, "cam_K": 1}']
)
def test_any_invalid_camera_file_is_an_input_error(tmp_path, text):
    (tmp_path / "camera.json").write_text(text)
    with pytest.raises(InputError):
        read_camera(tmp_path / "camera.json")


@pytest.mark.parametrize(
    "data",
    [
        b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00\x40\x00\x00\x00\x40\x00\x08\x02\x00\x00\x00",
        b"\xff\xd8\xff\xe0\x00\x04\x00\x00\xff\xc0\x00\x11\x08\x40\x00\x40\x00\x03" + bytes(20),
    ],
)
def test_an_image_with_too_many_pixels_is_refused_before_it_is_decoded(tmp_path, data):
    (tmp_path / "large.png").write_bytes(data)
    with pytest.raises(InputError, match="16384 x 16384 pixels"):
        read_color(tmp_path / "large.png")


@pytest.mark.parametrize(
    ("name", "said", "frame_id", "stamp_ns"),
    [
        ("000003.png", {}, 3, 100_000_000),
        ("color_000003.png", {}, 3, 100_000_000),
        ("run2_color.png", {}, 0, 0),
        ("color.png", {"frame_id": 3}, 3, 100_000_000),
        ("color_1.png", {"stamp_ns": 77}, 1, 77),
        ("color_1.png", {"frame_id": 0, "stamp_ns": 0}, 0, 0),
    ],
)
def test_a_frame_has_the_number_in_its_name_and_the_time_at_30_hz_unless_given(
    files, name: str, said: dict[str, int], frame_id: int, stamp_ns: int
) -> None:
    color, depth, camera = files
    frame = read_frame(color.rename(color.with_name(name)), depth, camera, **said)
    assert (frame.frame_id, frame.stamp_ns) == (frame_id, stamp_ns)


def test_a_missing_camera_file_is_not_taken_for_broken_json(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.json: found no such file\. Write the camera"):
        read_camera(tmp_path / "nowhere.json")
