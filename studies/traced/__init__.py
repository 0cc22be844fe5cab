"""Frames and films of another renderer and of another physics than the library's own."""
