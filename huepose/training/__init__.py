"""Training of the networks on procedurally generated, rendered objects: it needs no data set.

Modules that train need torch: `pip install '.[train]'`.
"""
