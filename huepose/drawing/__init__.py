"""Arrays in, picture out: overlays, contact sheets, depth as colours, plots."""
