"""The reference of job files, made from the models: ``python -m tilefab.config.reference > docs/job_files.md``."""

from __future__ import annotations

import json
import sys
from typing import Any

from pydantic_core import PydanticUndefined

from tilefab.config.loader import section_models

_INTRODUCTION = """# Job files

A job file is TOML. Relative paths start at the job file; a file that isn't there is looked for in the current folder,
and a press profile also among those shipped with tilefab. `tilefab job check JOB` prints the resolved job, or every
problem at once. This page is made from the models in `tilefab/config/models.py` by `make docs`.
"""


def reference() -> str:
    """Every section and key of a job file with type, default and meaning, as Markdown."""
    parts = [_INTRODUCTION, "`schema_version = 1` stands at the top, before the first section.\n"]
    for name, model in section_models().items():
        parts.append(f"## [{name}]\n")
        parts.append("| key | value | default | meaning |\n| --- | --- | --- | --- |")
        schema = model.model_json_schema()["properties"]
        rows = []
        for key, field in model.model_fields.items():
            required = field.default is PydanticUndefined and field.default_factory is None
            default = "required" if required else f"`{json.dumps(field.default)}`" if field.default is not None else ""
            meaning = (field.description or "").replace("|", "\\|")
            rows.append(f"| `{key}` | {_kind(schema[key])} | {default} | {meaning} |")
        parts.append("\n".join(rows) + "\n")
    return "\n".join(parts)


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
    sys.stdout.write(reference())
