"""Tracking under stress: films fed in ways that tempt a tracker to believe what is not so."""
