"""A hook of mkdocs that adds two pages to those of this folder: README as the first page, and the reference
of pipeline.yaml, made from the types that read it and from the comments in the file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import msgspec
from mkdocs.structure.files import File, Files

from huepose_services.runtime.config import Config

ROOT = Path(__file__).parents[1]
REPOSITORY = "https://github.com/huepose/huepose/blob/main/"
_LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def on_files(files: Files, config: Any) -> Files:
    """Add both pages."""
    readme = re.sub(r"\]\(docs/", "](", (ROOT / "README.md").read_text())
    for name, text in (("index.md", readme), ("configuration.md", reference())):
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links to files that are not pages lead to the repository."""
    outside = re.sub(r"\]\(\.\./README\.md(#[\w-]+)?\)", r"](index.md\1)", markdown)
    outside = re.sub(r"\]\(\.\./([\w./#-]+)\)", rf"]({REPOSITORY}\1)", outside)
    if page.file.src_uri == "index.md":
        here = r"\]\(((?:protos|examples|benchmarks|studies)/[\w./-]*|pipeline\.yaml|[\w-]+\.py)\)"
        outside = re.sub(here, lambda found: f"]({REPOSITORY}{_of_docs(found[1])})", outside)
    return outside


def _of_docs(path: str) -> str:
    return f"docs/{path}" if "/" not in path and path.endswith(".py") else path


def reference() -> str:
    """The page about pipeline.yaml: type, limits, default and meaning of every key."""
    (_, parts) = msgspec.json.schema_components([Config])
    said = comments((ROOT / "pipeline.yaml").read_text())
    head = (
        "# pipeline.yaml\n\nAll keys with their types, defaults and meanings. The same text is in "
        f"the comments of [the file itself]({REPOSITORY}pipeline.yaml). `huepose validate` checks yours.\n\n"
    )
    return head + "\n".join(_section(parts, "Config", "", said))


def _section(parts: dict[str, Any], name: str, path: str, said: dict[str, str]) -> list[str]:
    """The table of a section of the file, then those of the sections in it."""
    part, rows, inner = parts[name], [], list[str]()
    for key, kind in part["properties"].items():
        whole, below, default = f"{path}{key}", _struct(kind), kind.get("default", "")
        if below:
            inner += _section(parts, below, f"{whole}.", said)
            default = "" if default else default
        shown = "" if default == "" else f"`{msgspec.json.encode(default).decode()}`"
        rows.append(f"| `{key}` | {_type(kind)} | {shown} | {said.get(whole, '')} |")
    title = [f"## {path.rstrip('.')}\n"] if path else []
    about = " ".join(part["description"].split()) if path else ""
    return [
        *title,
        f"{about}\n",
        "| key | type | default | meaning |",
        "|---|---|---|---|",
        *rows,
        "",
        *inner,
    ]


def _struct(kind: dict[str, Any]) -> str | None:
    """The name of the section that a key holds, None for a plain value."""
    items = [kind["items"]] if isinstance(kind.get("items"), dict) else []
    refs = [one["$ref"] for one in [kind, *kind.get("anyOf", []), *items] if "$ref" in one]
    return str(refs[0]).rsplit("/", 1)[-1] if refs else None


def _type(kind: dict[str, Any]) -> str:
    """A type in words."""
    if "anyOf" in kind:
        return " or ".join(dict.fromkeys(_type(one) for one in kind["anyOf"]))
    if "enum" in kind:
        return ", ".join(f"`{value}`" for value in kind["enum"])
    if _struct(kind) is not None:
        return "section, see below"
    if "prefixItems" in kind:
        return f"list of {len(kind['prefixItems'])} {_type(kind['prefixItems'][0])}s"
    if kind.get("type") == "array":
        return f"list of {_type(kind['items'])}"
    limits = " ".join(f"{sign} {kind[key]:g}" for key, sign in _LIMITS.items() if key in kind)
    return f"{kind.get('type', 'anything')} {limits}".strip()


def comments(text: str) -> dict[str, str]:
    """The comments of a YAML file on its keys, by path (`camera.rate`)."""
    said, path = dict[str, list[str]](), list[tuple[int, str]]()
    for line in text.splitlines():
        found = re.match(r"( *)([a-z_0-9]+):[^#]*(?:#\s*(.*))?$", line)
        if found:
            indent = len(found[1])
            path = [*[p for p in path if p[0] < indent], (indent, found[2])]
            said[".".join(name for _, name in path)] = [found[3] or ""]
        elif path and (more := re.match(r"\s{20,}#\s*(.*)$", line)):
            said[".".join(name for _, name in path)].append(more[1])
    return {key: " ".join(parts).strip() for key, parts in said.items()}
