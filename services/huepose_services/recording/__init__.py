"""Recordings of a running pipeline as MCAP: what it saw, said and took in; played and computed again."""
