"""Writing ICC output profiles, version 2.4: the same tables always give the same bytes."""

from __future__ import annotations

import datetime
import struct

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.lut import BackwardTables, ForwardTable
from tilefab.colour.spaces import WHITE_XYZ_D50

_FALLBACK_DAY = datetime.date(2000, 1, 1)
_VERSION = 0x02400000
_LAB_SCALE = np.array([652.80, 256.0, 256.0])
_LAB_OFFSET = np.array([0.0, 128.0, 128.0])
_INK_NAME_BYTES = 32


def encode_output_profile(
    forward: ForwardTable,
    backward: BackwardTables,
    *,
    white_xyz: tuple[float, float, float],
    black_xyz: tuple[float, float, float],
    description: str,
    copyright_text: str,
    ink_names: tuple[str, ...],
    measurement_text: str,
    created: datetime.date | None = None,
) -> bytes:
    """Encode tables as an ICC version 2.4 CMYK output profile.

    Parameters
    ----------
    forward, backward
        The tables, for 4 inks, in relative Lab. The saturation tables are the perceptual ones.
    white_xyz, black_xyz
        Unprinted tile and darkest print, absolute XYZ under D50, Y = 1 for a perfect diffuser.
    description, copyright_text
        Texts of the profile; characters outside ASCII become question marks.
    ink_names
        One name for each ink, carried in a colorant table.
    measurement_text
        The measurement file that the tables come from, carried whole.
    created
        Day written into the profile: the measurements', never the clock's. None is 2000-01-01.

    Returns
    -------
    bytes
        The profile.

    Raises
    ------
    ValueError
        If tables and names are not for 4 inks, or an ink's name is empty or above 31 ASCII characters.

    References
    ----------
    ICC.1:2001-04: sections 6.1 (header), 6.3.2 (required tags), 6.5.7 (lut16Type), Annex A (encoding of Lab).
    """
    inks = forward.curves.shape[0]
    if inks != 4 or backward.relative.shape[-1] != inks or len(ink_names) != inks:
        raise ValueError(f"tables for {inks} inks and {len(ink_names)} names: 4 of each are needed")
    a2b = _lut16(forward.curves, _encode_lab(forward.grid), inks)
    b2a_perceptual = _lut16(backward.curves, _encode_unit(backward.perceptual), 3)
    b2a_relative = _lut16(backward.curves, _encode_unit(backward.relative), 3)
    gamut = _lut16(backward.curves, _encode_unit(backward.gamut[..., np.newaxis]), 3)
    tags = [
        ("desc", _description_type(description)),
        ("cprt", _text_type(copyright_text)),
        ("wtpt", _xyz_type(white_xyz)),
        ("bkpt", _xyz_type(black_xyz)),
        ("clrt", _colorant_type(ink_names, _solid_lab(forward))),
        ("A2B0", a2b),
        ("A2B1", a2b),
        ("A2B2", a2b),
        ("B2A0", b2a_perceptual),
        ("B2A1", b2a_relative),
        ("B2A2", b2a_perceptual),
        ("gamt", gamut),
        ("targ", _text_type(measurement_text)),
    ]
    return _assemble(tags, created or _FALLBACK_DAY)


def _assemble(tags: list[tuple[str, bytes]], day: datetime.date) -> bytes:
    """Header, tag table and elements; equal elements are stored once."""
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
        _VERSION,
        b"prtr",
        b"CMYK",
        b"Lab ",
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
    return header + table + bytes(body)


def _fixed(values: tuple[float, ...]) -> list[int]:
    return [round(value * 65536.0) for value in values]


def _ascii(text: str) -> bytes:
    return text.replace("\0", " ").encode("ascii", "replace") + b"\0"


def _description_type(text: str) -> bytes:
    ascii_text = _ascii(text)
    return b"desc" + bytes(4) + struct.pack(">I", len(ascii_text)) + ascii_text + bytes(4 + 4 + 2 + 1 + 67)


def _text_type(text: str) -> bytes:
    return b"text" + bytes(4) + _ascii(text)


def _xyz_type(xyz: tuple[float, float, float]) -> bytes:
    return b"XYZ " + bytes(4) + struct.pack(">3i", *_fixed(xyz))


def _colorant_type(names: tuple[str, ...], lab: NDArray[np.float64]) -> bytes:
    out = b"clrt" + bytes(4) + struct.pack(">I", len(names))
    for name, code in zip(names, _encode_lab(lab), strict=True):
        text = _ascii(name)
        if not 2 <= len(text) <= _INK_NAME_BYTES:
            raise ValueError(f"ink name {name!r} must have 1 to {_INK_NAME_BYTES - 1} characters")
        out += text.ljust(_INK_NAME_BYTES, b"\0") + code.astype(">u2").tobytes()
    return out


def _solid_lab(forward: ForwardTable) -> NDArray[np.float64]:
    """Relative Lab (N, 3) of each ink alone at full strength: corners of the grid."""
    inks = forward.curves.shape[0]
    corners = [tuple(-1 if i == ink else 0 for i in range(inks)) for ink in range(inks)]
    return np.array([forward.grid[corner] for corner in corners])


def _encode_lab(lab: NDArray[np.float64]) -> NDArray[np.uint16]:
    codes = np.clip(np.round((lab + _LAB_OFFSET) * _LAB_SCALE), 0, 65535)
    return np.asarray(codes, dtype=np.uint16)


def _encode_unit(values: NDArray[np.float64]) -> NDArray[np.uint16]:
    return np.asarray(np.clip(np.round(values * 65535.0), 0, 65535), dtype=np.uint16)


def _lut16(curves: NDArray[np.float64], grid: NDArray[np.uint16], inputs: int) -> bytes:
    """A lut16Type element: curves, grid (first channel slowest), straight output curves."""
    outputs = grid.shape[-1]
    head = struct.pack(">4s4x3Bx", b"mft2", inputs, outputs, grid.shape[0])
    matrix = struct.pack(">9i", *_fixed((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)))
    counts = struct.pack(">2H", curves.shape[1], 2)
    straight = np.tile(np.array([0, 65535], dtype=">u2"), outputs).tobytes()
    return (
        head
        + matrix
        + counts
        + _encode_unit(curves).astype(">u2").tobytes()
        + (grid.astype(">u2").tobytes() + straight)
    )
