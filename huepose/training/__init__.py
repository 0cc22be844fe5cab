"""Learning from shapes made by code: no data set, no object of the user.

What needs torch imports it when it runs: `pip install '.[train]'`.
"""
