"""The built-in scene: its reference models, made at first use and kept in the cache folder."""

from __future__ import annotations

from pathlib import Path


def builtin_bundles(seed: int) -> Path:
    return Path("/nonexistent")
