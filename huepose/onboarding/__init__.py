"""From meshes to reference models, once per object and without training. Where to look:

mesh files  meshes (`read_mesh`), by obj, ply, gltf (of a gltf_asset); kinds (refuses others), mesh_files
            (limits), raw_mesh, polygons (to triangles), winding; texture, patches (one texture for a mesh),
            seams (finds a texture that is upside down)
a model     onboard > reference: simplify, visibility, cloud with neighbourhoods, surface, pairs,
            near_symmetries, symmetries, declared
many        batch, bop_folder
recordings  from_video
"""

from huepose.onboarding.meshes import read_mesh
from huepose.onboarding.onboard import onboard_mesh

__all__ = ["onboard_mesh", "read_mesh"]
