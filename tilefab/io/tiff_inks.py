"""Making an ink file of a TIFF whose channels were written as anything else.

The library that writes TIFF takes every separated image for four inks and calls the others extra samples, which are
something else (transparency, masks). For other numbers the file is written as grey with extra samples, and its
directory is put right here: separated, with no extra samples (TIFF 6.0, section 16).
"""

from __future__ import annotations

import struct
from pathlib import Path

_PHOTOMETRIC, _EXTRA_SAMPLES, _SEPARATED = 262, 338, 5


def make_separated(path: Path) -> None:
    """Turn the first image of a little-endian TIFF or BigTIFF into a separated one, in place.

    Raises
    ------
    ValueError
        If the file is no such TIFF.
    """
    with path.open("rb+") as file:
        head = file.read(16)
        if head[:4] == b"II*\0":
            (offset,) = struct.unpack_from("<I", head, 4)
            counts, entry_size, pointer_size, value_at = "<H", 12, 4, 8
        elif head[:4] == b"II+\0":
            (offset,) = struct.unpack_from("<Q", head, 8)
            counts, entry_size, pointer_size, value_at = "<Q", 20, 8, 12
        else:
            raise ValueError(f"{path} is no little-endian TIFF")
        file.seek(offset)
        (count,) = struct.unpack(counts, file.read(struct.calcsize(counts)))
        entries = [bytearray(file.read(entry_size)) for _ in range(count)]
        following = file.read(pointer_size)
        kept = [entry for entry in entries if struct.unpack_from("<H", entry)[0] != _EXTRA_SAMPLES]
        for entry in kept:
            if struct.unpack_from("<H", entry)[0] == _PHOTOMETRIC:
                struct.pack_into("<H", entry, value_at, _SEPARATED)
        file.seek(offset)
        # What is left over behind the shorter directory is never read.
        file.write(struct.pack(counts, len(kept)) + b"".join(kept) + following)
