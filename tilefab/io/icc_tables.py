"""The conversions that an ICC profile holds, as tables in CIELAB, XYZ, ink fractions and RGB.

Colours are relative to the medium's white, as profiles hold them; absolute colours are the caller's, with the
profile's white. Inks are 0 for none, whatever the file's convention.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import WHITE_XYZ_D50
from tilefab.colour.stages import ColourTable, Curves, Matrix, Space, Stage, lab_from_unit, lab_to_unit
from tilefab.errors import ProfileError
from tilefab.io.icc import IccProfile, channels_of, tag_bytes
from tilefab.io.icc_luts import FINE_ENTRIES, Element, read_curve, read_lut
from tilefab.io.icc_tags import damaged, read_xyz

Float64Array = NDArray[np.float64]

TableIntent = Literal["perceptual", "relative", "saturation", "absolute"]
"""Rendering intents; "absolute" reads the relative tables, which the caller moves to the medium's white."""

_TABLE_NUMBERS: dict[str, int] = {"perceptual": 0, "relative": 1, "saturation": 2, "absolute": 1}
_XYZ_TOP = 65535.0 / 32768.0
_SPACES: dict[str, Space] = {"RGB": "rgb", "GRAY": "gray", "Lab": "lab", "XYZ": "xyz", "CMY": "ink", "CMYK": "ink"}
_SPACES |= {f"{inks:X}CLR": "ink" for inks in range(1, 16)}
_NO_DEVICE = {"abst": "an abstract profile", "nmcl": "a named colour profile", "link": "a device link"}
_MATRIX_TAGS = ("rXYZ", "gXYZ", "bXYZ", "rTRC", "gTRC", "bTRC")
_LEAST_DETERMINANT = 1e-6


def read_table(profile: IccProfile, tag: str) -> ColourTable:
    """One table of a profile.

    Parameters
    ----------
    profile
        The profile.
    tag
        ``A2B0`` to ``A2B2``, ``B2A0`` to ``B2A2``, ``gamt`` (its result is gray: 0 inside the gamut) or ``pre0`` to
        ``pre2``.

    Returns
    -------
    ColourTable
        Lab and XYZ in their own units and relative to the medium's white, device values 0 to 1 with 0 for no ink.

    Raises
    ------
    ProfileError
        If the profile has no such table, it is damaged, or its spaces are none of `Space`.
    ValueError
        If ``tag`` names no table.

    References
    ----------
    ICC.1:2010 sections 6.3.4 (encoding of connection spaces), 10.8 to 10.11. lut16Type holds Lab in the encoding of
    version 2 in every profile.
    """
    source, target = _signatures(profile, tag)
    turned = _gray_is_light(profile) if "GRAY" in (source, target) else False
    return _read(profile, tag, source, target, turned)


def device_to_pcs(profile: IccProfile, intent: TableIntent) -> ColourTable:
    """Device values to colours: the intent's table, else the perceptual one, else matrix or gray curve.

    Parameters
    ----------
    profile
        An input, display, output or colour space profile.
    intent
        Which table is wanted first.

    Raises
    ------
    ProfileError
        If the profile is of another class, holds no such conversion, or it is damaged.
    ValueError
        If the intent has no such name.

    References
    ----------
    ICC.1:2010 section 8.10 (precedence of tags) and annex F (matrix and gray profiles).
    """
    tag = _pick(profile, "A2B", intent)
    if tag:
        return read_table(profile, tag)
    return _matrix_forward(profile) if profile.colour_space == "RGB" else _gray_forward(profile)


def pcs_to_device(profile: IccProfile, intent: TableIntent) -> ColourTable:
    """Colours to device values: the intent's table, else the perceptual one, else matrix or gray curve turned round.

    Parameters
    ----------
    profile
        An input, display, output or colour space profile.
    intent
        Which table is wanted first.

    Raises
    ------
    ProfileError
        If the profile is of another class, holds no such conversion, or it is damaged.
    ValueError
        If the intent has no such name.
    """
    tag = _pick(profile, "B2A", intent)
    if tag:
        return read_table(profile, tag)
    return _matrix_backward(profile) if profile.colour_space == "RGB" else _gray_backward(profile)


def link_table(profile: IccProfile) -> ColourTable:
    """The conversion of a device link.

    Raises
    ------
    ProfileError
        If the profile is no device link, or its table is damaged.
    """
    if profile.device_class != "link":
        raise ProfileError(
            f"{profile.path}: is no device link (class {profile.device_class!r}): choose a link",
            path=profile.path,
        )
    return read_table(profile, "A2B0")


def _signatures(profile: IccProfile, tag: str) -> tuple[str, str]:
    """Signatures of a tag's source and target; ``"gamut"`` for the single channel of a gamut tag."""
    device, pcs = profile.colour_space, profile.pcs
    if tag in ("A2B0", "A2B1", "A2B2"):
        return device, pcs
    if tag in ("B2A0", "B2A1", "B2A2"):
        return pcs, device
    if tag == "gamt":
        return pcs, "gamut"
    if tag in ("pre0", "pre1", "pre2"):
        return pcs, pcs
    raise ValueError(f"tag {tag!r} is none of A2B0 to A2B2, B2A0 to B2A2, gamt, pre0 to pre2")


def _read(profile: IccProfile, tag: str, source: str, target: str, turned: bool) -> ColourTable:
    """``turned``: gray is light where the file says 1, so inks are 1 less that."""
    body = tag_bytes(profile, tag)
    if body is None:
        raise ProfileError(f"{profile.path}: has no table {tag}: choose a profile that has one", path=profile.path)
    space_in, space_out = _space(profile, source), _space(profile, target)
    channels_in = channels_of(source)
    channels_out = 1 if target == "gamut" else channels_of(target)
    element = Element(body, tag, profile.path)
    stages = read_lut(element, channels_in, channels_out, xyz_input=source == "XYZ")
    if element.kind == "mft1" and "XYZ" in (source, target):
        raise damaged(profile.path, tag, "XYZ in 8 bits, for which there is no encoding")
    before = _to_unit(space_in, element.kind)
    after = _from_unit(space_out, element.kind)
    if turned and source == "GRAY":
        before = (_turn(),)
    if turned and target == "GRAY":
        after = (_turn(),)
    return ColourTable(space_in, space_out, (*before, *stages, *after))


def _space(profile: IccProfile, space: str) -> Space:
    if space == "gamut":
        return "gray"
    if space == "GRAY" and profile.device_class in ("prtr", "link"):
        return "ink"
    if space not in _SPACES:
        raise ProfileError(
            f"{profile.path}: converts {space!r}, which tilefab doesn't know: choose a profile for inks, RGB or gray",
            path=profile.path,
        )
    return _SPACES[space]


def _to_unit(space: Space, kind: str) -> tuple[Stage, ...]:
    """From a space's own units to the 0 to 1 that a table of this type takes."""
    if space == "lab":
        return (lab_to_unit(2 if kind == "mft2" else 4),)
    if space == "xyz":
        return (Matrix(np.eye(3) / _XYZ_TOP, np.zeros(3)),)
    return ()


def _from_unit(space: Space, kind: str) -> tuple[Stage, ...]:
    if space == "lab":
        return (lab_from_unit(2 if kind == "mft2" else 4),)
    if space == "xyz":
        return (Matrix(np.eye(3) * _XYZ_TOP, np.zeros(3)),)
    return ()


def _turn() -> Matrix:
    return Matrix(np.array([[-1.0]]), np.array([1.0]))


def _gray_is_light(profile: IccProfile) -> bool:
    """Whether a gray press profile calls the unprinted medium 1, as gray images do, rather than 0, as inks.

    Both are met with. Its own colours tell: nothing is lighter than the medium.
    """
    if profile.device_class != "prtr":
        return False
    for tag in ("A2B1", "A2B0", "A2B2"):
        if tag in profile.tags:
            dark, light = _read(profile, tag, "GRAY", profile.pcs, False)(np.array([[0.0], [1.0]]))
            channel = 0 if profile.pcs == "Lab" else 1
            return bool(light[channel] > dark[channel])
    if "kTRC" in profile.tags:
        curve = _curve_tag(profile, "kTRC")
        return bool(curve[-1] > curve[0])
    return True


def _pick(profile: IccProfile, direction: str, intent: str) -> str | None:
    """The tag to read, or None where there is none and the class allows matrix or gray curve."""
    if intent not in _TABLE_NUMBERS:
        raise ValueError(f"intent {intent!r} is none of {', '.join(_TABLE_NUMBERS)}")
    if profile.device_class in _NO_DEVICE:
        raise ProfileError(
            f"{profile.path}: is {_NO_DEVICE[profile.device_class]}, which belongs to no single device: choose the "
            "profile of a scanner, display or press",
            path=profile.path,
        )
    for tag in (f"{direction}{_TABLE_NUMBERS[intent]}", f"{direction}0"):
        if tag in profile.tags:
            return tag
    needed = {"RGB": _MATRIX_TAGS, "GRAY": ("kTRC",)}.get(profile.colour_space)
    if needed is None or any(tag not in profile.tags for tag in needed):
        raise ProfileError(
            f"{profile.path}: has no table {direction}0, nor what could stand for it: build a complete profile",
            path=profile.path,
        )
    return None


def _curve_tag(profile: IccProfile, tag: str) -> Float64Array:
    body = tag_bytes(profile, tag)
    if body is None:
        raise damaged(profile.path, tag, "missing")
    return read_curve(Element(body, tag, profile.path))[0]


def _matrix_columns(profile: IccProfile) -> Float64Array:
    if profile.pcs != "XYZ":
        raise damaged(profile.path, "rXYZ", f"a matrix to {profile.pcs!r}")
    columns = [read_xyz(tag_bytes(profile, tag) or b"", tag, profile.path) for tag in _MATRIX_TAGS[:3]]
    return np.array(columns).T


def _matrix_forward(profile: IccProfile) -> ColourTable:
    matrix = _matrix_columns(profile)
    curves = Curves(tuple(_curve_tag(profile, tag) for tag in _MATRIX_TAGS[3:]))
    return ColourTable("rgb", "xyz", (curves, Matrix(matrix, np.zeros(3))))


def _matrix_backward(profile: IccProfile) -> ColourTable:
    matrix = _matrix_columns(profile)
    if abs(np.linalg.det(matrix)) < _LEAST_DETERMINANT:
        raise damaged(profile.path, "rXYZ", "a matrix that can't be turned round")
    curves = Curves(tuple(_turned_round(profile, tag) for tag in _MATRIX_TAGS[3:]))
    inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    return ColourTable("xyz", "rgb", (Matrix(inverse, np.zeros(3)), curves))


def _gray_axis(profile: IccProfile) -> Float64Array:
    """Colour of the lightest gray: the white of XYZ, or L* 100."""
    if profile.pcs not in ("Lab", "XYZ"):
        raise damaged(profile.path, "kTRC", f"a gray curve to {profile.pcs!r}")
    return np.array([100.0, 0.0, 0.0] if profile.pcs == "Lab" else WHITE_XYZ_D50)


def _gray_forward(profile: IccProfile) -> ColourTable:
    axis = _gray_axis(profile)
    turn = (_turn(),) if _gray_is_light(profile) else ()
    stages = (*turn, Curves((_curve_tag(profile, "kTRC"),)), Matrix(axis[:, np.newaxis], np.zeros(3)))
    return ColourTable(_space(profile, "GRAY"), "lab" if profile.pcs == "Lab" else "xyz", stages)


def _gray_backward(profile: IccProfile) -> ColourTable:
    channel = 0 if profile.pcs == "Lab" else 1
    pick = np.zeros((1, 3))
    pick[0, channel] = 1.0 / _gray_axis(profile)[channel]
    turn = (_turn(),) if _gray_is_light(profile) else ()
    stages = (Matrix(pick, np.zeros(1)), Curves((_turned_round(profile, "kTRC"),)), *turn)
    return ColourTable("lab" if profile.pcs == "Lab" else "xyz", _space(profile, "GRAY"), stages)


def _turned_round(profile: IccProfile, tag: str) -> Float64Array:
    """The inverse of a tone curve at every 16-bit code; where the curve is flat, the input at which it gets there."""
    curve = _curve_tag(profile, tag)
    falling = curve[-1] < curve[0]
    rising = np.maximum.accumulate(curve[::-1] if falling else curve)
    if rising[-1] <= rising[0]:
        raise damaged(profile.path, tag, "a tone curve that is flat")
    wanted = np.clip(np.linspace(0.0, 1.0, FINE_ENTRIES), rising[0], rising[-1])
    upper = np.maximum(np.searchsorted(rising, wanted), 1)
    step = rising[upper] - rising[upper - 1]
    share = np.where(step > 0.0, (wanted - rising[upper - 1]) / np.where(step > 0.0, step, 1.0), 0.0)
    at = (upper - 1 + share) / (len(curve) - 1.0)
    return np.asarray(1.0 - at if falling else at, dtype=np.float64)
