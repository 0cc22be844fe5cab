"""Recordings of a running pipeline as MCAP: its frames, messages and inputs of the tracker; played, and
verified by computing the poses again."""
