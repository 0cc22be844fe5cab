"""The text of pipeline.yaml as plain values, and what is wrong with it as a sentence: path, value, what is
allowed, hint. What YAML would pass over in silence is an error too."""

from __future__ import annotations

import math
import re
import reprlib
import types
import typing
from decimal import Decimal
from pathlib import Path
from typing import Any

import msgspec
import yaml

from huepose.support.errors import InputError
from huepose.support.words import did_you_mean


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
        fix = "Indent with spaces, not with tabs." if "\\t" in said else ""
        if "<stream end>" in said:
            fix = "A bracket, a brace or a quotation mark before is not closed."
        elif said.startswith("expected <block end>, but found '<block "):
            fix = "Look at the indentation of that line and the one before."
        raise InputError(
            f"configuration {path}{at}",
            found=said if twice else f"no valid YAML ({said})",
            expected="each key once" if twice else "",
            fix=fix,
        ) from None
    except Exception as error:
        # Brackets in brackets in brackets; a date that is none; a number of thousands of digits: what YAML
        # reads it makes into values by Python's own functions, and their errors come through.
        deep = isinstance(error, RecursionError)
        found = "values within values without an end" if deep else f"no valid YAML ({error})"[:200]
        raise InputError(f"configuration {path}", found=found, expected="a pipeline's keys") from None


_AT = re.compile(r"^(?P<text>.*?)(?: - at `(?P<at>[^`]*)`)?$", re.DOTALL)
_UNKNOWN = re.compile(r"Object contains unknown field `(?P<key>.*)`")
_MISSING = re.compile(r"Object missing required field `(?P<key>.*)`")
# msgspec's words, and ours.
_WORDS = (
    (r"^str matching regex '\^\[a-z0-9_-\]\{1,64\}\\+Z'$", "1 to 64 of a-z, 0-9, _ and -"),
    (r"^quaternion is not of unit length$", "a quaternion of unit length, x y z w"),
    (r"^str matching regex '\^\[\^/.*:.*\$'$", "ADDRESS:PORT"),
    (r"\bint\b", "a whole number"),
    (r"\bfloat\b", "a number"),
    (r"\bbool\b", "true or false"),
    (r"\bstr\b", "a text"),
    (r"\bobject\b", "keys with values"),
    (r"\barray\b", "a list"),
    (r" >= ([\d.]+?)(?:\.0)?$", r" of \1 or more"),
    (r" <= ([\d.]+?)(?:\.0)?$", r" of \1 or less"),
    (r" > ([\d.]+?)(?:\.0)?$", r" over \1"),
    (r" < ([\d.]+?)(?:\.0)?$", r" under \1"),
)

# Such a number is a text to YAML 1.1, which wants a point and a sign: 1.0e-4.
_SCIENTIFIC = re.compile(r"[-+]?([0-9]{1,17}\.?[0-9]{0,17}|\.[0-9]{1,17})[eE][-+]?[0-9]{1,2}")

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 80
_SHORT.maxlist = _SHORT.maxdict = 8
_SHORT.maxlevel = 3


def explain(error: msgspec.ValidationError, data: Any, config: type, path: Path) -> InputError:
    """The error for a person; `data` is what the file says, `config` the type that it should be."""
    match = _AT.match(str(error))
    assert match is not None
    text, at = match["text"], (match["at"] or "$").removeprefix("$").lstrip(".")
    unknown, missing = _UNKNOWN.match(text), _MISSING.match(text)
    named = unknown or missing
    if named is not None:
        key = named["key"]
        section = next(part for part in _parts(_type(config, at)) if part is not type(None))
        allowed = [f.name for f in msgspec.structs.fields(section)]
        return InputError(
            f"{path}: {at}.{key}".replace(": .", ": "),
            found="a key that is not known" if unknown else "nothing",
            expected=f"one of {', '.join(allowed)}" if unknown else "a value",
            fix=did_you_mean(key, allowed) if unknown else "",
        )
    found, kind = _value(data, at), _type(config, at)
    shown = _shown(found)
    if text == "quaternion is not of unit length":  # said of the mount that it belongs to
        at, shown = f"{at}.quaternion", _with_length(found["quaternion"])
    word = found[: _SHORT.maxstring] if isinstance(found, str) else ""
    meant = did_you_mean(word, [str(name) for name in _literals(kind)])
    return InputError(
        f"{path}: {at or 'the whole file'}",
        found=shown,
        expected=_allowed(text, kind),
        fix=meant or _mended(at, found, kind),
    )


def _mended(at: str, found: Any, kind: Any) -> str:
    """What to write instead, as far as it is known."""
    if plain := _plain(found, kind):
        return f"Write it as {plain}: YAML takes {found} for text."
    for section in _parts(kind):
        # `camera: bop`: the section's name with what is the value of one of its keys.
        keys = msgspec.structs.fields(section) if hasattr(section, "__struct_fields__") else ()
        for key in (key.name for key in keys if found in _literals(key.type)):
            return f"Write {{{key}: {found}}} there, with what else it needs."
    if at.startswith("objects[") and isinstance(found, str):
        return f"Write {{name: {_SHORT.repr(found)[1:-1]}}}."
    if at.endswith(".source"):
        return "A webcam has no depth, which HuePose needs in every pixel: see docs/cameras.md."
    return "What each key means: pipeline.yaml of the repository, docs/running.md."


def _plain(found: Any, kind: Any) -> str:
    """A number in scientific notation without it, where a number belongs and YAML read a text; else empty."""
    if not isinstance(found, str) or not _SCIENTIFIC.fullmatch(found):
        return ""
    plain = f"{Decimal(found):f}"
    if "." in plain:
        plain = plain.rstrip("0").rstrip(".")
    return plain if float in _parts(kind) or (int in _parts(kind) and "." not in plain) else ""


def _allowed(text: str, kind: Any) -> str:
    """`Expected X, got Y` without the part that is said elsewhere; names are listed."""
    names = [str(name) for name in _literals(kind)]
    if text.startswith("Invalid enum value"):
        text = f"Expected one of {', '.join(names)}" + (", or a number" if float in _parts(kind) else "")
    expected = re.sub(r", got .*$", "", text).removeprefix("Expected ").replace("`", "")
    if expected in ("str", "str | null") and (form := _form(kind)):
        expected = f"str matching regex '{form}'"
    for pattern, words in _WORDS:
        expected = re.sub(pattern, words, expected)
    return expected


def _form(kind: Any) -> str | None:
    """The regular expression that a text has to match, where there is one."""
    for part in (kind, *typing.get_args(kind)):
        for said in typing.get_args(part)[1:] if typing.get_origin(part) is typing.Annotated else ():
            if isinstance(said, msgspec.Meta) and said.pattern:
                return said.pattern
    return None


def _parts(kind: Any) -> list[Any]:
    """The members of a union, without their annotations."""
    if typing.get_origin(kind) is typing.Annotated:
        return _parts(typing.get_args(kind)[0])
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return [part for member in typing.get_args(kind) for part in _parts(member)]
    return [kind]


def _literals(kind: Any) -> list[Any]:
    parts = [p for p in _parts(kind) if typing.get_origin(p) is typing.Literal]
    return [name for part in parts for name in typing.get_args(part)]


def _steps(at: str) -> list[str]:
    return [s for s in re.split(r"\.|(\[[^\]]*\])", at) if s]


def _value(data: Any, at: str) -> Any:
    """What stands at a path; a step `[...]`, any value of a map, ends the search."""
    for step in _steps(at):
        if step.startswith("["):
            if not step[1:-1].isdigit() or not isinstance(data, list):
                return data
            data = data[int(step[1:-1])]
        elif isinstance(data, dict):
            data = data.get(step)
    return data


def _shown(value: Any) -> str:
    # Never all of it: aliases make a few lines stand for more than any memory holds.
    text = "null" if value is None else _SHORT.repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _with_length(quaternion: list[float]) -> str:
    return f"{[float(f'{x:.6g}') for x in quaternion]}, of length {math.hypot(*quaternion):.4g}"


def _type(config: type, at: str) -> Any:
    """The type of what belongs at a path."""
    kind: Any = config
    for step in _steps(at):
        # A section that may be left out is a union with None.
        kind = next(part for part in _parts(kind) if part is not type(None))
        if step.startswith("["):
            arguments = typing.get_args(kind)
            kind = arguments[1] if typing.get_origin(kind) is dict else arguments[0]
        else:
            kind = typing.get_type_hints(kind, include_extras=True)[step]
    return kind
