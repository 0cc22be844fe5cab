"""Pictures made of arrays: overlays, contact sheets, depth as colours, plots."""
