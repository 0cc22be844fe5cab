"""Recordings of a running pipeline: what it saw and said, as a BOP scene with its messages beside it."""
