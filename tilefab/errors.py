"""The error tree of tilefab.

::

    TilefabError
    ├── ConfigError      a job file is wrong; carries every problem found
    ├── ImageError       a scan or mask can't be read, or holds what can't be used
    ├── ProfileError     an ICC profile or a measurement file can't be used
    ├── SynthesisError   no texture map can be made from what was given
    ├── TextureMapError  a texture-map file is damaged, truncated or of another version
    ├── OutputError      a result can't be written, or would overwrite another
    ├── ReportError      the report can't be drawn
    ├── DeviceError      a device of the line didn't do as asked
    │   ├── DeviceTimeout        it didn't answer in time, or isn't there
    │   ├── DeviceRefused        it answered that it won't
    │   ├── DeviceProtocolError  what it answered can't be an answer to what was asked
    │   └── InterlockError       it, or we, must not do this now
    └── JournalError     the line's journal can't be read, written or trusted

Every message says what is wrong, where, and what to do. Values that a program may want are attached as fields.
Kernels raise ``ValueError`` for misuse by a programmer; users never see one. The command line catches
`TilefabError` once and ends with ``exit_code``.
"""

from __future__ import annotations

from dataclasses import dataclass


class TilefabError(Exception):
    """Base of every error that tilefab explains to its user.

    Parameters
    ----------
    message
        What is wrong, where, and what to do about it, in one line.
    path
        The file or folder concerned, if there is one.
    """

    exit_code = 1

    def __init__(self, message: str, *, path: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.path = path


@dataclass(frozen=True)
class Problem:
    """One problem of a job file: where it stands and what would be allowed there."""

    file: str
    line: int | None
    key: str
    message: str

    def __str__(self) -> str:
        where = self.file if self.line is None else f"{self.file}:{self.line}"
        return f"{where}: {self.key}: {self.message}" if self.key else f"{where}: {self.message}"


class ConfigError(TilefabError):
    """A job file can't be used; ``problems`` lists everything wrong with it at once."""

    exit_code = 3

    def __init__(self, problems: list[Problem]) -> None:
        super().__init__("\n".join(str(problem) for problem in problems), path=problems[0].file if problems else None)
        self.problems = problems


class ImageError(TilefabError):
    """A scan or mask can't be read, or its contents can't be used."""

    exit_code = 4


class ProfileError(TilefabError):
    """An ICC profile or measurement file can't be read or is not of the kind needed."""

    exit_code = 5


class SynthesisError(TilefabError):
    """No texture map can be made from the slab with these settings."""

    exit_code = 6


class TextureMapError(TilefabError):
    """A texture-map file is damaged, truncated, or of a version this program doesn't know."""

    exit_code = 7


class OutputError(TilefabError):
    """A result can't be written, or writing it would destroy or contradict an earlier one."""

    exit_code = 8


class ReportError(TilefabError):
    """The report can't be drawn from what the run recorded."""

    exit_code = 9


class DeviceError(TilefabError):
    """A device of the line didn't do as asked.

    Parameters
    ----------
    message
        What is wrong, where, and what to do about it, in one line.
    device
        Name of the device.
    """

    exit_code = 10

    def __init__(self, message: str, *, device: str = "") -> None:
        super().__init__(message)
        self.device = device


class DeviceTimeout(DeviceError):  # noqa: N818 - the field's word
    """A device didn't answer in time, or there is no connection to it."""


class DeviceRefused(DeviceError):  # noqa: N818 - the field's word
    """A device answered that it won't do as asked.

    Parameters
    ----------
    message, device
        As for `DeviceError`.
    code
        The device's own code, if it gave one.
    """

    def __init__(self, message: str, *, device: str = "", code: int | None = None) -> None:
        super().__init__(message, device=device)
        self.code = code


class DeviceProtocolError(DeviceError):
    """What a device answered can't be an answer to what was asked; nothing of it was used."""


class InterlockError(DeviceError):
    """Something must not be done in the state that the line or a device is in.

    Parameters
    ----------
    message, device
        As for `DeviceError`.
    code
        Of the alarm that says more of it.
    """

    def __init__(self, message: str, *, device: str = "", code: str = "not_ready") -> None:
        super().__init__(message, device=device)
        self.code = code


class JournalError(TilefabError):
    """The line's journal can't be opened, read, written or trusted."""

    exit_code = 11
