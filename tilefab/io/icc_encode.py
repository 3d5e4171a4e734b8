"""Writing ICC output profiles for 1 to 8 inks and device links, versions 2.4 and 4.3.

The same tables always give the same bytes.
"""

from __future__ import annotations

import datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.lut import BackwardTables, ForwardTable
from tilefab.io.icc_elements import (
    FALLBACK_DAY,
    Version,
    assemble,
    colorant_type,
    copyright_element,
    encode_lab,
    encode_unit,
    identity_adaptation,
    lab_curves_for,
    sequence_type,
    shown_text,
    table,
    text_type,
    xyz_type,
)

MOST_INKS = 8
_PROCESS_INKS = (("cyan", "c"), ("magenta", "m"), ("yellow", "y"))


def ink_space(ink_names: tuple[str, ...]) -> str:
    """Colour space signature, 4 characters, under which inks are written.

    One ink is ``GRAY``, whose tables here count ink (0 = none), as ArgyllCMS writes monochrome presses: its tools know
    no ``1CLR``, though Little CMS and iccDEV do, and all three take ``GRAY`` values as the tables have them. Three inks
    are ``CMY`` if their names say so; four are ``CMYK`` whatever their names, as few programs open ``4CLR``.

    Parameters
    ----------
    ink_names
        1 to 8 names, in channel order.

    Raises
    ------
    ValueError
        If there are none or more than 8.
    """
    inks = len(ink_names)
    if not 1 <= inks <= MOST_INKS:
        raise ValueError(f"{inks} inks: profiles are written for 1 to {MOST_INKS}")
    if inks in (1, 4):
        return "GRAY" if inks == 1 else "CMYK"
    if inks == 3 and all(
        name.casefold().strip() == short or name.casefold().strip().startswith(long)
        for name, (long, short) in zip(ink_names, _PROCESS_INKS, strict=True)
    ):
        return "CMY "
    return f"{inks}CLR"


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
    version: Version = 2,
) -> bytes:
    """Encode tables as an ICC output profile.

    Parameters
    ----------
    forward, backward
        The tables, for 1 to 8 inks, in relative Lab. All grid axes of a table have the same length.
    white_xyz, black_xyz
        Unprinted tile and darkest print, absolute XYZ under D50, Y = 1 for a perfect diffuser.
    description, copyright_text
        Texts of the profile. In version 2, characters of the copyright outside ASCII become question marks.
    ink_names
        One name for each ink, carried in a colorant table.
    measurement_text
        The measurement file that the tables come from, carried whole; characters outside ASCII become question marks.
    created
        Day written into the profile: the measurements', never the clock's. None is 2000-01-01.
    version
        2 writes version 2.4 with lut16Type tables, 4 version 4.3 with lutAToBType and lutBToAType tables.

    Returns
    -------
    bytes
        The profile.

    Raises
    ------
    ValueError
        If tables and names are not for the same 1 to 8 inks, curves have less than 2 or more than 4096 entries, or an
        ink's name is empty or above 31 characters.

    References
    ----------
    ICC.1:2001-04: sections 6.1 (header), 6.3.2 (required tags), Annex A (encoding of Lab); ICC.1:2010: sections 8.5.2
    (required tags) and 6.3.4.2 (encoding of Lab).
    """
    inks = forward.curves.shape[0]
    of_tables = {part.shape[-1] for part in (backward.perceptual, backward.relative, backward.saturation)}
    if forward.grid.ndim != inks + 1 or of_tables != {inks} or len(ink_names) != inks:
        raise ValueError(f"tables for {inks} inks and {len(ink_names)} names: the same number of each is needed")
    space = ink_space(ink_names)
    a2b = table(forward.curves, encode_lab(forward.grid, version), version)
    curves = lab_curves_for(backward.curves, version)
    b2a_perceptual, b2a_relative, b2a_saturation, gamut = (
        table(curves, encode_unit(part), version, from_pcs=True)
        for part in (backward.perceptual, backward.relative, backward.saturation, backward.gamut[..., np.newaxis])
    )
    tags = [
        ("desc", shown_text(description, version)),
        ("cprt", copyright_element(copyright_text, version)),
        ("wtpt", xyz_type(white_xyz)),
        ("bkpt", xyz_type(black_xyz)) if version == 2 else ("chad", identity_adaptation()),
        ("clrt", colorant_type(ink_names, _solid_lab(forward), version)),
        ("A2B0", a2b),
        ("A2B1", a2b),
        ("A2B2", a2b),
        ("B2A0", b2a_perceptual),
        ("B2A1", b2a_relative),
        ("B2A2", b2a_saturation),
        ("gamt", gamut),
        ("targ", text_type(measurement_text)),
    ]
    return assemble(
        tags, version=version, device_class="prtr", colour_space=space, pcs="Lab ", day=created or FALLBACK_DAY
    )


def encode_device_link(
    *,
    input_curves: NDArray[np.float64],
    grid: NDArray[np.float64],
    ink_names_in: tuple[str, ...],
    ink_names_out: tuple[str, ...],
    description: str,
    copyright_text: str,
    created: datetime.date | None = None,
    version: Version = 2,
    source_space: Literal["ink", "rgb"] = "ink",
) -> bytes:
    """Encode a table between two devices as an ICC device link.

    Parameters
    ----------
    input_curves
        (I, E) curve of each input, 0 to 1, E 2 to 4096.
    grid
        (G_1, ..., G_I, O) ink fractions, 0 to 1. Version 2 needs axes of the same length.
    ink_names_in, ink_names_out
        One name for each channel. ``ink_names_in`` is empty where the source is RGB.
    description, copyright_text
        Texts of the profile, as in `encode_output_profile`.
    created
        Day written into the profile. None is 2000-01-01.
    version
        2 writes version 2.4 with a lut16Type table, 4 version 4.3 with a lutAToBType table.
    source_space
        What the inputs are.

    Returns
    -------
    bytes
        The profile. Its colorant tables name the inks; their colours are not known here and stand as Lab 0, 0, 0.

    Raises
    ------
    ValueError
        If curves, grid and names are not for the same channels or can't be stored.

    References
    ----------
    ICC.1:2001-04 section 6.3.3 and ICC.1:2010 section 8.6: device links.
    """
    inputs, outputs = input_curves.shape[0], grid.shape[-1]
    named = 3 if source_space == "rgb" and not ink_names_in else len(ink_names_in)
    if inputs != named or grid.ndim != inputs + 1 or outputs != len(ink_names_out):
        raise ValueError(
            f"{inputs} curves, a grid {grid.shape}, {named} names before and {len(ink_names_out)} after don't belong "
            "together"
        )
    if source_space == "rgb" and ink_names_in:
        raise ValueError("an RGB source has no ink names")
    space_in = "RGB " if source_space == "rgb" else ink_space(ink_names_in)
    models = (", ".join(ink_names_in) or "RGB", ", ".join(ink_names_out))
    tags = [("desc", shown_text(description, version)), ("cprt", copyright_element(copyright_text, version))]
    if ink_names_in:
        tags.append(("clrt", colorant_type(ink_names_in, np.zeros((inputs, 3)), version)))
    tags += [
        ("clot", colorant_type(ink_names_out, np.zeros((outputs, 3)), version)),
        ("pseq", sequence_type(models, version)),
        ("A2B0", table(input_curves, encode_unit(grid), version)),
    ]
    return assemble(
        tags,
        version=version,
        device_class="link",
        colour_space=space_in,
        pcs=ink_space(ink_names_out),
        day=created or FALLBACK_DAY,
    )


def _solid_lab(forward: ForwardTable) -> NDArray[np.float64]:
    """Relative Lab (N, 3) of each ink alone at full strength: corners of the grid."""
    inks = forward.curves.shape[0]
    corners = [tuple(-1 if i == ink else 0 for i in range(inks)) for ink in range(inks)]
    return np.array([forward.grid[corner] for corner in corners])
