"""From meshes to reference models, once per object and without training. Where to look:

mesh files  meshes (`read_mesh`), by obj, ply, gltf; kinds (what is no mesh), mesh_files (bounds), raw_mesh,
            polygons (into triangles), winding; texture, patches (one texture for one mesh),
            seams (is it upside down?)
a model     onboard > reference: simplify, visibility, cloud with neighbourhoods, surface, pairs,
            near_symmetries, symmetries, declared
many        batch, bop_folder
recordings  from_video
"""

from huepose.onboarding.meshes import read_mesh
from huepose.onboarding.onboard import onboard_mesh

__all__ = ["onboard_mesh", "read_mesh"]
