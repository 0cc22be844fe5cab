"""The camera worker: one module per source, and `ingest`, which publishes their frames on time."""
