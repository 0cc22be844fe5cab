"""The worker `ros2`: poses for programs of ROS 2, without an installation of ROS on this machine."""

from huepose_services.ros2.work import make

__all__ = ["make"]
