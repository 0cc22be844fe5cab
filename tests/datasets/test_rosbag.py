"""ROS 1 and ROS 2 bags, written here with rosbags and read back."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from huepose.datasets.rectify import Rectifier
from huepose.datasets.rosbag import RosbagScene, Topics
from huepose.geometry import Camera
from huepose.support.errors import InputError
from huepose_services.camera.sources import open_source
from huepose_services.cli.main import main
from huepose_services.runtime.config_file import load

WIDTH, HEIGHT, COUNT = 32, 24, 4
CAMERA = Camera(40.0, 41.0, 15.5, 11.0, WIDTH, HEIGHT)
BARREL = [-0.2, 0.05, 0.001, -0.002, 0.0]
COLOR, DEPTH, INFO = "/cam/color/image_raw", "/cam/aligned_depth_to_color/image_raw", "/cam/color/camera_info"
DEPTH_INFO = "/cam/aligned_depth_to_color/camera_info"
START_NS, STEP_NS = 1_700_000_000_123_456_789, 33_000_000
RNG = np.random.default_rng(5)
COLORS = RNG.integers(0, 256, (COUNT, HEIGHT, WIDTH, 3), np.uint8)
DEPTHS_MM = RNG.integers(0, 3000, (COUNT, HEIGHT, WIDTH), np.uint16)
BAGS = ("desk.bag", "desk_db3", "desk_mcap")


class Ros:
    """Messages of ROS 1 or ROS 2, which differ in headers and in CameraInfo."""

    def __init__(self, name: str) -> None:
        self.is1 = name.endswith(".bag")
        self.store = get_typestore(Stores.ROS1_NOETIC if self.is1 else Stores.ROS2_JAZZY)
        self.plugin = StoragePlugin.MCAP if name.endswith("mcap") else StoragePlugin.SQLITE3
        self.types = self.store.types

    def header(self, stamp_ns: int) -> Any:
        stamp = self.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
        seq = {"seq": 7} if self.is1 else {}
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id="optical", **seq)

    def image(self, pixels: Any, encoding: str, stamp_ns: int, fill: int = 0) -> Any:
        height, width = pixels.shape[:2]
        rows = np.frombuffer(pixels.tobytes(), np.uint8).reshape(height, -1)
        rows = np.pad(rows, ((0, 0), (0, fill)))
        return self.types["sensor_msgs/msg/Image"](
            self.header(stamp_ns), height, width, encoding, 0, rows.shape[1], rows.ravel()
        )

    def compressed(self, data: bytes, kind: str, stamp_ns: int) -> Any:
        array = np.frombuffer(data, np.uint8)
        return self.types["sensor_msgs/msg/CompressedImage"](self.header(stamp_ns), kind, array)

    def info(self, camera: Camera = CAMERA, d: Iterable[float] = (), model: str = "plumb_bob") -> Any:
        roi = self.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        P = np.hstack([camera.K, np.zeros((3, 1))]).ravel()
        matrices = {"d": np.array([*d], np.float64), "k": camera.K.ravel(), "r": np.eye(3).ravel(), "p": P}
        named = {key.upper() if self.is1 else key: value for key, value in matrices.items()}
        return self.types["sensor_msgs/msg/CameraInfo"](
            header=self.header(START_NS), height=camera.height, width=camera.width,
            distortion_model=model, binning_x=0, binning_y=0, roi=roi, **named,
        )  # fmt: skip

    def write(self, path: Path, messages: Iterable[tuple[str, int, Any]]) -> Path:
        """Write a bag of (topic, recording time, message)."""
        writer = Writer1(path) if self.is1 else Writer2(path, version=9, storage_plugin=self.plugin)
        dump = self.store.serialize_ros1 if self.is1 else self.store.serialize_cdr
        with writer:
            of: dict[str, Any] = {}
            for topic, log_ns, message in messages:
                kind = message.__msgtype__
                if topic not in of:
                    of[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(of[topic], log_ns, dump(message, kind))
        return path


def stamps_ns(number: int) -> tuple[int, int]:
    """Timestamps of colour and depth; the third depth is more than half a frame away from every colour."""
    color = START_NS + number * STEP_NS
    return color, color + (20_000_000 if number == 2 else 3_000_000)


def desk(ros: Ros, d: Iterable[float] = (), **made: Any) -> list[tuple[str, int, Any]]:
    """Messages of a complete bag; `made` replaces the images or the topics of colour and depth."""
    color = made.get("color", lambda n, ns: ros.image(COLORS[n], "rgb8", ns))
    depth = made.get("depth", lambda n, ns: ros.image(DEPTHS_MM[n], "16UC1", ns, fill=6))
    messages: list[tuple[str, int, Any]] = []
    for n in range(COUNT):
        color_ns, depth_ns = stamps_ns(n)
        messages.append((INFO, color_ns, ros.info(d=d)))
        messages.append((made.get("color_topic", COLOR), color_ns + 9, color(n, color_ns)))
        messages.append((made.get("depth_topic", DEPTH), color_ns + 9, depth(n, depth_ns)))
    return messages


ANY = Topics()


def refusal(path: Path, topics: Topics | None = ANY) -> str:
    with pytest.raises(InputError) as error:
        RosbagScene(path, topics)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_unaligned_realsense_depth_is_refused_unless_named_or_from_the_colour_sensor(
    tmp_path: Path,
) -> None:
    ros, unaligned = Ros("desk.bag"), "/cam/depth/image_rect_raw"
    bag = ros.write(tmp_path / "desk.bag", desk(ros, depth_topic=unaligned))
    said = refusal(bag)
    assert f"{unaligned}: found no CameraInfo of RealSense's own depth, which is not aligned" in said
    assert "name it: camera.depth_topic" in said
    assert "its topic aligned_depth_to_color" in said
    assert RosbagScene(bag, Topics(depth=unaligned)).topics.depth == unaligned
    of_one_sensor = desk(ros, depth_topic=unaligned, color_topic="/cam/color/image_rect_raw")
    assert RosbagScene(ros.write(tmp_path / "d405.bag", of_one_sensor)).image_ids == (0, 1, 2)


@pytest.mark.parametrize("name", BAGS)
def test_frames_are_read_as_they_were_written(name: str, tmp_path: Path) -> None:
    ros = Ros(name)
    scene = RosbagScene(ros.write(tmp_path / name, desk(ros)))
    assert scene.topics == Topics(COLOR, DEPTH, INFO)
    assert scene.image_ids == (0, 1, 2)  # the third of four colour images has no depth near its timestamp
    written = [0, 1, 3]
    for image in [0, 1, 2, 1, 0]:  # forwards, and back
        frame, n = scene.frame(image), written[image]
        np.testing.assert_array_equal(frame.color, COLORS[n])
        np.testing.assert_array_equal(frame.depth, DEPTHS_MM[n].astype(np.float32) * np.float32(0.001))
        assert frame.stamp_ns == scene.stamp_ns(image) == stamps_ns(n)[0]
        assert frame.camera == CAMERA
    assert scene.truths(0) == ()


@pytest.mark.parametrize("name", BAGS)
def test_distorted_images_are_rectified(name: str, tmp_path: Path) -> None:
    ros = Ros(name)
    frame = RosbagScene(ros.write(tmp_path / name, desk(ros, BARREL))).frame(0)
    rectifier = Rectifier.of(CAMERA, np.array(BARREL))
    np.testing.assert_array_equal(frame.color, rectifier.color(COLORS[0]))
    metres = DEPTHS_MM[0].astype(np.float32) * np.float32(0.001)
    np.testing.assert_array_equal(frame.depth, rectifier.depth(metres))
    assert not np.array_equal(frame.color, COLORS[0])


def test_images_that_were_recorded_twice_are_read_once(tmp_path: Path) -> None:
    ros = Ros("desk.bag")
    once = desk(ros)
    again = [(topic, log_ns + 1000, m) for topic, log_ns, m in once if topic != INFO]
    scene = RosbagScene(ros.write(tmp_path / "desk.bag", [*once, *again]), Topics())
    assert [scene.stamp_ns(image) for image in scene.image_ids] == [stamps_ns(n)[0] for n in (0, 1, 3)]
    assert (scene.frame(2).color == COLORS[3]).all()


@pytest.mark.parametrize("which", ["color", "depth"])
@pytest.mark.parametrize("d", [[0.0] * 5, BARREL])
def test_an_image_of_another_size_than_the_first_is_refused(
    which: str, d: list[float], tmp_path: Path
) -> None:
    ros = Ros("desk.bag")

    def image(n: int, ns: int) -> Any:
        pixels = COLORS[n] if which == "color" else DEPTHS_MM[n]
        return ros.image(pixels[::2, ::2] if n else pixels, "rgb8" if which == "color" else "16UC1", ns)

    scene = RosbagScene(ros.write(tmp_path / "desk.bag", desk(ros, d, **{which: image})), Topics())
    scene.frame(0)
    with pytest.raises(InputError, match="12, 16"):
        scene.frame(1)


def test_rectified_images_have_the_intrinsics_in_p(tmp_path: Path) -> None:
    ros = Ros("a")
    messages = desk(ros, BARREL, color_topic="/cam/color/image_rect_color")
    for _, _, message in messages:
        if hasattr(message, "p"):
            message.k[0] = 99.0
    frame = RosbagScene(ros.write(tmp_path / "a", messages)).frame(0)
    np.testing.assert_array_equal(frame.color, COLORS[0])
    assert frame.camera == CAMERA


@pytest.mark.parametrize(
    ("encoding", "order"), [("bgr8", [2, 1, 0]), ("rgba8", [0, 1, 2, 0]), ("bgra8", [2, 1, 0, 0])]
)
def test_other_channel_orders_are_converted_to_rgb(encoding: str, order: list[int], tmp_path: Path) -> None:
    ros = Ros("a")
    messages = desk(ros, color=lambda n, ns: ros.image(COLORS[n][..., order], encoding, ns, fill=5))
    np.testing.assert_array_equal(RosbagScene(ros.write(tmp_path / "a", messages)).frame(1).color, COLORS[1])


@pytest.mark.parametrize("kind", ["png", "rgb8; png compressed bgr8", "rgb8; png compressed "])
def test_compressed_images_are_read(kind: str, tmp_path: Path) -> None:
    """A sender that gave RGB to the codec as if it were BGR writes the last format."""
    ros = Ros("a")
    order = [0, 1, 2] if kind.endswith(" ") else [2, 1, 0]

    def color(n: int, ns: int) -> Any:
        return ros.compressed(cv2.imencode(".png", COLORS[n][..., order])[1].tobytes(), kind, ns)

    def depth(n: int, ns: int) -> Any:
        png = bytes(12) + cv2.imencode(".png", DEPTHS_MM[n])[1].tobytes()
        return ros.compressed(png, "16UC1; compressedDepth png", ns)

    topics = {"color_topic": f"{COLOR}/compressed", "depth_topic": f"{DEPTH}/compressedDepth"}
    frame = RosbagScene(ros.write(tmp_path / "a", desk(ros, color=color, depth=depth, **topics))).frame(1)
    np.testing.assert_array_equal(frame.color, COLORS[1])
    np.testing.assert_array_equal(frame.depth, DEPTHS_MM[1].astype(np.float32) * np.float32(0.001))


def test_depth_compressed_by_rvl_is_refused_by_its_encoding(tmp_path: Path) -> None:
    ros = Ros("a")
    encoding = "16UC1; compressedDepth rvl"
    messages = desk(
        ros,
        depth=lambda n, ns: ros.compressed(bytes(40), encoding, ns),
        depth_topic=f"{DEPTH}/compressedDepth",
    )
    said = refusal(ros.write(tmp_path / "a", messages))
    assert f"an image with the encoding '{encoding}'" in said
    assert "16UC1 as compressedDepth in PNG" in said


def test_depth_in_metres_has_0_where_there_is_no_reading(tmp_path: Path) -> None:
    ros = Ros("a")
    metres = (DEPTHS_MM / np.float32(700)).astype(np.float32)
    metres[:, 0, :3] = np.nan, np.inf, -1.0
    messages = desk(ros, depth=lambda n, ns: ros.image(metres[n], "32FC1", ns))
    read = RosbagScene(ros.write(tmp_path / "a", messages)).frame(0).depth
    assert read[0, :3].tolist() == [0, 0, 0]
    np.testing.assert_array_equal(read[1:], metres[0, 1:])


def test_with_several_pairs_of_topics_one_must_be_named(tmp_path: Path) -> None:
    ros = Ros("a")
    other = [(t, ns, m) for t, ns, m in desk(ros, color_topic="/rear/image_raw") if t == "/rear/image_raw"]
    path = ros.write(tmp_path / "a", [*desk(ros), *other])
    said = refusal(path)
    assert all(part in said for part in ("2 pairs", COLOR, "/rear/image_raw (rgb8)", "camera.color_topic"))
    assert "Leave others out" in refusal(path, None)
    assert RosbagScene(path, Topics(color=COLOR)).topics.depth == DEPTH
    assert "no images of that name" in refusal(path, Topics(color="/nothing"))
    assert "camera.info_topic /x: found no CameraInfo" in refusal(path, Topics(color=COLOR, info="/x"))


def test_a_compressed_image_that_is_too_large_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    ros = Ros("a")
    large = bytearray(cv2.imencode(".png", COLORS[0])[1].tobytes())
    large[16:24] = struct.pack(">II", 100_000, 100_000)
    path = ros.write(
        tmp_path / "a",
        [*desk(ros), (f"{COLOR}/compressed", START_NS, ros.compressed(bytes(large), "png", START_NS))],
    )
    with pytest.raises(InputError, match="found 100000 x 100000 pixels"):
        RosbagScene(path, Topics(color=f"{COLOR}/compressed")).frame(0)


def test_the_uncompressed_image_is_preferred(tmp_path: Path) -> None:
    ros = Ros("a")
    jpeg = ros.compressed(cv2.imencode(".jpg", COLORS[0])[1].tobytes(), "jpeg", START_NS)
    path = ros.write(tmp_path / "a", [*desk(ros), (f"{COLOR}/compressed", START_NS, jpeg)])
    assert RosbagScene(path).topics.color == COLOR
    assert RosbagScene(path, Topics(color=f"{COLOR}/compressed")).image_ids == (0,)


def test_depth_that_is_not_aligned_to_colour_is_refused(tmp_path: Path) -> None:
    ros = Ros("a")
    half = desk(ros, depth=lambda n, ns: ros.image(DEPTHS_MM[n, ::2, ::2].copy(), "16UC1", ns))
    said = refusal(ros.write(tmp_path / "half", half))
    assert "depth of 16 x 12, and colour of 32 x 24" in said
    assert "aligned_depth_to_color" in said
    other = (DEPTH_INFO, START_NS, ros.info(Camera(44.0, 44.0, 15.5, 11.0, WIDTH, HEIGHT)))
    assert f"K in {DEPTH_INFO} that differs" in refusal(ros.write(tmp_path / "k", [*desk(ros), other]))
    raw = [(t.replace("aligned_depth_to_color", "depth"), ns, m) for t, ns, m in half if t == DEPTH]
    assert RosbagScene(ros.write(tmp_path / "both", [*raw, *desk(ros)])).topics.depth == DEPTH
    same = (DEPTH_INFO, START_NS, ros.info(d=[0.0] * 5))
    assert RosbagScene(ros.write(tmp_path / "same", [*desk(ros), same])).image_ids


@pytest.mark.parametrize("name", BAGS)
def test_a_camera_that_changes_during_the_bag_is_refused_with_the_time(name: str, tmp_path: Path) -> None:
    def changing(named: str, **fields: Any) -> Path:
        ros, messages = Ros(name), desk(Ros(name), BARREL)
        for place, (topic, log_ns, _) in enumerate(messages):
            if topic == INFO and log_ns >= stamps_ns(2)[0]:
                info = ros.info(fields.get("camera", CAMERA), fields.get("d", BARREL))
                info.header = ros.header(log_ns)
                messages[place] = topic, log_ns, info
        return ros.write(tmp_path / f"{named}_{name}", messages)

    assert RosbagScene(changing("same")).image_ids == (0, 1, 2)
    focused = changing("focus", camera=Camera(40.1, 41.0, 15.5, 11.0, WIDTH, HEIGHT))
    assert RosbagScene(focused).frame(2).camera == CAMERA, "a tenth of a pixel is no change"
    zoomed = changing("zoom", camera=Camera(60.0, 61.5, 15.5, 11.0, WIDTH, HEIGHT))
    told = f"{INFO}: found another K 0.07 s after its first message (stamp 1700000000.189); expected one"
    assert told in refusal(zoomed)
    assert "found another D 0.07 s" in refusal(changing("lens", d=[-0.1, 0.05, 0.001, -0.002, 0.0]))
    larger = changing("size", camera=Camera(40.0, 41.0, 15.5, 11.0, 2 * WIDTH, 2 * HEIGHT))
    assert f"found another size ({2 * WIDTH} x {2 * HEIGHT}) 0.07 s" in refusal(larger)


def test_the_error_says_what_cannot_be_used(tmp_path: Path) -> None:
    ros = Ros("a")
    mono = desk(ros, color=lambda n, ns: ros.image(COLORS[n, ..., 0].copy(), "mono8", ns))
    assert "'mono8'; expected rgb8, bgr8" in refusal(ros.write(tmp_path / "mono", mono))
    none = [message for message in desk(ros) if message[0] != INFO]
    said = refusal(ros.write(tmp_path / "none", none))
    assert f"no CameraInfo {INFO}" in said
    assert said.endswith("Record the camera_info of the colour camera.")
    others = [(f"/{k}/camera_info", START_NS, ros.info()) for k in "ab"]
    path = ros.write(tmp_path / "others", [*none, *others])
    assert "Name another: camera.info_topic, or record" in refusal(path)
    assert "camera.info_topic" not in refusal(path, None), "not mentioned where a topic cannot be named"
    flat = [(t, ns, m) for t, ns, m in desk(ros) if t != DEPTH]
    assert f"no depth images, but {COLOR} (rgb8)" in refusal(ros.write(tmp_path / "flat", flat))
    unset = desk(ros, color=lambda n, ns: ros.image(COLORS[n], "rgb8", 0))
    assert "without a timestamp" in refusal(ros.write(tmp_path / "unset", unset))
    late = desk(ros, depth=lambda n, ns: ros.image(DEPTHS_MM[n], "16UC1", ns + 10**9))
    assert "no depth of" in refusal(ros.write(tmp_path / "late", late))
    binned = desk(ros)
    for _, _, message in binned:
        if hasattr(message, "binning_x"):
            message.width, message.height, message.binning_x, message.binning_y = WIDTH * 2, HEIGHT * 2, 2, 2
    said = refusal(ros.write(tmp_path / "binned", binned))
    assert f"a camera of {WIDTH * 2} x {HEIGHT * 2} with binning 2 x 2, which is not supported;" in said
    fisheye = [*desk(ros, [0.1] * 4)]
    for _, _, message in fisheye:
        if hasattr(message, "distortion_model"):
            message.distortion_model = "equidistant"
    assert "distortion_model 'equidistant'" in refusal(ros.write(tmp_path / "fisheye", fisheye))


@pytest.mark.parametrize("name", BAGS)
def test_a_broken_bag_is_one_paragraph_and_exit_code_2(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ros = Ros(name)
    path = ros.write(tmp_path / name, desk(ros))
    file = path if path.is_file() else next(one for one in path.iterdir() if one.suffix != ".yaml")
    whole = file.read_bytes()
    pipeline = tmp_path / "pipeline.yaml"
    pipeline.write_text(
        f"camera: {{source: rosbag, path: {name}, rate: recorded}}\nworkers: [camera]\nbundles: b\n"
    )
    assert open_source(load(pipeline)).image_ids == (0, 1, 2)
    given = ["onboard", "--from-video", str(path), "--click", "1", "2", "--name", "a", "--out", str(tmp_path)]
    for size in (len(whole) // 3, 20, 0):
        file.write_bytes(whole[:size])
        assert main(given) == 2
        assert main(["up", str(pipeline)]) == 2
        said = capsys.readouterr().err.splitlines()
        assert len(said) == 2, said
        assert all(str(path) in line for line in said), said
    pipeline.write_text(pipeline.read_text().replace(name, "gone.bag"))
    assert main(["up", str(pipeline)]) == 2
    assert "gone.bag: found no such file" in capsys.readouterr().err


def test_the_error_for_a_video_says_what_to_record_instead(tmp_path: Path) -> None:
    (tmp_path / "turned.mp4").write_bytes(b"\0\0\0\x20ftypisom")
    assert "A video has no depth" in refusal(tmp_path / "turned.mp4")


def test_a_huepose_recording_is_not_taken_for_a_bag(tmp_path: Path) -> None:
    from mcap.writer import Writer

    with (tmp_path / "run.mcap").open("wb") as file:
        recording = Writer(file)
        recording.start()
        recording.finish()
    with pytest.raises(InputError, match=r"of another program than ROS; .* played with `source: recording`"):
        RosbagScene(tmp_path / "run.mcap")
