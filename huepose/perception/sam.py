"""A segmenter of the SAM family with a box as its prompt: NanoSAM and MobileSAM, exported to ONNX.

The encoder runs once per image, the decoder once per box. The image is scaled so that its longer side is
1024; the rest is filled with zeros *after* normalising, so with the mean colour, not black. The box is
given as two points in those pixels, labelled 2 (upper left) and 3 (lower right); the network itself adds
half a pixel to them. The mask of 256 x 256 covers the square of 1024: the part with the image is cut out
and resized to the image.
"""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, UInt8
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.perception.sessions import Network, Tensor

SIDE = 1024
_MEAN = np.array([123.675, 116.28, 103.53], np.float32)
_DEVIATION = np.array([58.395, 57.12, 57.375], np.float32)
_UPPER_LEFT, _LOWER_RIGHT = 2.0, 3.0
_DECODER_INPUTS = {"image_embeddings", "point_coords", "point_labels", "mask_input", "has_mask_input"}
_DECODER_OUTPUTS = {"iou_predictions", "low_res_masks"}
_LOW = 256


class SamSegmenter:
    """Segments what a box holds, by colour alone. Keeps the embedding of the last image.

    Raises InputError if the networks are not an encoder and a decoder of this kind."""

    def __init__(self, encoder: Network, decoder: Network) -> None:
        _check(encoder, decoder)
        self._encoder, self._decoder = encoder, decoder
        self._frame: RgbdFrame | None = None
        self._embedding: Float32 | None = None

    def segment(self, frame: RgbdFrame, box: Box, diameter_m: float) -> list[Bool]:
        """One mask (H, W); empty if the network finds nothing in the box. The diameter is not used."""
        height, width = frame.color.shape[:2]
        box = box.clipped(width, height)
        if box.area <= 0.0:
            return [np.zeros((height, width), bool)]
        if self._embedding is None or frame is not self._frame:
            encoder = self._encoder
            embedded = encoder.run({encoder.inputs[0].name: tensor_of(frame.color)})
            self._embedding, self._frame = embedded[encoder.outputs[0].name], frame
        outputs = self._decoder.run(
            {
                "image_embeddings": self._embedding,
                "point_coords": points_of(box, (height, width)),
                "point_labels": np.array([[_UPPER_LEFT, _LOWER_RIGHT]], np.float32),
                "mask_input": np.zeros((1, 1, _LOW, _LOW), np.float32),
                "has_mask_input": np.zeros(1, np.float32),
            }
        )
        best = int(outputs["iou_predictions"].reshape(-1).argmax())
        masks = outputs["low_res_masks"].reshape(-1, _LOW, _LOW).astype(np.float32, copy=False)
        return [mask_of(masks[best], (height, width))]

    def warm_up(self) -> None:
        """Run both networks once. Raises InputError if they cannot be run one after the other."""
        image, depth = np.zeros((_LOW, _LOW, 3), np.uint8), np.zeros((_LOW, _LOW), np.float32)
        frame = RgbdFrame(image, depth, Camera(_LOW, _LOW, _LOW / 2, _LOW / 2, _LOW, _LOW))
        self.segment(frame, Box(0, 0, _LOW, _LOW), 0.1)
        self._frame = self._embedding = None


def tensor_of(color: UInt8) -> Float32:
    """The encoder's input (1, 3, 1024, 1024) for an image (H, W, 3) RGB."""
    height, width = _scaled_size(color.shape[:2])
    resized = cv2.resize(color, (width, height), interpolation=cv2.INTER_LINEAR)
    out = np.zeros((1, 3, SIDE, SIDE), np.float32)
    # A table of the 256 values of a channel is several times faster than arithmetic on every pixel.
    table = (np.arange(256, dtype=np.float32)[:, None] - _MEAN) / _DEVIATION
    for channel in range(3):
        out[0, channel, :height, :width] = table[:, channel][resized[..., channel]]
    return out


def points_of(box: Box, image_size: tuple[int, ...]) -> Float32:
    """The prompt (1, 2, 2) for a box in an image of (height, width): its corners in pixels of the
    square."""
    scale = SIDE / max(image_size)
    return np.array([[[box.x, box.y], [box.x1, box.y1]]], np.float32) * np.float32(scale)


def mask_of(low: Float32, image_size: tuple[int, int]) -> Bool:
    """The mask (H, W) from the logits (256, 256) of the square."""
    height, width = image_size
    scale = _LOW / max(height, width)
    # In both images a pixel's centre is half a pixel from its corner.
    to_low = np.array([[scale, 0.0, 0.5 * scale - 0.5], [0.0, scale, 0.5 * scale - 0.5]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    logits = cv2.warpAffine(low, to_low, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(logits > 0.0)


def _scaled_size(image_size: tuple[int, ...]) -> tuple[int, int]:
    """Height and width with the longer side 1024, the other rounded down to whole pixels."""
    height, width = image_size[0], image_size[1]
    scale = SIDE / max(height, width)
    return (SIDE, int(width * scale)) if height >= width else (int(height * scale), SIDE)


def _check(encoder: Network, decoder: Network) -> None:
    """Raises InputError if the interface is another one."""
    image, embedding = (1, 3, SIDE, SIDE), (1, 256, 64, 64)
    one = len(encoder.inputs) == 1 and len(encoder.outputs) == 1
    if not (one and _fits(encoder.inputs[0], image) and _fits(encoder.outputs[0], embedding)):
        raise encoder.refused(
            f"one input 1 x 3 x {SIDE} x {SIDE}, one output 1 x 256 x 64 x 64",
            "Export the image encoder of NanoSAM or MobileSAM.",
        )
    inputs, outputs = {t.name for t in decoder.inputs}, {t.name for t in decoder.outputs}
    if inputs != _DECODER_INPUTS or not outputs >= _DECODER_OUTPUTS:
        raise decoder.refused(
            f"inputs {', '.join(sorted(_DECODER_INPUTS))}, outputs {', '.join(sorted(_DECODER_OUTPUTS))}",
            "Export it with nanosam.tools.export_sam_mask_decoder_onnx.",
        )


def _fits(tensor: Tensor, shape: tuple[int, ...]) -> bool:
    """Whether a tensor can have that shape."""
    sizes = zip(tensor.shape, shape, strict=False)
    return len(tensor.shape) == len(shape) and all(isinstance(a, str) or a == b for a, b in sizes)
