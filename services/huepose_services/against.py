"""What perception says against a camera, and against single instances in its pictures."""

from __future__ import annotations

import msgspec

from huepose.tracking.types import TrackedPose
from huepose_protos.messages import CorrectionMessage


class Against(msgspec.Struct, array_like=True):
    """Sentences, empty where there is nothing to say; of one epoch of the camera, the newest."""

    epoch: int = 0
    camera: str = ""
    instances: dict[str, str] = {}

    def hear(self, message: CorrectionMessage) -> None:
        """What a correction says is so until another one says otherwise."""
        if message.camera_epoch != self.epoch:
            self.epoch, self.instances = message.camera_epoch, {}
        self.camera = message.camera
        self.instances[f"{message.object}/{message.instance}"] = message.reason

    def every_pose(self, epoch: int) -> str:
        """What is said against every pose in a picture of that epoch."""
        return self.camera if epoch == self.epoch else ""

    def pose(self, pose: TrackedPose, epoch: int) -> str:
        """What is said against one in particular; nothing of one that is lost."""
        if epoch != self.epoch or pose.T_cam_obj is None:
            return ""
        return self.instances.get(f"{pose.object}/{pose.instance}", "")
