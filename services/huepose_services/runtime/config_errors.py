"""Reads the text of pipeline.yaml into plain values, and turns what is wrong with it into a sentence: key,
value, what is allowed, hint. Mistakes that YAML ignores are errors too."""

from __future__ import annotations

import datetime
import math
import re
import reprlib
import types
import typing
from pathlib import Path
from typing import Any

import msgspec
import yaml

from huepose.support.errors import InputError
from huepose.support.words import did_you_mean

_TWICE = " a second time"


class _Loader(yaml.SafeLoader):
    """Unlike YAML itself, refuses a key that is there twice, and reads 1e-4 as a number."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            name = str(key.value)
            if name in seen:
                raise yaml.constructor.ConstructorError(None, None, f"'{name}'{_TWICE}", key.start_mark)
            seen.add(name)
        return super().construct_mapping(node, deep)


_SCIENTIFIC = re.compile(r"[-+]?([0-9]{1,17}\.?[0-9]{0,17}|\.[0-9]{1,17})[eE][-+]?[0-9]{1,2}$")


def _refused(loader: _Loader, node: yaml.Node) -> None:
    loader.construct_undefined(node)


for _tag in ("set", "omap", "pairs", "binary"):  # of which no key has values
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _refused)
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _SCIENTIFIC, list("-+.0123456789"))


def read_yaml(text: str, path: Path) -> Any:
    """The values in a text. Raises InputError that names the line, also if a key is there twice."""
    try:
        return _Loader(text).get_single_data()
    except yaml.YAMLError as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
        at = f", line {mark.line + 1}, column {mark.column + 1}" if mark is not None else ""
        twice = (problem or "").endswith(_TWICE)
        said = (problem or " ".join(str(error).split())).replace("\t", "\\t")
        fix = "Indent with spaces, not with tabs." if "\\t" in said else ""
        if "<stream end>" in said:
            fix = "A bracket, a brace or a quotation mark before is not closed."
        elif said.startswith("expected <block end>, but found '<block "):
            fix = "Look at the indentation of that line and the one before."
        elif said.startswith(("could not determine a constructor", "found unhashable key")):
            fix = "Templates (`{{ }}`) and tags (`!include`) are not filled in here: write the values."
        raise InputError(
            f"configuration {path}{at}",
            found=said if twice else f"no valid YAML ({said})",
            expected="each key once" if twice else "",
            fix=fix,
        ) from None
    except Exception as error:
        # Deeply nested brackets, an impossible date, a number of thousands of digits: the YAML reader makes
        # values with Python's own functions, whose errors come out here.
        deep = isinstance(error, RecursionError)
        found = "values that are nested too deeply" if deep else f"no valid YAML ({error})"[:200]
        raise InputError(f"configuration {path}", found=found, expected="a pipeline's keys") from None


_AT = re.compile(r"^(?P<text>.*?)(?: - at (?P<of_key>`key` in )?`(?P<at>[^`]*)`)?$", re.DOTALL)
_UNKNOWN = re.compile(r"Object contains unknown field `(?P<key>.*)`")
_MISSING = re.compile(r"Object missing required field `(?P<key>.*)`")
# The wording of msgspec, and ours.
_WORDS = (
    (r"^\[a-z0-9_-\]\{1,64\}$", "1 to 64 of a-z, 0-9, _ and -"),
    (r"^quaternion is not of unit length$", "a quaternion of unit length, x y z w"),
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

# What to write for required keys of a section if there is nothing special to say.
_IF_NONE = {
    ("FixedMount", "translation"): "Write [0.0, 0.0, 0.0] for a camera at the origin of `parent`.",
    ("FixedMount", "quaternion"): "Write [0.0, 0.0, 0.0, 1.0] for a camera that is not rotated: it looks "
    "along the z of `parent`.",
}

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 80
_SHORT.maxlist = _SHORT.maxdict = 8
_SHORT.maxlevel = 3


def explain(error: msgspec.ValidationError, data: Any, config: type, path: Path) -> InputError:
    """The error in words for the user; `data`: the values of the file, `config`: the type that they should
    have."""
    match = _AT.match(str(error))
    assert match is not None
    text = match["text"]
    at, found, kind = _followed(data, config, (match["at"] or "$").removeprefix("$"))
    unknown, missing = _UNKNOWN.match(text), _MISSING.match(text)
    named = unknown or missing
    if named is not None:
        key = named["key"]
        section = next(part for part in _parts(kind) if part is not type(None))
        allowed = [f.name for f in msgspec.structs.fields(section)]
        return InputError(
            f"{path}: {at}.{key}".replace(": .", ": "),
            found="a key that is not known" if unknown else "nothing",
            expected=f"one of {', '.join(allowed)}" if unknown else "a value",
            fix=did_you_mean(key, allowed) if unknown else _IF_NONE.get((section.__name__, key), ""),
        )
    shown = _shown(found)
    if match["of_key"]:
        kind, _ = _kinds_of_map(kind)
        found = next(key for key in found if not _is(key, kind))
        shown = f"the key {_shown(found)}"
    if text == "quaternion is not of unit length":  # the error is about the mount that it belongs to
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
    for section in _parts(kind):
        # `camera: bop`: a section's name with a value of one of its keys.
        keys = msgspec.structs.fields(section) if hasattr(section, "__struct_fields__") else ()
        for key in (key.name for key in keys if found in _literals(key.type)):
            return f"Write {{{key}: {found}}} there, with what else it needs."
    if at.startswith("objects[") and isinstance(found, str):
        return f"Write {{name: {_SHORT.repr(found)[1:-1]}}}."
    is_no_text = isinstance(found, bool | int | float | datetime.date)
    if is_no_text and _is(str(found).lower(), kind):  # the name 003 or yes
        return "Put it in quotation marks: without them YAML does not read it as a text."
    if at.endswith(".source"):
        return "A webcam has no depth, which HuePose needs in every pixel: see docs/cameras.md."
    return "What each key means: pipeline.yaml of the repository, docs/running.md."


def _allowed(text: str, kind: Any) -> str:
    """X of `Expected X, got Y`, in our words; allowed names are listed."""
    names = [str(name) for name in _literals(kind)]
    if text.startswith("Invalid enum value"):
        text = f"Expected one of {', '.join(names)}" + (", or a number" if float in _parts(kind) else "")
    expected = re.sub(r", got .*$", "", text).removeprefix("Expected ").replace("`", "")
    if re.match(r"str( \| null)?( matching .*)?$", expected) and (form := _form(kind)):
        expected = form
    for pattern, words in _WORDS:
        expected = re.sub(pattern, words, expected)
    return expected


def _form(kind: Any) -> str:
    """The required form of a text, in words; empty if there is none, or it has no description."""
    for part in (kind, *typing.get_args(kind)):
        for said in typing.get_args(part)[1:] if typing.get_origin(part) is typing.Annotated else ():
            if isinstance(said, msgspec.Meta) and said.pattern:
                return said.description or ""
    return ""


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


def _followed(data: Any, kind: Any, at: str) -> tuple[str, Any, Any]:
    """The path, its value, and the type that belongs there. msgspec writes `[...]` for the key of a map; in
    the returned path it is replaced by the first key whose value is wrong."""
    named = ""
    for step in _steps(at):
        if step == "[...]":
            _, kind = _kinds_of_map(kind)
            key = next(key for key, value in data.items() if not _is(value, kind))
            named, data = f"{named}.{key[: _SHORT.maxstring]}", data[key]
        elif step.startswith("["):
            lists = (part for part in _parts(kind) if typing.get_origin(part) in (list, tuple))
            kind = typing.get_args(next(lists))[0]
            named, data = named + step, data[int(step[1:-1])]
        else:
            # An optional section is a union with None.
            section = next(part for part in _parts(kind) if part is not type(None))
            kind = typing.get_type_hints(section, include_extras=True)[step]
            named, data = f"{named}.{step}", data.get(step)
    return named.lstrip("."), data, kind


def _kinds_of_map(kind: Any) -> tuple[Any, Any]:
    """The types of a map's keys and values; a section has keys that are text."""
    maps = (typing.get_args(part) for part in _parts(kind) if typing.get_origin(part) is dict)
    of_key, of_value = next(maps, (str, Any))
    return of_key, of_value


def _is(value: Any, kind: Any) -> bool:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True


def _shown(value: Any) -> str:
    # Never all of it: with aliases a few lines can describe more than memory can hold.
    text = "null" if value is None else _SHORT.repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _with_length(quaternion: list[float]) -> str:
    return f"{[float(f'{x:.6g}') for x in quaternion]}, of length {math.hypot(*quaternion):.4g}"
