"""Scenes that code draws, all with exact truth. Where to look:

things      textures and charts > shapes (the demo's objects), unseen (24 others), room (around them)
places      motion, plan (the built-in scene), heap (heaps and piles), carried (a fast hand)
a picture   camera > frame (`Stage`: who is where when; `shoot`: one exposure of it), by light and sensor
sets        builtin (the loop), rendered (heaps), official_sets (layouts of others)
on disk     loop_file
"""
