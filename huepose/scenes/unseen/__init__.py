"""Objects made by code, for evaluation only: other shapes and prints than those of the demo and of YCB.

Nothing was fitted to them, and no choice was made on them.
"""
