"""Drift state files: what is known of how a press has drifted since its profile was built."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from tilefab.colour.drift import MOST_TONE_CHANGE, DriftState, no_drift
from tilefab.errors import ProfileError
from tilefab.io.atomic import atomic_write_bytes

SCHEMA_VERSION = 1
_MOST_BYTES = 4 << 20
_MOST_INKS = 8
_MOST_CHANGE = 10.0
_MOST_NOTE = 1000
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class DriftFile:
    """A drift state and what it belongs to.

    Attributes
    ----------
    state
        The state.
    ink_names
        Names of its inks, in channel order.
    profile_sha256
        Hex digest of the profile that the press has drifted from.
    patches
        How many patches or regions it was fitted to, all updates together.
    note
        What people are to know of it.
    """

    state: DriftState
    ink_names: tuple[str, ...]
    profile_sha256: str
    patches: int
    note: str = field(default="", repr=False)


def write_drift_file(path: Path, drift: DriftFile) -> None:
    """Write a drift state as JSON, in one piece; equal states give equal bytes.

    Raises
    ------
    OutputError
        If it can't be written.
    """
    atomic_write_bytes(path, drift_text(drift).encode())


def drift_text(drift: DriftFile) -> str:
    """A drift state as the JSON of its file."""
    content = {
        "schema_version": SCHEMA_VERSION,
        "profile_sha256": drift.profile_sha256,
        "ink_names": list(drift.ink_names),
        "patches": drift.patches,
        "note": drift.note,
        "mean": drift.state.mean.tolist(),
        "covariance": drift.state.covariance.tolist(),
    }
    lines = [f"  {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def read_drift_file(path: str | Path) -> tuple[DriftFile, str]:
    """Read and check a drift state file.

    Returns
    -------
    tuple
        What it says, and the hex SHA-256 of its bytes.

    Raises
    ------
    ProfileError
        If it can't be read, is no drift state, or holds numbers that no state has.
    """
    name = str(path)
    try:
        with Path(path).open("rb") as file:
            data = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise ProfileError(
            f"{name}: can't be read: {error.strerror}: check the path and its permissions", path=name
        ) from error
    return parse_drift(data, name)


def parse_drift(data: bytes, name: str) -> tuple[DriftFile, str]:
    """Check a drift state as its file holds it; see `read_drift_file`.

    Parameters
    ----------
    data
        JSON, UTF-8.
    name
        What to call it.
    """
    if len(data) > _MOST_BYTES:
        _refuse(name, "is above 4 MiB")
    try:
        content = json.loads(data.decode("utf-8"), parse_constant=_no_number)
    except (ValueError, RecursionError):
        _refuse(name, "is no JSON")
    if not isinstance(content, dict):
        _refuse(name, "holds no table of names and values")
    return _checked(content, name), hashlib.sha256(data).hexdigest()


def _checked(content: dict[str, Any], name: str) -> DriftFile:
    version = content.get("schema_version")
    if version != SCHEMA_VERSION:
        _refuse(name, f"has schema_version {version!r:.40}, not {SCHEMA_VERSION}")
    inks, sha256 = content.get("ink_names"), content.get("profile_sha256")
    patches, note = content.get("patches"), content.get("note", "")
    if (
        not isinstance(inks, list)
        or not 1 <= len(inks) <= _MOST_INKS
        or not all(isinstance(ink, str) and 0 < len(ink) <= 40 for ink in inks)
    ):
        _refuse(name, f"ink_names must be 1 to {_MOST_INKS} names")
    if not isinstance(sha256, str) or not _SHA256.fullmatch(sha256):
        _refuse(name, "profile_sha256 must be 64 hexadecimal digits")
    if isinstance(patches, bool) or not isinstance(patches, int) or not 0 <= patches < 1 << 53:
        _refuse(name, "patches must be a whole number")
    if not isinstance(note, str) or len(note) > _MOST_NOTE:
        _refuse(name, f"note must be a text of at most {_MOST_NOTE} characters")
    size = len(no_drift(len(inks)).mean)
    mean = _numbers(content.get("mean"), (size,), "mean", name)
    covariance = _numbers(content.get("covariance"), (size, size), "covariance", name)
    if np.abs(mean).max() > _MOST_CHANGE or np.abs(mean[: 2 * len(inks)]).max() > MOST_TONE_CHANGE:
        _refuse(name, "mean holds changes that no press goes through")
    scale = np.abs(covariance).max()
    if scale > _MOST_CHANGE or np.abs(covariance - covariance.T).max() > 1e-9 * scale:
        _refuse(name, "covariance must be symmetric and small")
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        _refuse(name, "covariance must be positive")
    return DriftFile(DriftState(mean, covariance, len(inks)), tuple(inks), sha256, patches, note)


def _numbers(values: object, shape: tuple[int, ...], what: str, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """An array of numbers of a shape, from lists in which nothing else stands."""
    try:
        found = np.array(values)
    except ValueError:
        found = np.empty(0)
    if found.shape != shape or found.dtype.kind not in "if" or not np.isfinite(found).all():
        _refuse(name, f"{what} must be {' x '.join(str(length) for length in shape)} numbers")
    return found.astype(np.float64)


def _no_number(text: str) -> NoReturn:
    raise ValueError(text)


def _refuse(name: str, reason: str) -> NoReturn:
    raise ProfileError(f"{name}: {reason}: give a drift state written by `tilefab profile drift`", path=name) from None
