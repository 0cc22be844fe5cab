"""Tracking under stress: films played in ways that provoke false TRACKING."""
