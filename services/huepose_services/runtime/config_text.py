"""The text of pipeline.yaml as plain values; what YAML would pass over in silence is an error too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from huepose.support.errors import InputError


class _Loader(yaml.SafeLoader):
    """YAML itself lets the last of several equal keys win."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            name = str(key.value)
            if name in seen:
                raise yaml.constructor.ConstructorError(None, None, f"'{name}' a second time", key.start_mark)
            seen.add(name)
        return super().construct_mapping(node, deep)


def read_yaml(text: str, path: Path) -> Any:
    """The values in a text. Raises InputError that names the line, also where a key is there twice."""
    try:
        return _Loader(text).get_single_data()
    except yaml.YAMLError as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
        at = f", line {mark.line + 1}, column {mark.column + 1}" if mark is not None else ""
        twice = isinstance(error, yaml.constructor.ConstructorError)
        said = (problem or " ".join(str(error).split())).replace("\t", "\\t")
        raise InputError(
            f"configuration {path}{at}",
            found=said if twice else f"no valid YAML ({said})",
            expected="each key once" if twice else "",
        ) from None
    except Exception as error:
        # Brackets in brackets in brackets; a date that is none; a number of thousands of digits: what YAML
        # reads it makes into values by Python's own functions, and their errors come through.
        deep = isinstance(error, RecursionError)
        found = "values within values without an end" if deep else f"no valid YAML ({error})"[:200]
        raise InputError(f"configuration {path}", found=found, expected="a pipeline's keys") from None
