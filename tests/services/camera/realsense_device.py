"""The SDK's software device as a camera of 64 x 48 pixels: colour 30 mm right of depth."""

import numpy as np

WIDTH, HEIGHT, FOCAL = 64, 48, 60.0
BASELINE_M = 0.03
DEPTH_M = 0.6


def intrinsics(rs, coefficients=None):
    i = rs.intrinsics()
    i.width, i.height, i.fx, i.fy, i.ppx, i.ppy = WIDTH, HEIGHT, FOCAL, FOCAL, 31.5, 23.5
    i.model = rs.distortion.none if coefficients is None else rs.distortion.inverse_brown_conrady
    i.coeffs = coefficients or [0.0] * 5
    return i


class SoftwareCamera:
    """A device that gives the images that a test pushes."""

    def __init__(self, rs, coefficients=None, record_to=None):
        self.rs = rs
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.name, "Software")
        self.device.register_info(rs.camera_info.serial_number, "0001")
        self._depth = self.device.add_sensor("Depth")
        self._color = self.device.add_sensor("Color")
        depth = self._stream(rs.stream.depth, 0, 2, rs.format.z16, None)
        color = self._stream(rs.stream.color, 1, 3, rs.format.rgb8, coefficients)
        self._depth_profile = self._depth.add_video_stream(depth)
        self._color_profile = self._color.add_video_stream(color)
        extrinsics = rs.extrinsics()
        extrinsics.rotation, extrinsics.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [-BASELINE_M, 0.0, 0.0]
        self._depth_profile.register_extrinsics_to(self._color_profile, extrinsics)
        self._depth.add_read_only_option(rs.option.depth_units, 0.001)
        self.device.create_matcher(rs.matchers.default)
        self.recorder = rs.recorder(record_to, self.device) if record_to else None

    def _stream(self, kind, uid, bytes_per_pixel, layout, coefficients):
        stream = self.rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fps = kind, 0, uid, 30
        stream.width, stream.height, stream.bpp, stream.fmt = WIDTH, HEIGHT, bytes_per_pixel, layout
        stream.intrinsics = intrinsics(self.rs, coefficients)
        return stream

    def push_color(self, number, image):
        self._push(self._color, self._color_profile, 3, number, image)

    def push_depth(self, number, depth_mm):
        self._push(self._depth, self._depth_profile, 2, number, depth_mm)

    def _push(self, sensor, profile, bytes_per_pixel, number, pixels):
        frame = self.rs.software_video_frame()
        frame.pixels, frame.stride, frame.bpp = pixels, WIDTH * bytes_per_pixel, bytes_per_pixel
        frame.timestamp, frame.domain = 1000.0 + number * 1000 / 30, self.rs.timestamp_domain.hardware_clock
        frame.frame_number, frame.profile = number, profile.as_video_stream_profile()
        # Without the rate the SDK's syncer does not know for how long to wait for the other image.
        sensor.set_metadata(self.rs.frame_metadata_value.actual_fps, 30_000)
        sensor.on_video_frame(frame)

    def push(self, number):
        """A wall at 0.6 m with a step to 0.3 m; the colour encodes the number."""
        self.push_depth(number, depth_of(number))
        self.push_color(number, np.full((HEIGHT, WIDTH, 3), (number, 2 * number, 3 * number), np.uint8))


def depth_of(number):
    depth = np.full((HEIGHT, WIDTH), 1000 * DEPTH_M, np.uint16)
    depth[10:20, 20:30] = 300
    return depth
