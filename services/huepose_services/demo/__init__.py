"""The demo: the whole pipeline on the built-in scene, scored against ground truth."""
