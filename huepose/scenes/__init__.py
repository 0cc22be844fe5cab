"""Scenes that code draws: the built-in loop that moves, and heaps of objects; both with exact truth."""
