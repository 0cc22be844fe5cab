"""Without the extra `train` there is no torch, and nothing here can be imported."""

from importlib.util import find_spec

collect_ignore = [] if find_spec("torch") else ["test_bank.py", "test_rotation_training.py"]
