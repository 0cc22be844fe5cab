"""From meshes to reference models, once per object and without training."""

from huepose.onboarding.meshes import read_mesh
from huepose.onboarding.onboard import onboard_mesh

__all__ = ["onboard_mesh", "read_mesh"]
