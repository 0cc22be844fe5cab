"""The paper's method: everything that it alone needs, and nothing that the paper does not have.

`single_frame` estimates, `tracking` tracks; `tables` makes the tables that a model needs for `single_frame`.
`extended` holds additions for single frames. No other package needs this one: `estimation.methods` loads it
when one of its methods is chosen.
"""
