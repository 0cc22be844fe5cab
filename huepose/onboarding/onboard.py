"""Makes the reference model of a mesh. Meshes of more than 60,000 triangles are simplified first."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from huepose.geometry.arrays import Float64
from huepose.geometry.mesh import Mesh
from huepose.model.io import check_name
from huepose.model.types import ReferenceModel
from huepose.onboarding.reference import Report, reference_model, silent
from huepose.onboarding.simplify import simplified


def onboard_mesh(
    mesh: Mesh,
    name: str,
    *,
    object_id: int | None = None,
    info: Mapping[str, Any] | None = None,
    symmetric: Mapping[str, Any] | str | None = None,
    frame_offset_m: Float64 | None = None,
    paper: bool = False,
    report: Report = silent,
) -> ReferenceModel:
    """Reference model of a mesh, which is simplified if it is large; arguments as of `reference_model`.

    Raises InputError for a mesh or symmetries that cannot be used, ModuleNotFoundError for a large mesh if
    the extra `onboard` is not installed.
    """
    check_name(name)
    return reference_model(
        mesh,
        name,
        lean=simplified(mesh),
        object_id=object_id,
        info=info,
        symmetric=symmetric,
        frame_offset_m=frame_offset_m,
        paper=paper,
        report=report,
    )
