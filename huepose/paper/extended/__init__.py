"""The method `colorpair`: the paper's method for single frames, with additions.

They are: an estimate of the light (`light`), votes of single pairs as coordinate frames (`frames`), a test of
votes against depth (`plausible`), start poses from shape (`shape`), and a search on the colours of pairs
(`pair_search`).
"""
