"""Key expressions: `huepose/SITE/CAMERA/...`. A site and a camera are names of `[a-z0-9_-]{1,64}`."""

from __future__ import annotations

from dataclasses import dataclass

from huepose_protos.fields import WireError, is_name

ROOT = "huepose"


class _Key:
    """A key with a fixed end."""

    def __init__(self, tail: str) -> None:
        self._tail = tail

    def __get__(self, keys: Keys, owner: type[Keys]) -> str:
        return keys.of_tail(self._tail)


@dataclass(frozen=True)
class Keys:
    """The keys of one camera. With `*` as site or camera they are expressions that match any.

    >>> Keys("lab", "cam0").pose("mustard", 1)
    'huepose/lab/cam0/pose/mustard/1'
    """

    site: str
    camera: str

    def __post_init__(self) -> None:
        for name in (self.site, self.camera):
            if name != "*" and not is_name(name):
                raise WireError(f"site or camera {name!r} is not a name of a-z, 0-9, _ and -")

    frame = _Key("frame")
    """Frames with pixels: FrameHeader."""
    camera_info = _Key("camera")
    """CameraMessage: the camera's intrinsics, clock and mount, for readers without frames."""
    mount = _Key("mount")
    """MountMessage: the pose of a moving camera, from a program outside the pipeline."""
    request = _Key("perception/request")
    """PerceptionRequest."""
    look = _Key("perception/look")
    """Look: requests with their pixels, if the detector runs on another computer."""
    detections = _Key("perception/detections")
    """Detections with the pixels that they were found in."""
    masks = _Key("perception/masks")
    """Masks with the pixels that they were found in."""
    estimates = _Key("perception/estimates")
    """Estimates."""
    correction = _Key("correction")
    """CorrectionMessage."""
    objects = _Key("objects")
    """ObjectsMessage."""
    control = _Key("control")
    """Queryable on the pipeline's own machine: ControlRequest, answered by ControlReply."""
    truth = _Key("truth")
    """TruthMessage, if the source knows the truth and `camera.truth` is set."""
    poses = _Key("pose/**")
    """All poses."""
    hypotheses = _Key("tracker/hypotheses")
    """HypothesesMessage, while somebody listens."""
    intake = _Key("tracker/intake")
    """IntakeMessage, while somebody listens."""
    memory = _Key("tracker/memory")
    """MemoryMessage, every few seconds while somebody listens to the intake."""
    again = _Key("tracker/again")
    """Queryable of the tracker: AgainRequest, answered by the frames and the IntakeMessages."""
    remote = _Key("remote/**")
    """All that the gateway shows to other machines; each of these can be queried, too."""

    def of_tail(self, tail: str) -> str:
        """The key with this end, as `tail_of` gives it, under this site and camera."""
        return f"{ROOT}/{self.site}/{self.camera}/{tail}"

    def pose(self, object_name: str, instance: int) -> str:
        """PoseMessage of one instance of an object."""
        return self.of_tail(f"pose/{object_name}/{instance}")

    def health(self, worker: str = "*") -> str:
        """HealthMessage of a worker."""
        return self.of_tail(f"health/{worker}")

    def live(self, worker: str = "*") -> str:
        """Liveliness token of a worker: there while the worker runs."""
        return self.of_tail(f"live/{worker}")

    def outside(self, key: str) -> str:
        """The key under which the gateway shows one of the keys above.

        >>> Keys("lab", "cam0").outside("huepose/lab/cam0/objects")
        'huepose/lab/cam0/remote/objects'
        """
        return self.of_tail("remote/" + tail_of(key))

    def up(self, key: str) -> str:
        """The key for messages of one of the keys above on their way to the pipeline's other computer."""
        return self.of_tail("up/" + tail_of(key))

    def down(self, key: str) -> str:
        """The same on the way back."""
        return self.of_tail("down/" + tail_of(key))


def tail_of(key: str) -> str:
    """What comes after huepose/SITE/CAMERA/, without the `remote/` of the gateway.

    >>> tail_of("huepose/lab/cam0/remote/pose/mustard/1")
    'pose/mustard/1'
    """
    return "/".join(key.split("/")[3:]).removeprefix("remote/")


def camera_of(key: str) -> str:
    """The name of the camera that a key is about.

    >>> camera_of("huepose/lab/cam0/pose/mustard/1")
    'cam0'
    """
    return key.split("/")[2]


def site_and_camera_of(key: str) -> str:
    """Which camera of which site a key is about.

    >>> site_and_camera_of("huepose/lab/cam0/remote/pose/mustard/1")
    'lab/cam0'
    """
    return "/".join(key.split("/")[1:3])


def last(key: str) -> str:
    """The last chunk of a key: the worker of a health or live key, the instance of a pose."""
    return key.rsplit("/", 1)[-1]
