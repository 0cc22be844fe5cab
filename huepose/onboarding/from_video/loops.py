"""Loop closure: recognise views that were passed before, and spread the error with Open3D's pose graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.onboarding.from_video.views import View

SIGMA_M = 0.0015
"""Error of a registration of two views, at the object's rim; the same for all, so that only outliers of
several times as much are told apart by it."""


class Edge(NamedTuple):
    """T_b_a (4, 4): camera axes of view a to those of view b, as registered; loop: it closes a turn."""

    a: int
    b: int
    T_b_a: Float64
    loop: bool


def relaxed(views: Sequence[View], edges: Sequence[Edge], radius_m: float) -> list[View]:
    """Views at the optimised poses; loop edges that contradict the others are dropped."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    # About the object's centre and not the camera's, so that turns and shifts have one unit.
    T_cam_centre = [se3.make(np.eye(3), view.T_cam_obj[:3, 3]) for view in views]
    graph = registration.PoseGraph()
    for view, T in zip(views, T_cam_centre, strict=True):
        graph.nodes.append(registration.PoseGraphNode(se3.inverse(view.T_cam_obj) @ T))
    information = np.diag([radius_m**2] * 3 + [1.0] * 3) / SIGMA_M**2
    for edge in edges:
        T = se3.inverse(T_cam_centre[edge.b]) @ edge.T_b_a @ T_cam_centre[edge.a]
        graph.edges.append(registration.PoseGraphEdge(edge.a, edge.b, T, information, uncertain=edge.loop))
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        registration.GlobalOptimizationOption(
            max_correspondence_distance=5 * SIGMA_M, edge_prune_threshold=0.25, reference_node=0
        ),
    )
    return [
        view.at(se3.orthonormalised(T @ se3.inverse(node.pose)))
        for view, T, node in zip(views, T_cam_centre, graph.nodes, strict=True)
    ]
