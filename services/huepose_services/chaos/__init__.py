"""Injects faults into a running pipeline, and checks what must hold and what subscribers received."""
