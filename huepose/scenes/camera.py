"""The camera of the rendered scenes: intrinsics, frame rate, and the parameters of its sensors (see
`sensor`)."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.geometry.camera import Camera

CAMERA = Camera(614.2, 614.6, 321.3, 240.7, 640, 480)  # as a D435 colour stream
RATE_HZ = 30.0


@dataclass(frozen=True)
class ColorSensor:
    """full_well: electrons at white; read_noise: RMS, as a fraction of white; blur_px: sigma of the lens."""

    full_well: float = 6000.0
    read_noise: float = 0.0025
    blur_px: float = 0.45


@dataclass(frozen=True)
class StereoSensor:
    """subpixel: RMS of the disparity noise in px; window_px: side of the matching window. The others are
    shares of pixels. holes: without depth on a surface at 1 m; edge_holes: without depth along depth edges;
    flying: between the two surfaces along depth edges."""

    baseline_m: float = 0.05
    subpixel: float = 0.08
    window_px: int = 7
    holes: float = 0.012
    edge_holes: float = 0.12
    flying: float = 0.05

    def rms_m(self, depth_m: float, camera: Camera) -> float:
        """RMS of the depth noise at `depth_m` on a smooth surface."""
        return depth_m**2 * self.subpixel / (camera.fx * self.baseline_m)


COLOR, STEREO = ColorSensor(), StereoSensor()
