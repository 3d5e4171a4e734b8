"""The elements that ICC profiles are put together from: texts, values, curves and tables as bytes.

Each function gives one tag's element, type signature first, without padding. `assemble` makes the profile of them.
"""

from __future__ import annotations

import datetime
import hashlib
import struct
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import WHITE_XYZ_D50

Float64Array = NDArray[np.float64]
Uint16Array = NDArray[np.uint16]

Version = Literal[2, 4]
"""Which ICC specification a profile follows: 2 is written as 2.4, 4 as 4.3."""

FALLBACK_DAY = datetime.date(2000, 1, 1)
INK_NAME_BYTES = 32
MOST_ENTRIES = 4096
_VERSION_CODES: dict[Version, int] = {2: 0x02400000, 4: 0x04300000}
_LAB_SCALE: dict[Version, Float64Array] = {
    2: np.array([652.80, 256.0, 256.0]),
    4: np.array([655.35, 257.0, 257.0]),
}
_LAB_OFFSET = np.array([0.0, 128.0, 128.0])
_ID_BYTES = slice(84, 100)
_NOT_IN_ID = (slice(44, 48), slice(64, 68), _ID_BYTES)


def assemble(
    tags: list[tuple[str, bytes]],
    *,
    version: Version,
    device_class: str,
    colour_space: str,
    pcs: str,
    day: datetime.date,
) -> bytes:
    """Header, tag table and elements; equal elements are stored once.

    Parameters
    ----------
    tags
        Signature and element of each tag, in file order.
    version
        Specification followed. Version 4 gets its profile ID.
    device_class, colour_space, pcs
        Signatures of 4 characters.
    day
        Day of creation.

    Returns
    -------
    bytes

    References
    ----------
    ICC.1:2001-04 section 6.1; ICC.1:2010 sections 7.2 (7.2.18: profile ID) and 7.3.
    """
    table = struct.pack(">I", len(tags))
    body = bytearray()
    first = 128 + 4 + 12 * len(tags)
    places: dict[bytes, int] = {}
    for signature, element in tags:
        if element not in places:
            places[element] = first + len(body)
            body += element + bytes(-len(element) % 4)
        table += struct.pack(">4sII", signature.encode(), places[element], len(element))
    header = struct.pack(
        ">I4sI4s4s4s6H4s4sI4s4sQI3i4s44x",
        first + len(body),
        bytes(4),
        _VERSION_CODES[version],
        device_class.encode(),
        colour_space.encode(),
        pcs.encode(),
        *(day.year, day.month, day.day, 0, 0, 0),
        b"acsp",
        bytes(4),
        0,
        bytes(4),
        bytes(4),
        0,
        0,
        *_fixed(WHITE_XYZ_D50),
        bytes(4),
    )
    data = header + table + bytes(body)
    if version == 2:
        return data
    return data[: _ID_BYTES.start] + profile_id(data) + data[_ID_BYTES.stop :]


def profile_id(data: bytes) -> bytes:
    """MD5 of a profile with its flags, rendering intent and ID set to 0 (ICC.1:2010 section 7.2.18)."""
    plain = bytearray(data)
    for part in _NOT_IN_ID:
        plain[part] = bytes(part.stop - part.start)
    return hashlib.md5(plain, usedforsecurity=False).digest()


def _fixed(values: tuple[float, ...]) -> list[int]:
    return [round(value * 65536.0) for value in values]


def _ascii(text: str) -> bytes:
    return text.replace("\0", " ").encode("ascii", "replace") + b"\0"


def text_type(text: str) -> bytes:
    """Plain text; characters outside ASCII become question marks, as the type has none."""
    return b"text" + bytes(4) + _ascii(text)


def shown_text(text: str, version: Version) -> bytes:
    """A text for people: textDescriptionType in version 2, multiLocalizedUnicodeType in version 4."""
    if version == 4:
        units = text.replace("\0", " ").encode("utf-16-be")
        return b"mluc" + bytes(4) + struct.pack(">II2s2sII", 1, 12, b"en", b"US", len(units), 28) + units
    ascii_text = _ascii(text)
    wide = b"" if text.isascii() else text.replace("\0", " ").encode("utf-16-be") + b"\0\0"
    head = b"desc" + bytes(4) + struct.pack(">I", len(ascii_text)) + ascii_text
    return head + struct.pack(">II", 0, len(wide) // 2) + wide + bytes(2 + 1 + 67)


def copyright_element(text: str, version: Version) -> bytes:
    """The copyright: text in version 2, multiLocalizedUnicodeType in version 4."""
    return text_type(text) if version == 2 else shown_text(text, version)


def xyz_type(xyz: tuple[float, float, float]) -> bytes:
    """One XYZ value."""
    return b"XYZ " + bytes(4) + struct.pack(">3i", *_fixed(xyz))


def identity_adaptation() -> bytes:
    """Chromatic adaptation that changes nothing: what was measured stands under D50 already."""
    return b"sf32" + bytes(4) + struct.pack(">9i", *_fixed((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)))


def colorant_type(names: tuple[str, ...], lab: Float64Array, version: Version) -> bytes:
    """Ink names with the relative Lab (N, 3) of each ink alone.

    Raises
    ------
    ValueError
        If a name is empty or longer than the type allows.
    """
    out = b"clrt" + bytes(4) + struct.pack(">I", len(names))
    for name, code in zip(names, encode_lab(lab, version), strict=True):
        text = _ascii(name)
        if not 2 <= len(text) <= INK_NAME_BYTES:
            raise ValueError(f"ink name {name!r} must have 1 to {INK_NAME_BYTES - 1} characters")
        out += text.ljust(INK_NAME_BYTES, b"\0") + code.astype(">u2").tobytes()
    return out


def sequence_type(models: tuple[str, ...], version: Version) -> bytes:
    """Which devices a link joins: profileSequenceDescType with a model's name for each."""
    out = b"pseq" + bytes(4) + struct.pack(">I", len(models))
    for model in models:
        out += bytes(4 + 4 + 8 + 4) + shown_text("", version) + shown_text(model, version)
    return out


def encode_lab(lab: Float64Array, version: Version) -> Uint16Array:
    """CIELAB (..., 3) in the 16 bits of a version's tables, clipped."""
    codes = np.clip(np.round((lab + _LAB_OFFSET) * _LAB_SCALE[version]), 0, 65535)
    return np.asarray(codes, dtype=np.uint16)


def encode_unit(values: Float64Array) -> Uint16Array:
    """0 to 1 as 0 to 65535, clipped."""
    return np.asarray(np.clip(np.round(values * 65535.0), 0, 65535), dtype=np.uint16)


def lab_curves_for(curves: Float64Array, version: Version) -> Float64Array:
    """Curves (3, E) over the version 2 encoding of Lab as curves over a version's own encoding.

    A version 4 code ``c`` stands for what version 2 calls ``c * 256 / 257``. The nodes of the two can't coincide, so
    version 4 gets as many as the tables of version 2 may have: a bend between them is rounded off by at most 2.5e-5.
    Version 4 ends at a*, b* of 127, 0.996 below the end of version 2.
    """
    if version == 2:
        return curves
    given = np.linspace(0.0, 1.0, curves.shape[1])
    at = np.linspace(0.0, 256.0 / 257.0, MOST_ENTRIES)
    return np.stack([np.interp(at, given, curve) for curve in curves])


def table(curves: Float64Array, grid: Uint16Array, version: Version, *, from_pcs: bool = False) -> bytes:
    """A table with a curve for each input, straight ones for the outputs: lut16Type, or lutAToBType and lutBToAType.

    Parameters
    ----------
    curves
        (I, E), 0 to 1, E 2 to 4096.
    grid
        (G_1, ..., G_I, O) codes, the first input slowest.
    version
        2 gives lut16Type, 4 the types that came with it.
    from_pcs
        Whether inputs are of the connection space (version 4 has a type for each way).

    Raises
    ------
    ValueError
        If curves and grid don't fit each other or the type.

    References
    ----------
    ICC.1:2001-04 section 6.5.8 (lut16Type); ICC.1:2010 sections 10.10 (lutAToBType), 10.11 (lutBToAType).
    """
    inputs, entries = curves.shape
    nodes = grid.shape[:-1]
    if len(nodes) != inputs or not 2 <= entries <= MOST_ENTRIES:
        raise ValueError(
            f"curves {curves.shape}: a grid {grid.shape} needs one an input, of 2 to {MOST_ENTRIES} entries"
        )
    if min(nodes) < 2 or max(nodes) > 255 or not 1 <= grid.shape[-1] <= 15:
        raise ValueError(f"a grid {grid.shape} can't be stored: 2 to 255 nodes and 1 to 15 outputs are possible")
    if version == 2:
        if len(set(nodes)) > 1:
            raise ValueError(f"a grid {grid.shape} has axes of different lengths, which version 2 can't store")
        return _lut16(encode_unit(curves), grid)
    return _lut_a_b(curves, grid, from_pcs)


def _lut16(curves: Uint16Array, grid: Uint16Array) -> bytes:
    outputs = grid.shape[-1]
    head = struct.pack(">4s4x3Bx", b"mft2", curves.shape[0], outputs, grid.shape[0])
    matrix = struct.pack(">9i", *_fixed((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)))
    counts = struct.pack(">2H", curves.shape[1], 2)
    straight = np.tile(np.array([0, 65535], dtype=">u2"), outputs).tobytes()
    return head + matrix + counts + curves.astype(">u2").tobytes() + grid.astype(">u2").tobytes() + straight


def _lut_a_b(curves: Float64Array, grid: Uint16Array, from_pcs: bool) -> bytes:
    """The curves at the connection space are called B, those at the device A; the grid lies between."""
    inputs, outputs = curves.shape[0], grid.shape[-1]
    before = b"".join(_curve(curve) for curve in curves)
    after: bytes = (b"curv" + bytes(8)) * outputs
    clut = struct.pack("16sB3x", bytes(grid.shape[:-1]), 2) + grid.astype(">u2").tobytes()
    clut += bytes(-len(clut) % 4)
    first, middle, last = 32, 32 + len(before), 32 + len(before) + len(clut)
    b_at, a_at = (first, last) if from_pcs else (last, first)
    kind = b"mBA " if from_pcs else b"mAB "
    head = struct.pack(">4s4x2B2x5I", kind, inputs, outputs, b_at, 0, 0, middle, a_at)
    return head + before + clut + after


def _curve(values: Float64Array) -> bytes:
    codes = encode_unit(values).astype(">u2").tobytes()
    return b"curv" + bytes(4) + struct.pack(">I", len(values)) + codes + bytes(-len(codes) % 4)
