"""ICC profiles: reading them warily, and telling whether a press can be driven through one.

A profile comes from outside. Every offset, size and count is checked against the bytes that are there before
it is used, and what is wrong is said with the tag it is wrong in. Tables are read in `tilefab.io.icc_tables`; writing
is in `tilefab.io.icc_encode`.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass, field
from pathlib import Path

from tilefab.errors import ProfileError
from tilefab.io.icc_encode import encode_device_link, encode_output_profile
from tilefab.io.icc_tags import HEADER_BYTES, colorant_names, damaged, read_text, read_xyz, signature, tag_table

__all__ = [
    "IccProfile",
    "encode_device_link",
    "encode_output_profile",
    "measurement_text",
    "parse_icc_profile",
    "read_icc_profile",
    "require_press_profile",
    "tag_bytes",
]

_MAX_BYTES = 256 * 1024 * 1024
_WHITE_D50 = (0.9642, 1.0, 0.8249)
_WHITE_TOP = 2.0
_CLASS_NAMES = {
    "scnr": "an input (scanner or camera) profile",
    "mntr": "a display profile",
    "prtr": "an output profile",
    "link": "a device link",
    "spac": "a colour space profile",
    "abst": "an abstract profile",
    "nmcl": "a named colour profile",
}
_DEFAULT_INKS = {
    "GRAY": ("Black",),
    "CMY": ("Cyan", "Magenta", "Yellow"),
    "CMYK": ("Cyan", "Magenta", "Yellow", "Black"),
}
_CHANNELS = {"GRAY": 1, "RGB": 3, "CMY": 3, "CMYK": 4, "Lab": 3, "XYZ": 3, "Luv": 3, "YCbr": 3, "Yxy": 3}
_CHANNELS |= {"HSV": 3, "HLS": 3}
_CHANNELS |= {f"{inks:X}CLR": inks for inks in range(1, 16)}
_LUT_TYPES = ("mft1", "mft2", "mAB ", "mBA ")


@dataclass(frozen=True)
class IccProfile:
    """An ICC profile whose header and tag table have been checked.

    Attributes
    ----------
    data
        The whole profile.
    path
        Where it came from, as messages name it.
    description
        Its own name for itself.
    device_class
        ``"prtr"``, ``"scnr"``, ``"mntr"``, ``"link"`` and so on.
    colour_space, pcs
        Device side and connection space, blanks removed: ``"CMYK"``, ``"Lab"``.
    version
        As in ``"2.4.0"``.
    channels
        Device channels.
    ink_names
        One name for each channel of a press profile; empty where the channels are no inks.
    white_xyz
        Media white under D50, Y = 1 for a perfect diffuser.
    sha256
        Hex digest of ``data``.
    tags
        Signatures of its tags, in file order.
    """

    data: bytes = field(repr=False)
    path: str
    description: str
    device_class: str
    colour_space: str
    pcs: str
    version: str
    channels: int
    ink_names: tuple[str, ...]
    white_xyz: tuple[float, float, float]
    sha256: str
    tags: tuple[str, ...]


def read_icc_profile(path: str | Path) -> IccProfile:
    """Read and check an ICC profile.

    Raises
    ------
    ProfileError
        If the file can't be read, or `parse_icc_profile` refuses it.
    """
    file = Path(path)
    try:
        with file.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ProfileError(
            f"{file}: can't be read: {error.strerror}: check the path and its permissions", path=str(file)
        ) from error
    return parse_icc_profile(data, str(file))


def parse_icc_profile(data: bytes, name: str) -> IccProfile:
    """Check a profile's header and tag table, and read what tilefab needs to know of it.

    Parameters
    ----------
    data
        The profile.
    name
        What to call it in messages: a path, or what it was embedded in.

    Returns
    -------
    IccProfile

    Raises
    ------
    ProfileError
        If it is no ICC profile, is truncated, or a tag points outside it or holds what its type can't.

    References
    ----------
    ICC.1:2001-04 and ICC.1:2022, section 7: header, tag table.
    """
    again = "export the profile again or take another copy"
    if len(data) > _MAX_BYTES:
        raise ProfileError(f"{name}: is above {_MAX_BYTES >> 20} MiB and no ICC profile: choose another", path=name)
    if len(data) < HEADER_BYTES + 4:
        raise ProfileError(
            f"{name}: is {len(data)} bytes long, but an ICC profile has at least {HEADER_BYTES + 4}: {again}",
            path=name,
        )
    if data[36:40] != b"acsp":
        raise ProfileError(
            f"{name}: is no ICC profile (bytes 36 to 39 are not 'acsp'): choose an .icc or .icm file",
            path=name,
        )
    size = _size(data)
    if not HEADER_BYTES + 4 <= size <= len(data):
        raise ProfileError(
            f"{name}: its header says {size} bytes, but {len(data)} are there: it is cut short or damaged; {again}",
            path=name,
        )
    tags = tag_table(data, size, name)
    colour_space = signature(data, 16)
    channels = _CHANNELS.get(colour_space, 0)
    if not channels:
        raise ProfileError(
            f"{name}: has the colour space {colour_space!r}, which no ICC profile has: {again}", path=name
        )
    device_class = signature(data, 12)
    return IccProfile(
        data=data,
        path=name,
        description=_description(data, tags, name) or Path(name).stem,
        device_class=device_class,
        colour_space=colour_space,
        pcs=signature(data, 20),
        version=f"{data[8]}.{data[9] >> 4}.{data[9] & 15}",
        channels=channels,
        ink_names=_ink_names(data, tags, colour_space, channels, device_class, name),
        white_xyz=_white(data, tags, name),
        sha256=hashlib.sha256(data).hexdigest(),
        tags=tuple(tags),
    )


def require_press_profile(profile: IccProfile) -> IccProfile:
    """The same profile, if a press can be driven through it.

    Raises
    ------
    ProfileError
        If it is not an output profile, its connection space is not Lab or XYZ, its channels are no inks, it
        has no tables from colour to inks and back (a gray press may have a tone curve instead), or those tables have
        other channels than it says.
    """
    name = profile.path
    if profile.device_class != "prtr":
        what = _CLASS_NAMES.get(profile.device_class, f"of the class {profile.device_class!r}")
        raise ProfileError(
            f"{name}: is {what}, but a press needs an output profile (class 'prtr'): choose the profile "
            "made for the press",
            path=name,
        )
    if profile.pcs not in ("Lab", "XYZ"):
        raise ProfileError(
            f"{name}: connects to {profile.pcs!r}, but a press profile connects to Lab or XYZ: choose another",
            path=name,
        )
    if not profile.ink_names:
        raise ProfileError(
            f"{name}: drives {profile.colour_space} channels, which are no inks: choose a profile made for "
            "the press's inks, not for an RGB driver",
            path=name,
        )
    tags = tag_table(profile.data, _size(profile.data), name)
    if profile.colour_space == "GRAY" and "kTRC" in tags and not {"A2B0", "B2A0"} & set(tags):
        return profile
    for tag, purpose in (("B2A0", "from colour to inks"), ("A2B0", "from inks to colour")):
        if tag not in tags:
            raise ProfileError(
                f"{name}: has no table {purpose} (tag {tag}), so it can't drive a press: build a complete profile",
                path=name,
            )
    for tag, (offset, size) in tags.items():
        if tag[:3] not in ("A2B", "B2A") or tag[3:] not in ("0", "1", "2"):
            continue
        inputs, outputs = (3, profile.channels) if tag[0] == "B" else (profile.channels, 3)
        kind = profile.data[offset : offset + 4].decode("latin-1")
        if kind not in _LUT_TYPES or size < 32:
            raise ProfileError(
                f"{name}: tag {tag} has the type {kind!r}, which is no table: build the profile again",
                path=name,
            )
        found = tuple(profile.data[offset + 8 : offset + 10])
        if found != (inputs, outputs):
            raise ProfileError(
                f"{name}: tag {tag} goes from {found[0]} to {found[1]} channels, but {inputs} to {outputs} "
                "are needed: build the profile again",
                path=name,
            )
        if kind in ("mft1", "mft2") and size < _lut_bytes(profile.data, offset, kind):
            raise ProfileError(
                f"{name}: tag {tag} is cut short: its table does not fit into its {size} bytes; build the "
                "profile again",
                path=name,
            )
    return profile


def _lut_bytes(data: bytes, offset: int, kind: str) -> int:
    """Bytes that a version 2 table needs by its own counts."""
    inputs, outputs, grid = data[offset + 8 : offset + 11]
    if kind == "mft1":
        return int(48 + 256 * inputs + grid**inputs * outputs + 256 * outputs)
    entries_in, entries_out = struct.unpack_from(">HH", data, offset + 48) if len(data) >= offset + 52 else (0, 0)
    return int(52 + 2 * (entries_in * inputs + grid**inputs * outputs + entries_out * outputs))


def channels_of(space: str) -> int:
    """Channels of a colour space by its signature, blanks removed; 0 for one that no ICC profile has."""
    return _CHANNELS.get(space, 0)


def tag_bytes(profile: IccProfile, tag: str) -> bytes | None:
    """A tag's element, type signature first, or None if the profile has no such tag."""
    place = tag_table(profile.data, _size(profile.data), profile.path).get(tag)
    return None if place is None else profile.data[place[0] : place[0] + place[1]]


def measurement_text(profile: IccProfile) -> str | None:
    """The measurement file that a profile carries (tag ``targ``), or None.

    Raises
    ------
    ProfileError
        If the tag is there but holds no text.

    References
    ----------
    ICC.1:2010 section 9.2.14 (charTargetTag). ArgyllCMS stores its .ti3 in the same place.
    """
    body = tag_bytes(profile, "targ")
    return None if body is None else read_text(body, "targ", profile.path)


def _size(data: bytes) -> int:
    return int(struct.unpack_from(">I", data, 0)[0])


def _description(data: bytes, tags: dict[str, tuple[int, int]], name: str) -> str:
    if "desc" not in tags:
        return ""
    offset, length = tags["desc"]
    return read_text(data[offset : offset + length], "desc", name).strip()


def _white(data: bytes, tags: dict[str, tuple[int, int]], name: str) -> tuple[float, float, float]:
    if "wtpt" not in tags:
        return _WHITE_D50
    offset, length = tags["wtpt"]
    white = read_xyz(data[offset : offset + length], "wtpt", name)
    if not all(0.0 < value < _WHITE_TOP for value in white):
        raise damaged(name, "wtpt", f"white is {white[0]:.4f} {white[1]:.4f} {white[2]:.4f}")
    return white


def _ink_names(
    data: bytes,
    tags: dict[str, tuple[int, int]],
    colour_space: str,
    channels: int,
    device_class: str,
    name: str,
) -> tuple[str, ...]:
    if device_class != "prtr" or not (colour_space in _DEFAULT_INKS or colour_space.endswith("CLR")):
        return ()
    if "clrt" in tags:
        offset, length = tags["clrt"]
        names = colorant_names(data[offset : offset + length], "clrt", name)
        if len(names) == channels and all(names):
            return names
    return _DEFAULT_INKS.get(colour_space) or tuple(f"Ink {ink}" for ink in range(1, channels + 1))
