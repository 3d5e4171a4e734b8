"""Maps of places as files: which pixel of the exemplar each pixel of a grown texture shows.

A NumPy archive (.npz) that any program with NumPy reads: ``source`` (rows, cols) int32, the flat index into the
exemplar, row * exemplar columns + column; and ``facts``, JSON as UTF-8 bytes, with the exemplar's size and how the
texture was grown.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.errors import OutputError, TextureMapError
from tilefab.io.atomic import atomic_path
from tilefab.types import SizePx

SUFFIX = ".npz"
VERSION = 1
_KIND = "tilefab source map"


@dataclass(frozen=True, eq=False)
class SourceMap:
    """A map of places and what it was grown from.

    Attributes
    ----------
    source
        (rows, cols) int32, flat index into the exemplar of each pixel.
    exemplar
        Size of the exemplar, and so of every layer that the map can be applied to.
    method
        Name of the method that grew it.
    seed
        Seed it was grown with.
    toroidal
        Whether it repeats seamlessly.
    complete
        Whether the method was let finish.
    notes
        What the method said, a sentence each.
    """

    source: NDArray[np.int32]
    exemplar: SizePx
    method: str
    seed: int
    toroidal: bool
    complete: bool = True
    notes: tuple[str, ...] = ()


def check_source_map_path(path: Path) -> None:
    """Refuse a map's path that doesn't end in .npz, before the work of making it.

    Raises
    ------
    OutputError
        If it doesn't.
    """
    if path.suffix.lower() != SUFFIX:
        raise OutputError(f"{path}: a map of places is a NumPy archive: end its name in {SUFFIX}", path=str(path))


def save_source_map(path: Path, source_map: SourceMap) -> None:
    """Write a map of places, whole or not at all; the same map is always the same bytes.

    Raises
    ------
    OutputError
        If the path doesn't end in .npz, or the file can't be written.
    """
    check_source_map_path(path)
    source = np.ascontiguousarray(source_map.source, dtype="<i4")
    facts = {
        "kind": _KIND,
        "version": VERSION,
        "exemplar": [source_map.exemplar.rows, source_map.exemplar.cols],
        "method": source_map.method,
        "seed": source_map.seed,
        "toroidal": source_map.toroidal,
        "complete": source_map.complete,
        "notes": list(source_map.notes),
        "sha256": hashlib.sha256(source.data).hexdigest(),
    }
    text = np.frombuffer(json.dumps(facts, sort_keys=True).encode(), dtype=np.uint8)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, source=source, facts=text)


def load_source_map(path: Path) -> SourceMap:
    """Read a map of places and check it.

    Raises
    ------
    TextureMapError
        If the file is missing, is no such map, is damaged, or comes from a later version.
    """
    try:
        with path.open("rb") as raw:
            # NumPy's own words for such a file advise to load it unsafely.
            if not zipfile.is_zipfile(raw):
                raise ValueError("it is no NumPy archive")
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            facts = json.loads(file["facts"].tobytes())
            if facts["kind"] != _KIND:
                raise ValueError(f"it is {facts['kind']}")
            if facts["version"] != VERSION:
                raise _error(path, f"written by a later version of tilefab (format {facts['version']}); grow it again")
            source = np.ascontiguousarray(file["source"], dtype=np.int32)
            rows, cols = (int(n) for n in facts["exemplar"])
            if hashlib.sha256(source.astype("<i4").data).hexdigest() != facts["sha256"]:
                raise ValueError("its places don't match its checksum")
            if source.ndim != 2 or not (source.size and source.min() >= 0 and source.max() < rows * cols):
                raise ValueError("its places lie outside its exemplar")
            return SourceMap(
                source,
                SizePx(rows, cols),
                str(facts["method"]),
                int(facts["seed"]),
                bool(facts["toroidal"]),
                bool(facts["complete"]),
                tuple(str(note) for note in facts["notes"]),
            )
    except OSError as error:
        reason = "there is no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise _error(path, f"can't be read: {reason or error}") from error
    except (ValueError, LookupError, TypeError, AttributeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise _error(
            path, f"damaged, or no map of places ({error}); give a file that `tilefab synth --map` wrote"
        ) from error


def _error(path: Path, message: str) -> TextureMapError:
    return TextureMapError(f"{path}: {message}", path=str(path))
