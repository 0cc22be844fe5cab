"""The layout of the viewer's page, and the paths under which each kind of data is logged."""

from __future__ import annotations

from typing import Any

import rerun.blueprint as rrb
from rerun import TimeRange, TimeRangeBoundary

CAMERA, COLOR, OVERLAY = "world/camera", "world/camera/color", "world/camera/overlay"
OBJECTS, TRAILS, CLOUD = "world/objects", "world/trails", "world/cloud"
DEPTH, EVENTS = "depth", "events"
LATENCY, QUALITY = "plots/latency", "plots/quality"
TIMELINE = "time"

_PLOTTED_S = 20.0


def layout() -> Any:
    """The blueprint: camera image with poses, depth and events on the left, 3D view and plots on the
    right."""
    recent = rrb.VisibleTimeRange(
        TIMELINE,
        range=TimeRange(
            start=TimeRangeBoundary.cursor_relative(seconds=-_PLOTTED_S),
            end=TimeRangeBoundary.cursor_relative(),
        ),
    )
    image = rrb.Spatial2DView(
        name="Camera and poses", origin=CAMERA, contents=[f"+ /{COLOR}", f"+ /{OVERLAY}/**"]
    )
    depth = rrb.Spatial2DView(name="Depth", origin=DEPTH)
    shown = {"EntityPath": False, "LogLevel": False, "Body": True}
    events = rrb.TextLogView(
        name="Changes of state",
        origin=EVENTS,
        columns=rrb.TextLogColumns(
            # The time is in the text, because the column of the timeline is too narrow to read.
            timeline_columns=[rrb.components.TimelineColumn(TIMELINE, visible=False)],
            text_log_columns=[
                rrb.components.TextLogColumn(kind, visible=visible) for kind, visible in shown.items()
            ],
        ),
    )
    space = rrb.Spatial3DView(
        name="Models where they are believed to be",
        origin="world",
        contents=["+ /world/**", f"- /{OVERLAY}/**"],
        background=[24, 26, 31, 255],
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=(0.54, -0.48, -0.2), look_target=(0.02, 0.08, 0.78), eye_up=(0.0, -1.0, 0.0)
        ),
    )
    quality = rrb.TimeSeriesView(
        name="Quality",
        origin=QUALITY,
        axis_y=rrb.ScalarAxis(range=(0.0, 1.05)),
        # In this corner there are no lines of tracked objects.
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftBottom),
        time_ranges=recent,
    )
    latency = rrb.TimeSeriesView(
        name="Capture to pose, ms",
        origin=LATENCY,
        plot_legend=rrb.PlotLegend(visible=False),
        time_ranges=recent,
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(image, rrb.Horizontal(depth, events, column_shares=[2, 3]), row_shares=[5, 2]),
            rrb.Vertical(space, rrb.Horizontal(quality, latency), row_shares=[5, 2]),
            column_shares=[1, 1],
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_layout=False,
        auto_views=False,
    )
