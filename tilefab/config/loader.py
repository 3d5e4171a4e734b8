"""Reading a job file: every problem at once, each with its file, its line and what is allowed."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from tilefab.config.models import Job
from tilefab.errors import ConfigError, Problem

_SECTION = re.compile(r"^\s*\[\s*([A-Za-z0-9_-]+)\s*\]")
_KEY = re.compile(r"^\s*\"?([A-Za-z0-9_-]+)\"?\s*(?:\.\s*\"?([A-Za-z0-9_-]+)\"?\s*)?=")
_TOML_PLACE = re.compile(r"\s*\(at line (\d+), column \d+\)")
_MAX_BYTES = 1 << 20


@dataclass(frozen=True)
class JobFile:
    """A job as read from its file.

    Attributes
    ----------
    path
        The file.
    job
        What it says, checked.
    lines
        Line of each section and key, counted from 1.
    """

    path: Path
    job: Job
    lines: Mapping[tuple[str, ...], int]

    def problem(self, section: str, key: str, message: str) -> Problem:
        """Describe a problem with one key of this file, at its line."""
        line = self.lines.get((section, key), self.lines.get((section,)))
        return Problem(str(self.path), line, f"{section}.{key}", message)


def load_job(path: Path) -> JobFile:
    """Read and check a job file; paths in it are not looked at.

    Parameters
    ----------
    path
        A TOML file.

    Raises
    ------
    ConfigError
        If it can't be read or anything in it is wrong; carries all problems, in the order of their lines.
    """
    name = str(path)
    try:
        raw = path.read_bytes()
    except OSError as error:
        reason = "there is no such file" if isinstance(error, FileNotFoundError) else str(error.strerror)
        raise ConfigError([Problem(name, None, "", reason)]) from error
    if len(raw) > _MAX_BYTES:
        raise ConfigError([Problem(name, None, "", "larger than 1 MiB: not a job file")])
    try:
        # Editors on Windows put a byte order mark before the text.
        text = raw.decode("utf-8-sig")
        values = tomllib.loads(text)
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise ConfigError([Problem(name, line, "", "not UTF-8 text; save the file as UTF-8")]) from error
    except tomllib.TOMLDecodeError as error:
        place = _TOML_PLACE.search(str(error))
        line_number = int(place.group(1)) if place else text.count("\n") + 1
        message = _TOML_PLACE.sub("", str(error)).replace(" (at end of document)", "; the file ends too early")
        raise ConfigError([Problem(name, line_number, "", f"not valid TOML: {message}")]) from error
    except (ValueError, RecursionError) as error:
        # Numbers of thousands of digits and tables nested thousands deep: valid TOML that Python won't read.
        reason = "nested too deeply" if isinstance(error, RecursionError) else str(error).partition(";")[0]
        raise ConfigError([Problem(name, None, "", f"not a job file: {reason}")]) from error
    try:
        return JobFile(path, Job.model_validate(values), _lines(text))
    except ValidationError as error:
        lines = _lines(text)
        problems = [_problem(name, lines, dict(details)) for details in error.errors()]
        raise ConfigError(sorted(problems, key=lambda p: (p.line or 1 << 30, p.key))) from error


def _lines(text: str) -> dict[tuple[str, ...], int]:
    """Line of every section and key, counted from 1; a key written twice is a TOML error, so each has one."""
    lines: dict[tuple[str, ...], int] = {}
    section: tuple[str, ...] = ()
    for number, line in enumerate(text.split("\n"), start=1):
        if match := _SECTION.match(line):
            section = (match.group(1),)
            lines.setdefault(section, number)
        elif match := _KEY.match(line):
            key = (*section, *(part for part in match.groups() if part))
            lines.setdefault(key, number)
    return lines


def _problem(name: str, lines: dict[tuple[str, ...], int], details: dict[str, Any]) -> Problem:
    place = tuple(str(part) for part in details["loc"])
    kind, message = str(details["type"]), str(details["msg"])
    path = place[:2]
    if kind == "value_error":
        # Raised by a section's own check as "key: what is wrong".
        key, _, rest = message.removeprefix("Value error, ").partition(": ")
        path, message = (*place[:1], key), rest
    elif kind == "extra_forbidden":
        message = _unknown(path)
    elif kind == "missing":
        message = "missing: " + _allowed(path)
    else:
        shown = repr(details.get("input"))
        shown = shown if len(shown) <= 60 else shown[:57] + "..."
        item = f" (item {int(place[2]) + 1})" if len(place) > 2 and place[2].isdigit() else ""
        message = f"{shown}{item} is not allowed: {message[0].lower()}{message[1:]}. {_allowed(path)}".strip()
    line = next((lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in lines), None)
    return Problem(name, line, ".".join(path), message)


def section_models() -> dict[str, type[BaseModel]]:
    """Model of each section of a job file, in the order in which they are documented."""
    models = {}
    for name, field in Job.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            models[name] = kind
    return models


def _unknown(path: tuple[str, ...]) -> str:
    model = Job if len(path) == 1 else section_models().get(path[0])
    known = list(model.model_fields) if model is not None else []
    close = difflib.get_close_matches(path[-1], known, n=1)
    hint = f"; did you mean {close[0]}?" if close else "."
    return f"unknown key{hint} Allowed here: {', '.join(known)}"


def _allowed(path: tuple[str, ...]) -> str:
    model = section_models().get(path[0])
    if model is None or len(path) < 2:
        return f"the job needs a section [{path[0]}]" if model is not None and len(path) == 1 else ""
    field = model.model_fields.get(path[1])
    return field.description or "" if field is not None else ""
