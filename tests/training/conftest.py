"""Without the extra `train` there is no torch, and these test files cannot be imported."""

from importlib.util import find_spec

_NEED_TORCH = ["test_bank.py", "test_rotation_training.py", "test_verification.py", "test_view_codes.py"]
collect_ignore = [] if find_spec("torch") else _NEED_TORCH
