"""Networks in ONNX files that the user gives, run by ONNX Runtime.

A file is checked when it is opened, not at the hundredth frame: its digest, and that it is a network. The
classes that use it check its inputs and outputs at the start. ONNX Runtime silently falls back to the CPU
if a provider cannot be started, so the provider that it really uses is read from the session (`provider`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from huepose.support.errors import InputError
from huepose.support.files import writing

PROVIDERS = {
    "tensorrt": "TensorrtExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "cpu": "CPUExecutionProvider",
}
_BLOCK = 1 << 20
_TYPES: dict[str, Any] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}


@dataclass(frozen=True)
class NetworkSettings:
    """How networks are run. providers: keys of PROVIDERS, preferred ones first; threads: of the CPU; fp16:
    half precision with TensorRT; cache: folder for the engines that TensorRT builds."""

    providers: tuple[str, ...] = ("tensorrt", "cuda", "openvino", "cpu")
    threads: int = 1
    fp16: bool = True
    cache: Path | None = None


@dataclass(frozen=True)
class Tensor:
    """An input or output. Each size is an int, or the name of a free size."""

    name: str
    shape: tuple[int | str, ...]
    kind: str

    @property
    def fixed(self) -> bool:
        """Whether all sizes are known."""
        return all(isinstance(size, int) for size in self.shape)

    def __str__(self) -> str:
        return (
            f"{self.name} {self.kind.removeprefix('tensor(').rstrip(')')} {' x '.join(map(str, self.shape))}"
        )


class Network:
    """An opened network. Not thread-safe: buffers of inputs of fixed size are reused."""

    def __init__(self, session: Any, path: Path) -> None:
        self._session, self.path = session, path
        self.inputs = tuple(Tensor(i.name, tuple(i.shape), i.type) for i in session.get_inputs())
        self.outputs = tuple(Tensor(o.name, tuple(o.shape), o.type) for o in session.get_outputs())
        self.metadata: Mapping[str, str] = dict(session.get_modelmeta().custom_metadata_map)
        names = {name: key for key, name in PROVIDERS.items()}
        self.provider = names.get(session.get_providers()[0], session.get_providers()[0])
        self._binding: Any = None
        self._works = False
        self._buffers: dict[str, np.ndarray] = {}
        if all(tensor.fixed and tensor.kind in _TYPES for tensor in self.inputs):
            self._bind()

    def _bind(self) -> None:
        """Give inputs of fixed size a buffer that is used again, so that a run copies once."""
        import onnxruntime as ort

        self._binding = self._session.io_binding()
        for tensor in self.inputs:
            buffer = np.zeros([int(size) for size in tensor.shape], _TYPES[tensor.kind])
            self._buffers[tensor.name] = buffer
            # The value shares the array's memory: the network reads what is written to the array.
            self._binding.bind_ortvalue_input(tensor.name, ort.OrtValue.ortvalue_from_numpy(buffer))
        for tensor in self.outputs:
            self._binding.bind_output(tensor.name)

    def run(self, feeds: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The outputs by name; inputs are converted to the network's precision. Raises InputError if the name
        or shape of an input is not the network's, or if the network cannot be run with the first ones. Later
        errors are not of the file, but of the processor, such as a lack of its memory."""
        if feeds.keys() != {tensor.name for tensor in self.inputs}:
            raise InputError(
                f"{self.path}: inputs", found=", ".join(feeds), expected=self.described(self.inputs)
            )
        for name, buffer in self._buffers.items():
            if feeds[name].shape != buffer.shape:
                found = " x ".join(map(str, feeds[name].shape))
                raise InputError(f"{self.path}: {name}", found=found, expected=f"{buffer.shape}")
        try:
            values = self._answer(feeds)
        except Exception as error:  # ONNX Runtime raises a dozen kinds, which have no base class of their own
            if self._works:
                raise
            given = ", ".join(f"{name} {' x '.join(map(str, feed.shape))}" for name, feed in feeds.items())
            raise InputError(
                self.path,
                found=" ".join(str(error).split())[:300],
                expected=f"a network that can be run with {given}",
                fix="" if self._buffers else "Export it again, with inputs of these sizes.",
            ) from None
        self._works = True
        return {tensor.name: value for tensor, value in zip(self.outputs, values, strict=True)}

    def _answer(self, feeds: Mapping[str, np.ndarray]) -> Sequence[np.ndarray]:
        """The outputs in their order."""
        if self._binding is None:
            kinds = {tensor.name: _TYPES.get(tensor.kind) for tensor in self.inputs}
            given = {name: np.asarray(feed, kinds[name]) for name, feed in feeds.items()}
            return cast("Sequence[np.ndarray]", self._session.run(None, given))
        for name, buffer in self._buffers.items():
            np.copyto(buffer, feeds[name], casting="same_kind")
        self._session.run_with_iobinding(self._binding)
        return cast("Sequence[np.ndarray]", self._binding.copy_outputs_to_cpu())

    @staticmethod
    def described(tensors: Sequence[Tensor]) -> str:
        """Names, types and sizes, for errors."""
        return "; ".join(map(str, tensors)) or "none"

    def refused(self, expected: str, fix: str = "") -> InputError:
        """The error for a network of another kind than needed."""
        found = f"inputs {self.described(self.inputs)}, outputs {self.described(self.outputs)}"
        return InputError(self.path, found=found, expected=expected, fix=fix)


def open_network(
    path: Path, settings: NetworkSettings | None = None, *, sha256: str | None = None, half: bool = True
) -> Network:
    """Open the network in a file. half: whether it may run in half precision.

    Raises InputError if there is no such file, its digest differs, it is not a network, or none of the
    providers can be started."""
    import onnxruntime as ort

    settings = settings or NetworkSettings()
    check_file(path, sha256)
    wanted = providers_here(settings)
    options = ort.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = settings.threads, 1
    # By default, waiting threads spin and take CPU time from the other workers.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    providers = [(PROVIDERS[key], _options(key, settings, half)) for key in wanted]
    try:
        session = ort.InferenceSession(str(path), options, providers=providers)
    except Exception as error:  # ONNX Runtime raises a dozen kinds, which have no base class of their own
        raise InputError(
            path,
            found=" ".join(str(error).split())[:300],
            expected="a network in the ONNX format that this ONNX Runtime can run",
            fix="Fetch or export it again.",
        ) from None
    network = Network(session, path)
    if network.provider not in settings.providers:
        have = ort.get_available_providers()
        raise _no_provider(settings, [*have, f"of which {', '.join(wanted)} could not be started"])
    return network


def providers_here(settings: NetworkSettings) -> list[str]:
    """Those of the providers that this ONNX Runtime contains; starting one may still fail. Raises
    InputError if it contains none of them."""
    import onnxruntime as ort

    have = ort.get_available_providers()
    wanted = [key for key in settings.providers if PROVIDERS[key] in have]
    if not wanted:
        raise _no_provider(settings, have)
    return wanted


def _no_provider(settings: NetworkSettings, have: Sequence[str]) -> InputError:
    return InputError(
        "execution providers of ONNX Runtime",
        found=", ".join(have),
        expected=f"one of {', '.join(settings.providers)}",
        fix="Add cpu to networks.providers, or install the onnxruntime that has them; see huepose doctor.",
    )


def _options(key: str, settings: NetworkSettings, half: bool) -> dict[str, str]:
    """The options of a provider."""
    if key != "tensorrt":
        return {}
    options = {"trt_fp16_enable": "1" if settings.fp16 and half else "0"}
    if settings.cache is not None:
        with writing(settings.cache, "a folder that can be written", "Set networks.cache to one."):
            settings.cache.mkdir(parents=True, exist_ok=True)
        options |= {"trt_engine_cache_enable": "1", "trt_engine_cache_path": str(settings.cache)}
    return options


def check_file(path: Path, sha256: str | None = None) -> None:
    """Raises InputError if there is no such file, or its digest is not the given one."""
    if not path.is_file():
        raise InputError(
            path, found="no file", expected="a network", fix="`huepose models list` says what there is."
        )
    if sha256 is not None and (found := digest(path)) != sha256:
        raise InputError(
            path,
            found=f"SHA-256 {found}",
            expected=sha256,
            fix="It is damaged or another one: fetch it again, or correct the digest.",
        )


def digest(path: Path) -> str:
    """SHA-256 of a file, in 64 hexadecimal digits."""
    sum_ = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            sum_.update(block)
    return sum_.hexdigest()
