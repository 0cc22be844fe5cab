"""The camera worker: one module per source, and `ingest`, which publishes what they give, on time."""
