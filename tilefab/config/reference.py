"""The references of job and line files, made from their models: ``python -m tilefab.config.reference [line]``."""

from __future__ import annotations

import json
import sys
from typing import Any

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from tilefab.config.line import Line
from tilefab.config.loader import section_models
from tilefab.config.models import Job

_JOB = """# Job files

A job file is TOML. Relative paths start at the job file; a file that isn't there is looked for in the current folder,
and a press profile also among those shipped with tilefab. `tilefab job check JOB` prints the resolved job, or every
problem at once. This page is made from the models in `tilefab/config/models.py` by `make docs`.
"""
_LINE = """# Line files

A line file is TOML and describes one line: where its devices are, what its recipes ask of belt and kiln, and where its
daemon is talked to. Relative paths start at the line file. `tilefab line check LINE.toml` prints every problem at once;
[jobs/line.toml](../jobs/line.toml) is an example. This page is made from the models in `tilefab/config/line.py` by
`make docs`.
"""
_TOP = "`schema_version = 1` stands at the top, before the first section.\n"


def reference() -> str:
    """Every section and key of a job file with type, default and meaning, as Markdown."""
    return "\n".join([_JOB, _TOP, *_sections(Job)])


def line_reference() -> str:
    """Every section and key of a line file with type, default and meaning, as Markdown."""
    return "\n".join([_LINE, _TOP, *_sections(Line)])


def _sections(whole: type[BaseModel]) -> list[str]:
    parts = []
    for name, model in section_models(whole).items():
        optional = _is_optional(whole, name)
        parts.append(f"## [{name}]{' (may be left out)' if optional else ''}\n")
        parts.append("| key | value | default | meaning |\n| --- | --- | --- | --- |")
        schema = model.model_json_schema()["properties"]
        rows = []
        for key, field in model.model_fields.items():
            required = field.default is PydanticUndefined and field.default_factory is None
            default = "required" if required else f"`{json.dumps(field.default)}`" if field.default is not None else ""
            meaning = (field.description or "").replace("|", "\\|")
            rows.append(f"| `{key}` | {_kind(schema[key])} | {default} | {meaning} |")
        parts.append("\n".join(rows) + "\n")
    return parts


def _is_optional(whole: type[BaseModel], name: str) -> bool:
    """Whether leaving a section out means something other than its defaults."""
    field = whole.model_fields.get(name)
    return field is not None and field.default is None


def _kind(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(_kind(option) for option in schema["anyOf"] if option.get("type") != "null")
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return " or ".join(f"`{json.dumps(value)}`" for value in schema["enum"])
    if schema.get("type") == "array":
        low, high = schema.get("minItems"), schema.get("maxItems")
        count = f"{low} " if low is not None and low == high else ""
        return f"list of {count}({_kind(schema['items'])})"
    if schema.get("type") == "object":
        return f"table of ({_kind(schema['additionalProperties'])})"
    words = {"string": "text", "integer": "whole number", "number": "number", "boolean": "true or false"}
    kind = words.get(str(schema.get("type")), "value")
    bounds = [
        f"{sign} {_number(schema[name])}"
        for name, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
        if name in schema
    ]
    return f"{kind} {', '.join(bounds)}".strip()


def _number(value: float) -> str:
    power = int(value).bit_length() - 1
    return f"2^{power}" if power >= 20 and value == 1 << power else f"{value:,g}"


if __name__ == "__main__":
    sys.stdout.write(line_reference() if sys.argv[1:] == ["line"] else reference())
