"""Key expressions: `huepose/SITE/CAMERA/...`. A site and a camera are names of `[a-z0-9_-]{1,64}`."""

from __future__ import annotations

from dataclasses import dataclass

from huepose_protos.errors import WireError
from huepose_protos.fields import is_name

ROOT = "huepose"


@dataclass(frozen=True)
class Keys:
    """The keys of one camera. `*` as site or camera makes them expressions that match any.

    >>> Keys("lab", "cam0").pose("mustard", 1)
    'huepose/lab/cam0/pose/mustard/1'
    """

    site: str
    camera: str

    def __post_init__(self) -> None:
        for name in (self.site, self.camera):
            if name != "*" and not is_name(name):
                raise WireError(f"site or camera {name!r} is not a name of a-z, 0-9, _ and -")

    def _key(self, tail: str) -> str:
        return f"{ROOT}/{self.site}/{self.camera}/{tail}"

    def of_tail(self, tail: str) -> str:
        """The key that ends so: what `tail_of` gives, back under this site and camera."""
        return self._key(tail)

    @property
    def frame(self) -> str:
        """Frames with pixels: FrameHeader."""
        return self._key("frame")

    @property
    def camera_info(self) -> str:
        """CameraMessage: the camera's intrinsics and clock, for readers that take no frames."""
        return self._key("camera")

    @property
    def mount(self) -> str:
        """MountMessage: where a camera that moves is, told from outside of the pipeline."""
        return self._key("mount")

    @property
    def request(self) -> str:
        """PerceptionRequest."""
        return self._key("perception/request")

    @property
    def look(self) -> str:
        """Requests with the pixels to look at, where the detector runs on another computer."""
        return self._key("perception/look")

    @property
    def detections(self) -> str:
        """Detections with the pixels that they were found in."""
        return self._key("perception/detections")

    @property
    def masks(self) -> str:
        """Masks with the pixels that they were found in."""
        return self._key("perception/masks")

    @property
    def estimates(self) -> str:
        """Estimates."""
        return self._key("perception/estimates")

    @property
    def correction(self) -> str:
        """CorrectionMessage."""
        return self._key("correction")

    @property
    def objects(self) -> str:
        """ObjectsMessage."""
        return self._key("objects")

    @property
    def control(self) -> str:
        """Queryable on loopback: ControlRequest, answered by ControlReply."""
        return self._key("control")

    @property
    def truth(self) -> str:
        """TruthMessage, from sources that know it and are told to say it."""
        return self._key("truth")

    @property
    def poses(self) -> str:
        """All poses."""
        return self._key("pose/**")

    def pose(self, object_name: str, instance: int) -> str:
        """PoseMessage of one instance of an object."""
        return self._key(f"pose/{object_name}/{instance}")

    @property
    def intake(self) -> str:
        """IntakeMessage, while somebody listens."""
        return self._key("tracker/intake")

    @property
    def memory(self) -> str:
        """MemoryMessage, now and then while somebody listens to the intake."""
        return self._key("tracker/memory")

    @property
    def again(self) -> str:
        """Queryable of the tracker: AgainRequest, answered by the frames and the IntakeMessages."""
        return self._key("tracker/again")

    def health(self, worker: str = "*") -> str:
        """HealthMessage of a worker."""
        return self._key(f"health/{worker}")

    def live(self, worker: str = "*") -> str:
        """Liveliness token of a worker: there while the worker is."""
        return self._key(f"live/{worker}")

    @property
    def remote(self) -> str:
        """All that the gateway shows to other machines; each of these can be asked for, too."""
        return self._key("remote/**")

    def outside(self, key: str) -> str:
        """The name under which the gateway shows one of the keys above.

        >>> Keys("lab", "cam0").outside("huepose/lab/cam0/objects")
        'huepose/lab/cam0/remote/objects'
        """
        return self._key("remote/" + tail_of(key))

    def up(self, key: str) -> str:
        """The name of one of the keys above on its way to the other computer of the pipeline."""
        return self._key("up/" + tail_of(key))

    def down(self, key: str) -> str:
        """The same on its way back."""
        return self._key("down/" + tail_of(key))


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


def last(key: str) -> str:
    """The last chunk of a key: the worker of a health or live key, the instance of a pose."""
    return key.rsplit("/", 1)[-1]
