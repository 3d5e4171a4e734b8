"""The tag table of an ICC profile and its simple elements, read warily: texts, values, ink names.

Functions take a tag's element as bytes, with the tag and the profile's name for messages. What is read out of them is
checked against the bytes that are there first.
"""

from __future__ import annotations

import struct

from tilefab.errors import ProfileError

HEADER_BYTES = 128
_MAX_TAGS = 512
_MAX_INKS = 15
_FIXED_ONE = 65536.0


def signature(data: bytes, offset: int) -> str:
    """Four characters, blanks and zeros at the ends removed."""
    return data[offset : offset + 4].decode("latin-1").strip(" \0")


def damaged(name: str, tag: str, why: str) -> ProfileError:
    """The error for a tag that can't be read."""
    return ProfileError(
        f"{name}: tag {tag!r} is damaged ({why}): export the profile again or take another copy", path=name
    )


def tag_table(data: bytes, size: int, name: str) -> dict[str, tuple[int, int]]:
    """Offset and size of every tag, each inside the profile's ``size`` bytes and 8 bytes or longer.

    Raises
    ------
    ProfileError
        If there are more tags than fit, or one lies outside.
    """
    (count,) = struct.unpack_from(">I", data, HEADER_BYTES)
    first = HEADER_BYTES + 4
    if count > _MAX_TAGS or first + 12 * count > size:
        raise ProfileError(
            f"{name}: its tag table claims {count} tags, more than fit into {size} bytes: it is damaged; "
            "export the profile again",
            path=name,
        )
    tags: dict[str, tuple[int, int]] = {}
    for index in range(count):
        raw, offset, length = struct.unpack_from(">4sII", data, first + 12 * index)
        tag = raw.decode("latin-1")
        if offset < first + 12 * count or length < 8 or offset + length > size:
            raise ProfileError(
                f"{name}: tag {tag!r} points to bytes {offset} to {offset + length}, outside the profile's "
                f"{size}: it is damaged; export the profile again",
                path=name,
            )
        tags.setdefault(tag, (offset, length))
    return tags


def read_text(body: bytes, tag: str, name: str) -> str:
    """A text of any type that ICC profiles have: text, desc, mluc (English, or what stands first) or utf8.

    Raises
    ------
    ProfileError
        If it is of another type, or points outside its element.
    """
    kind = body[:4]
    if kind == b"desc" and len(body) >= 12:
        return _description(body, tag, name)
    if kind == b"mluc" and len(body) >= 28:
        return _localized(body, tag, name)
    if kind in (b"text", b"utf8"):
        raw = body[8:].split(b"\0")[0]
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError:
            return raw.decode("latin-1")
    raise damaged(name, tag, f"unknown type {kind!r}")


def _description(body: bytes, tag: str, name: str) -> str:
    """Its Unicode part, where there is one and it is whole; else its ASCII part."""
    (count,) = struct.unpack_from(">I", body, 8)
    if count > len(body) - 12:
        raise damaged(name, tag, f"text of {count} characters in {len(body)} bytes")
    start = 12 + count + 8
    if len(body) >= start:
        (units,) = struct.unpack_from(">I", body, start - 4)
        wide = body[start : start + 2 * units]
        if units and len(wide) == 2 * units:
            text = wide.decode("utf-16-be", "replace").split("\0")[0]
            if text.strip():
                return text
    return body[12 : 12 + count].split(b"\0")[0].decode("latin-1")


def _localized(body: bytes, tag: str, name: str) -> str:
    count, size = struct.unpack_from(">II", body, 8)
    if count < 1 or size != 12 or 16 + 12 * count > len(body):
        raise damaged(name, tag, f"{count} translations of {size} bytes in {len(body)}")
    chosen = 16
    for at in range(16, 16 + 12 * count, 12):
        if body[at : at + 2] == b"en":
            chosen = at
            break
    text_bytes, start = struct.unpack_from(">II", body, chosen + 4)
    if start + text_bytes > len(body):
        raise damaged(name, tag, f"text of {text_bytes} bytes in {len(body)}")
    return body[start : start + text_bytes].decode("utf-16-be", "replace").strip("\0")


def read_xyz(body: bytes, tag: str, name: str) -> tuple[float, float, float]:
    """The first value of an XYZType.

    Raises
    ------
    ProfileError
        If there is none.
    """
    if body[:4] != b"XYZ " or len(body) < 20:
        raise damaged(name, tag, "no XYZ value")
    x, y, z = (value / _FIXED_ONE for value in struct.unpack_from(">3i", body, 8))
    return (x, y, z)


def colorant_names(body: bytes, tag: str, name: str) -> tuple[str, ...]:
    """Names in a colorantTableType.

    Raises
    ------
    ProfileError
        If it is none, or too short for its count.
    """
    if body[:4] != b"clrt" or len(body) < 12:
        raise damaged(name, tag, "no colorant table")
    (count,) = struct.unpack_from(">I", body, 8)
    if count > _MAX_INKS or 12 + 38 * count > len(body):
        raise damaged(name, tag, f"{count} inks in {len(body)} bytes")
    raw = (body[12 + 38 * ink :][:32] for ink in range(count))
    return tuple(text.split(b"\0")[0].decode("latin-1").strip() for text in raw)
