"""The paper's method, complete and apart: what only it needs, and nothing that it does not have.

`single_frame` and `tracking` are its two halves; `tables` makes what a model needs for the first. What was
added to its path on single frames is in `extended`. No other room needs this one: `estimation.methods` loads
it when one of its methods is chosen.
"""
