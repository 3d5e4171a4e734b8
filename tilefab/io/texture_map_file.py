r"""The texture-map file: one file, versioned, checked, and ready to be mapped into memory.

Layout, all numbers little-endian::

    bytes 0-11    b"tilefab map\n"
    bytes 12-15   uint32: version of this layout and of what a map means
    bytes 16-23   uint64: length of the header in bytes
    then          header: JSON (UTF-8) with the facts, a table of arrays, and the map's hash
    then          the arrays, each starting at a multiple of 64 bytes from the file's start, C order

The hash is the map's own (`TextureMap.hash`); it covers every array and fact, so a flipped bit anywhere is found.
"""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np

from tilefab.errors import TextureMapError
from tilefab.io.atomic import atomic_write
from tilefab.sampling import FORMAT_VERSION, CropMap, SlabArea, TextureMap, TileMap
from tilefab.types import Array

MAGIC = b"tilefab map\n"
SUFFIX = ".tfmap"
_ALIGNMENT = 64
_PREFIX = struct.Struct("<12sIQ")
_DTYPES = frozenset({"|u1", "<u2", "<u4", "<i4", "<i8", "<f4", "<f8", "|b1", "|i1"})
_DESIGNS: dict[str, type[TextureMap]] = {"tile": TileMap, "crops": CropMap}


def save_texture_map(path: Path | str, texture_map: TextureMap) -> None:
    """Write a texture map as a whole or not at all.

    Raises
    ------
    OutputError
        If it can't be written.
    """
    arrays = {
        name: np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        for name, array in texture_map.arrays().items()
    }
    table, offset = [], 0
    for name, array in arrays.items():
        table.append({"name": name, "dtype": array.dtype.str, "shape": list(array.shape), "offset": offset})
        offset += -(-array.nbytes // _ALIGNMENT) * _ALIGNMENT
    header = {
        "hash": texture_map.hash,
        "design": texture_map.design,
        "parameters": texture_map.parameters(),
        "space": texture_map.space,
        "channels": list(texture_map.channels),
        "dpi": texture_map.dpi,
        "slabs": [[s.name, s.base_row, s.base_col, s.rows, s.cols] for s in texture_map.slabs],
        "provenance": texture_map.provenance,
        "arrays": table,
    }
    text = json.dumps(header, ensure_ascii=False, sort_keys=True).encode()
    # Spaces after the JSON bring the first array to an aligned place.
    text += b" " * (-(_PREFIX.size + len(text)) % _ALIGNMENT)

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            file.write(_PREFIX.pack(MAGIC, FORMAT_VERSION, len(text)))
            file.write(text)
            for array in arrays.values():
                file.write(array.data)
                file.write(b"\0" * (-array.nbytes % _ALIGNMENT))

    atomic_write(Path(path), write)


def load_texture_map(path: Path | str) -> TextureMap:
    """Read a texture map and check it.

    Parameters
    ----------
    path
        A file written by `save_texture_map`.

    Returns
    -------
    TextureMap
        Its large arrays are read as they are needed (memory-mapped, read-only).

    Raises
    ------
    TextureMapError
        If the file is missing, isn't a texture map, is truncated or damaged, or comes from a later version.
    """
    path = Path(path)
    text, length = _read_header(path)
    try:
        header = json.loads(text)
        data = np.memmap(path, dtype=np.uint8, mode="r", offset=0)
        arrays = {entry["name"]: _array(path, data, _PREFIX.size + length, entry) for entry in header["arrays"]}
        _check_gaps(path, data, _PREFIX.size + length, header["arrays"])
        texture_map = _assemble(header, arrays)
        stated = str(header["hash"])
    except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        raise _error(path, f"damaged ({error}); build the map again") from error
    if texture_map.hash != stated:
        raise _error(path, "damaged: its contents don't match its checksum; build the map again")
    return texture_map


def read_provenance(path: Path | str) -> dict[str, str]:
    """What a map was made from, without reading, or checking, the rest of its file.

    Raises
    ------
    TextureMapError
        If the file is missing, isn't a texture map, or its header is damaged or of another version.
    """
    path = Path(path)
    text, _ = _read_header(path)
    try:
        return {str(k): str(v) for k, v in json.loads(text)["provenance"].items()}
    except (LookupError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise _error(path, f"damaged ({error}); build the map again") from error


def _read_header(path: Path) -> tuple[bytes, int]:
    """Text of the header, and its length in the file."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            prefix = file.read(_PREFIX.size)
            if len(prefix) < _PREFIX.size or not prefix.startswith(MAGIC):
                raise _error(path, "not a texture map of tilefab; give a file that ends in .tfmap")
            _, version, length = _PREFIX.unpack(prefix)
            if version != FORMAT_VERSION:
                relation = "a later" if version > FORMAT_VERSION else "an earlier"
                raise _error(
                    path,
                    f"written by {relation} version of tilefab (format {version}; this one reads "
                    f"{FORMAT_VERSION}); build the map again with `tilefab map build JOB`",
                )
            if length > size - _PREFIX.size:
                raise _error(path, "truncated: the header is longer than the file; build the map again")
            text = file.read(length)
    except OSError as error:
        reason = "there is no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise _error(path, f"can't be read: {reason}") from error
    return text, length


def _array(path: Path, data: Array, start: int, entry: dict[str, Any]) -> Array:
    shape = tuple(int(n) for n in entry["shape"])
    if entry["dtype"] not in _DTYPES or any(n < 0 for n in shape) or len(shape) > 3 or int(entry["offset"]) < 0:
        raise ValueError(f"array {entry['name']} is described wrongly")
    dtype = np.dtype(entry["dtype"])
    count = 1
    for n in shape:
        count *= n
    begin = start + int(entry["offset"])
    if begin + count * dtype.itemsize > data.size:
        raise _error(path, "truncated: it is shorter than its header says; build the map again")
    raw: Array = data[begin : begin + count * dtype.itemsize]
    return np.asarray(raw.view(dtype)).reshape(shape)


def _check_gaps(path: Path, data: Array, start: int, table: list[dict[str, Any]]) -> None:
    """Find damage that no array shows: in the zeros between arrays, and at the end of the file."""
    end = start
    for entry in table:
        stop = start + int(entry["offset"]) + math.prod(entry["shape"]) * np.dtype(entry["dtype"]).itemsize
        end = stop + -(stop - start) % _ALIGNMENT
        if data[stop:end].any():
            raise ValueError(f"there are stray bytes after array {entry['name']}")
    if data.size != end:
        relation = "truncated: it is shorter" if data.size < end else "damaged: it is longer"
        raise _error(path, f"{relation} than its header says; build the map again")


def _assemble(header: dict[str, Any], arrays: dict[str, Array]) -> TextureMap:
    kind = _DESIGNS[header["design"]]
    parameters = {str(name): int(value) for name, value in header["parameters"].items()}
    fields: dict[str, Any] = kind.design_fields(parameters, arrays)
    return kind(
        base=arrays["base"],
        space=str(header["space"]),
        channels=tuple(str(name) for name in header["channels"]),
        dpi=float(header["dpi"]),
        slabs=tuple(SlabArea(str(s[0]), *(int(k) for k in s[1:])) for s in header["slabs"]),
        provenance={str(k): str(v) for k, v in header["provenance"].items()},
        **fields,
    )


def _error(path: Path, message: str) -> TextureMapError:
    return TextureMapError(f"{path}: {message}", path=str(path))
