"""`python -m tests.golden.write [builtin] [recorded]`: write the golden answers, and say what changed.

Without a name: all that are possible here.
"""

from __future__ import annotations

import argparse
import sys

from tests.golden import builtin, recorded
from tests.golden.answers import differences, largest, read, together, write

SETS = {"builtin": builtin, "recorded": recorded}


def main(arguments: list[str] | None = None) -> int:
    """Ask, compare with what is there, write."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden.write", description=__doc__)
    parser.add_argument("sets", nargs="*", metavar="|".join(SETS))
    chosen = parser.parse_args(arguments).sets or list(SETS)
    if unknown := [name for name in chosen if name not in SETS]:
        parser.error(f"'{unknown[0]}' is none of {', '.join(SETS)}")
    for name in chosen:
        module = SETS[name]
        if name == "recorded" and (reason := recorded.missing()):
            print(f"{name}: left as it is, {reason}", file=sys.stderr)
            continue
        got = together(ask(question) for question, ask in module.QUESTIONS.items())
        if module.FILE.exists():
            before = read(module.FILE)
            print(f"{name}: {largest(before, got)}")
            for line in differences(before, got):
                print(f"  {line}")
        write(module.FILE, got)
        print(f"{name}: {len(got.answers)} answers written to {module.FILE}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
