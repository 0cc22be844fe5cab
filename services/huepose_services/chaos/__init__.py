"""Faults in a running pipeline: what is broken, what must hold all the same, and what subscribers saw."""
