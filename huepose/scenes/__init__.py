"""Rendered scenes with exact ground truth, made by code. Where to look:

objects     textures and charts > shapes (the demo's objects), unseen (24 others), room (around them)
poses       motion, plan (the built-in scene), heap (heaps and piles), carried (a fast hand)
frames      camera > frame (`Stage`: all poses over time; `shoot`: renders one frame), with light and sensor
sets        builtin (the loop), rendered (heaps), official_sets (layouts of YCB-Video and Fast-YCB)
on disk     loop_file
"""
