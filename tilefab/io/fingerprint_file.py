"""Files of fingerprints: kept beside a job's maps, so that its faces need not be rendered again to be recognised."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from tilefab.inspection.fingerprint import FingerprintIndex
from tilefab.io.atomic import atomic_write_bytes

SUFFIX = ".fingerprints.npz"
_KEY = "key"


def save_fingerprints(path: Path, index: FingerprintIndex, key: str) -> None:
    """Write fingerprints in one piece.

    Parameters
    ----------
    path
        The file; replaced if it is there.
    index
        The fingerprints.
    key
        What they depend on.

    Raises
    ------
    OutputError
        If it can't be written.
    """
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {**index.arrays(), _KEY: np.frombuffer(key.encode(), dtype=np.uint8)}
    np.savez(buffer, **arrays)
    atomic_write_bytes(path, buffer.getvalue())


def load_fingerprints(path: Path, key: str) -> FingerprintIndex | None:
    """Fingerprints from a file; ``None`` if there is none, it is damaged, or depends on something else."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as found:
            arrays = {name: found[name] for name in found.files}
        if bytes(arrays.pop(_KEY)).decode() != key:
            return None
        return FingerprintIndex.from_arrays(arrays)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, UnicodeDecodeError):
        return None
