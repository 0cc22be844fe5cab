"""The method `colorpair`: the paper's path on single frames with what was added to it.

Added are: the light of the scene (`light`), votes of single pairs as whole frames (`frames`), a test of
votes against depth (`plausible`), starts from shape (`shape`), and a search on the colours of pairs
(`pair_search`).
"""
