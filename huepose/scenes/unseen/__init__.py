"""Objects by code to judge on alone: other shapes and other prints than those of the demo and of YCB.

Nothing is fitted to them and nothing is chosen by them.
"""
