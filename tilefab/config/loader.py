"""Reading job and line files: every problem at once, each with its file, its line and what is allowed."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from tilefab.config.models import Job
from tilefab.errors import ConfigError, Problem

_BARE = r"[A-Za-z0-9_-]+"
_QUOTED = r"\"[^\"]*\"|'[^']*'"
_SECTION = re.compile(rf"^\s*\[\s*({_BARE}(?:\s*\.\s*(?:{_BARE}|{_QUOTED}))*)\s*\]")
_PART = re.compile(rf"{_BARE}|{_QUOTED}")
_KEY = re.compile(r"^\s*\"?([A-Za-z0-9_-]+)\"?\s*(?:\.\s*\"?([A-Za-z0-9_-]+)\"?\s*)?=")
_TOML_PLACE = re.compile(r"\s*\(at line (\d+), column \d+\)")
_MAX_BYTES = 1 << 20
_Model = TypeVar("_Model", bound=BaseModel)


@dataclass(frozen=True)
class TomlFile:
    """A file that was read.

    Attributes
    ----------
    path
        The file.
    lines
        Line of each section and key, counted from 1.
    """

    path: Path
    lines: Mapping[tuple[str, ...], int]

    def problem(self, section: str, key: str, message: str) -> Problem:
        """Describe a problem with one key of this file, at its line."""
        line = self.lines.get((section, key), self.lines.get((section,)))
        return Problem(str(self.path), line, f"{section}.{key}", message)


@dataclass(frozen=True)
class JobFile(TomlFile):
    """A job as read from its file.

    Attributes
    ----------
    job
        What it says, checked.
    """

    job: Job


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
    job, lines = read_model(path, Job, "job")
    return JobFile(path, lines, job)


def read_model(path: Path, model: type[_Model], kind: str) -> tuple[_Model, Mapping[tuple[str, ...], int]]:
    """Read and check a TOML file.

    Parameters
    ----------
    path
        The file.
    model
        What may stand in it.
    kind
        What such a file is called, in messages.

    Returns
    -------
    tuple
        What it says, and the line of each section and key, counted from 1.

    Raises
    ------
    ConfigError
        As for `load_job`.
    """
    name = str(path)
    try:
        raw = path.read_bytes()
    except OSError as error:
        reason = "there is no such file" if isinstance(error, FileNotFoundError) else str(error.strerror)
        raise ConfigError([Problem(name, None, "", reason)]) from error
    if len(raw) > _MAX_BYTES:
        raise ConfigError([Problem(name, None, "", f"larger than 1 MiB: not a {kind} file")])
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
        raise ConfigError([Problem(name, None, "", f"not a {kind} file: {reason}")]) from error
    lines = _lines(text)
    try:
        return model.model_validate(values), lines
    except ValidationError as error:
        problems = [_Problems(name, lines, model, kind).problem(dict(details)) for details in error.errors()]
        raise ConfigError(sorted(problems, key=lambda p: (p.line or 1 << 30, p.key))) from error


def _lines(text: str) -> dict[tuple[str, ...], int]:
    """Line of every section and key, counted from 1; a key written twice is a TOML error, so each has one."""
    lines: dict[tuple[str, ...], int] = {}
    section: tuple[str, ...] = ()
    for number, line in enumerate(text.split("\n"), start=1):
        if match := _SECTION.match(line):
            section = tuple(part.strip("\"'") for part in _PART.findall(match.group(1)))
            lines.setdefault(section, number)
        elif match := _KEY.match(line):
            key = (*section, *(part for part in match.groups() if part))
            lines.setdefault(key, number)
    return lines


class _Problems:
    """Words for what is wrong with a file."""

    def __init__(self, name: str, lines: Mapping[tuple[str, ...], int], model: type[BaseModel], kind: str) -> None:
        self._name, self._lines, self._model, self._kind = name, lines, model, kind

    def problem(self, details: Mapping[str, Any]) -> Problem:
        place = tuple(str(part) for part in details["loc"])
        error, message = str(details["type"]), str(details["msg"])
        path = self._named(place)
        if error == "value_error":
            # Raised by a section's own check as "key: what is wrong".
            key, _, rest = message.removeprefix("Value error, ").partition(": ")
            path, message = (*path, *key.split(".")), rest
        elif error == "extra_forbidden":
            message = self._unknown(path)
        elif error == "missing":
            message = "missing: " + self._allowed(path)
        else:
            shown = repr(details.get("input"))
            shown = shown if len(shown) <= 60 else shown[:57] + "..."
            rest_of_place = place[len(path) :]
            item = f" (item {int(rest_of_place[0]) + 1})" if rest_of_place and rest_of_place[0].isdigit() else ""
            # A pattern is for machines; the field's own description says the same in words.
            why = ". " if error == "string_pattern_mismatch" else f": {message[0].lower()}{message[1:]}. "
            message = f"{shown}{item} is not allowed{why}{self._allowed(path)}".strip()
        line = next((self._lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self._lines), None)
        return Problem(self._name, line, ".".join(path), message)

    def _named(self, place: tuple[str, ...]) -> tuple[str, ...]:
        """The part of a place that names sections and a key, without what lies inside a value."""
        depth = 1
        while depth < len(place) and section_at(self._model, place[:depth]) is not None:
            depth += 1
        return place[:depth]

    def _unknown(self, path: tuple[str, ...]) -> str:
        section = section_at(self._model, path[:-1])
        known = list(section.model_fields) if isinstance(section, type) else []
        close = difflib.get_close_matches(path[-1], known, n=1)
        hint = f"; did you mean {close[0]}?" if close else "."
        return f"unknown key{hint} Allowed here: {', '.join(known)}"

    def _allowed(self, path: tuple[str, ...]) -> str:
        section = section_at(self._model, path)
        if section is not None:
            name = ".".join(path) + (".NAME" if isinstance(section, Named) else "")
            return f"the {self._kind} needs a section [{name}]"
        parent = section_at(self._model, path[:-1])
        field = parent.model_fields.get(path[-1]) if isinstance(parent, type) else None
        return (field.description or "") if field is not None else ""


class Named:
    """Stands for a table whose keys are names that the user chose, such as [recipes]."""

    def __init__(self, section: type[BaseModel]) -> None:
        self.section = section


def section_at(model: type[BaseModel], path: tuple[str, ...]) -> type[BaseModel] | Named | None:
    """What may stand in a table of a file; ``None`` where there is no table."""
    found: type[BaseModel] | Named | None = model
    for key in path:
        if isinstance(found, Named):
            found = found.section
        elif found is not None:
            field = found.model_fields.get(key)
            found = None if field is None else _section_of(field.annotation)
    return found


def _section_of(annotation: Any) -> type[BaseModel] | Named | None:
    """The section that a field holds, if it holds one."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) in (Union, UnionType):
        return next((found for found in map(_section_of, get_args(annotation)) if found is not None), None)
    if get_origin(annotation) is dict:
        section = _section_of(get_args(annotation)[1])
        return Named(section) if isinstance(section, type) else None
    return None


def section_models(model: type[BaseModel] = Job) -> dict[str, type[BaseModel]]:
    """Model of each section of a file, in the order in which they are documented."""
    models = {}
    for name, field in model.model_fields.items():
        found = _section_of(field.annotation)
        if isinstance(found, Named):
            models[f"{name}.NAME"] = found.section
        elif found is not None:
            models[name] = found
    return models
