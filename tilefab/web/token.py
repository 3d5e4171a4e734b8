"""The token that orders to a line need, and the file that holds it."""

from __future__ import annotations

import hmac
import os
import secrets
import stat
from pathlib import Path

from tilefab.errors import ConfigError, Problem

_TOKEN_BYTES = 32
_SHORTEST, _LONGEST = 32, 512


def make_token(path: Path) -> str:
    """Read a line's token, or make one if there is none.

    Parameters
    ----------
    path
        File of the token. A new one is readable by its owner alone.

    Raises
    ------
    ConfigError
        As for `read_token`, or if it can't be made.
    """
    try:
        # Only the owner ever gets to open it: there is no moment at which it is anybody else's.
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except FileExistsError:
        return read_token(path)
    except OSError as error:
        raise _problem(path, f"the token can't be written: {error.strerror}") from error
    try:
        with os.fdopen(handle, "w", encoding="ascii") as file:
            file.write(secrets.token_urlsafe(_TOKEN_BYTES) + "\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        path.unlink(missing_ok=True)
        raise _problem(path, f"the token can't be written: {error.strerror}") from error
    return read_token(path)


def read_token(path: Path) -> str:
    """Read a line's token.

    Raises
    ------
    ConfigError
        If there is none, or it isn't one, or others than its owner may read or change it: then it is no secret.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError as error:
        raise _problem(path, "there is no token; the line's daemon makes one when it starts") from error
    except OSError as error:
        raise _problem(path, f"the token can't be read: {error.strerror}") from error
    try:
        facts = os.fstat(handle)
        if not stat.S_ISREG(facts.st_mode):
            raise _problem(path, "not a file: a token is kept in a plain file")
        if facts.st_mode & 0o077:
            raise _problem(path, "others may read or change this token; delete it, and the daemon makes a new one")
        if facts.st_uid not in (os.geteuid(), 0):
            raise _problem(path, "this token belongs to another user")
        text = os.read(handle, _LONGEST + 1).strip()
    finally:
        os.close(handle)
    if not _SHORTEST <= len(text) <= _LONGEST or not text.isascii() or not text.decode().isprintable() or b" " in text:
        raise _problem(path, f"not a token: {_SHORTEST} to {_LONGEST} printable ASCII characters without spaces")
    return text.decode()


def same_token(given: str, token: str) -> bool:
    """Whether two tokens are the same, in a time that doesn't tell how much of them is."""
    return hmac.compare_digest(given.encode("utf-8", "surrogateescape"), token.encode())


def _problem(path: Path, message: str) -> ConfigError:
    return ConfigError([Problem(str(path), None, "", message)])
