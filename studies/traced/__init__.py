"""Frames and films by another renderer and other physics than the library's."""
