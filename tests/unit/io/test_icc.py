"""ICC profiles: reading what others wrote, refusing what is damaged, and writing what others read."""

import struct
from contextlib import suppress
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.icc_samples import INK_NAMES, TEXT, make_profile, small_profile, small_tables
from tilefab.colour.lut import backward_axes
from tilefab.errors import ProfileError
from tilefab.io.icc import measurement_text, parse_icc_profile, read_icc_profile, require_press_profile, tag_bytes
from tilefab.io.icc_elements import shown_text, text_type
from tilefab.io.press_profile import press_transform

SHIPPED = Path(__file__).parents[3] / "profiles" / "demo_ceramic.icc"
SMALL = small_profile(4, 2)


def tag_place(data: bytes, tag: bytes) -> int:
    """Where a tag's entry stands in the tag table."""
    return data.index(tag, 132)


def changed(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


def test_what_was_written_is_read() -> None:
    profile = parse_icc_profile(SMALL, "small.icc")
    assert profile.description == "A press – near us"
    assert (profile.device_class, profile.colour_space, profile.pcs) == ("prtr", "CMYK", "Lab")
    assert profile.version == "2.4.0"
    assert profile.channels == 4
    assert profile.ink_names == ("Blue", "Brown", "Yellow", "Black")
    np.testing.assert_allclose(profile.white_xyz, (0.797, 0.827, 0.643), atol=2e-5)
    assert len(profile.sha256) == 64
    assert require_press_profile(profile) is profile


def test_required_tags_header_and_alignment() -> None:
    """ICC.1:2001-04, sections 6.1 and 6.3.2, read off the bytes."""
    assert struct.unpack_from(">I", SMALL, 0)[0] == len(SMALL)
    assert SMALL[8:24] == b"\x02\x40\x00\x00prtrCMYKLab "
    assert struct.unpack_from(">6H", SMALL, 24) == (2026, 11, 22, 0, 0, 0)
    assert SMALL[68:80] == bytes.fromhex("0000f6d6000100000000d32d")
    tags = set(parse_icc_profile(SMALL, "x").tags)
    assert tags >= {"desc", "cprt", "wtpt", "A2B0", "A2B1", "A2B2", "B2A0", "B2A1", "B2A2", "gamt", "targ"}
    (count,) = struct.unpack_from(">I", SMALL, 128)
    spans = [struct.unpack_from(">II", SMALL, 132 + 12 * i + 4) for i in range(count)]
    assert all(offset % 4 == 0 for offset, _ in spans)
    assert max(offset + -(-size // 4) * 4 for offset, size in spans) == len(SMALL)
    offset, size = spans[-1]
    assert SMALL[offset : offset + size] == b"text\0\0\0\0" + TEXT.encode() + b"\0"


def test_same_tables_same_bytes_and_no_clock() -> None:
    assert small_profile(4, 2) == SMALL
    assert struct.unpack_from(">6H", small_profile(4, 2, created=None), 24) == (2000, 1, 1, 0, 0, 0)


def test_the_nodes_are_read_back() -> None:
    forward, backward = small_tables(4)
    press = press_transform(parse_icc_profile(SMALL, "small"), "relative")
    corners = np.array(np.meshgrid(*[[0.0, 0.5**1.25, 1.0]] * 4, indexing="ij")).reshape(4, -1).T
    lab = press.lab_from_inks(corners[np.newaxis])[0]
    np.testing.assert_allclose(lab, forward.grid.reshape(-1, 3), atol=0.1)
    nodes = backward_axes(5).colours(5)[np.newaxis]
    np.testing.assert_allclose(press.inks_from_lab(nodes)[0], backward.relative.reshape(-1, 4), atol=1e-3)
    perceptual = press_transform(parse_icc_profile(SMALL, "small"), "perceptual")
    np.testing.assert_allclose(perceptual.inks_from_lab(nodes)[0], backward.perceptual.reshape(-1, 4), atol=1e-3)


def test_foreign_profiles_are_read() -> None:
    srgb = parse_icc_profile(imagecodecs.cms_profile("srgb"), "srgb")
    assert (srgb.device_class, srgb.colour_space, srgb.channels, srgb.ink_names) == ("mntr", "RGB", 3, ())
    assert srgb.description
    assert parse_icc_profile(imagecodecs.cms_profile("lab4"), "lab").version.startswith("4.")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is 0 bytes long"),
        (b"hello" * 100, "is no ICC profile"),
        (SMALL[:-10], "its header says"),
        (changed(SMALL, 0, b"\xff\xff\xff\xff"), "its header says"),
        (changed(SMALL, 0, b"\0\0\0\x10"), "its header says"),
        (changed(SMALL, 128, b"\xff\xff\xff\xff"), "tag table claims 4294967295 tags"),
        (changed(SMALL, 128, b"\0\0\x02\x01"), "tag table claims 513 tags"),
        (changed(SMALL, tag_place(SMALL, b"B2A1") + 4, b"\xff\xff\xff\x00"), "'B2A1' points to bytes"),
        (changed(SMALL, tag_place(SMALL, b"wtpt") + 8, b"\xff\xff\xff\xff"), "'wtpt' points to bytes"),
        (changed(SMALL, tag_place(SMALL, b"desc") + 4, b"\0\0\0\0"), "'desc' points to bytes 0"),
        (changed(SMALL, 16, b"XXXX"), "colour space 'XXXX'"),
        (SMALL.replace(b"desc\0\0\0\0\0\0", b"desc\0\0\0\0\xff\0"), "'desc' is damaged"),
        (SMALL.replace(b"desc\0\0\0\0", b"blob\0\0\0\0"), "'desc' is damaged .unknown type"),
        (SMALL.replace(b"XYZ \0\0\0\0\0\0", b"XYZ \0\0\0\0\x7f\0"), "'wtpt' is damaged"),
        (SMALL.replace(b"clrt\0\0\0\0\0\0", b"clrt\0\0\0\0\xff\0"), "'clrt' is damaged"),
    ],
)
def test_damage_is_explained(data: bytes, message: str) -> None:
    with pytest.raises(ProfileError, match=message) as caught:
        parse_icc_profile(data, "some.icc")
    assert caught.value.message.startswith("some.icc: ")
    assert caught.value.path == "some.icc"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (imagecodecs.cms_profile("srgb"), "is a display profile"),
        (imagecodecs.cms_profile("lab4"), "is an? (abstract|colour space) profile"),
        (changed(SMALL, 12, b"scnr"), r"is an input \(scanner or camera\) profile"),
        (changed(SMALL, 12, b"link"), "is a device link"),
        (changed(SMALL, 20, b"CMYK"), "connects to 'CMYK'"),
        (changed(SMALL, 16, b"RGB "), "RGB channels, which are no inks"),
        (changed(SMALL, tag_place(SMALL, b"B2A0"), b"XXXX"), r"no table from colour to inks \(tag B2A0\)"),
        (changed(SMALL, tag_place(SMALL, b"A2B0"), b"XXXX"), r"no table from inks to colour \(tag A2B0\)"),
        (changed(SMALL, 16, b"CMY "), "goes from 4 to 3 channels, but 3 to 3"),
        (changed(SMALL, SMALL.index(b"mft2") + 10, b"\x20"), "tag A2B0 is cut short"),
        (changed(SMALL, SMALL.index(b"mft2"), b"curv"), "type 'curv', which is no table"),
    ],
)
def test_profiles_that_drive_no_press_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        require_press_profile(parse_icc_profile(data, "some.icc"))


@given(st.lists(st.tuples(st.integers(0, 700), st.integers(0, 255)), min_size=1, max_size=6), st.integers(0, 700))
@settings(max_examples=300, deadline=None)
def test_damaged_bytes_are_read_or_refused_never_worse(bytes_at: list[tuple[int, int]], cut: int) -> None:
    data = bytearray(SMALL)
    for place, value in bytes_at:
        data[place] = value
    for candidate in (bytes(data), bytes(data[:cut])):
        with suppress(ProfileError):
            require_press_profile(parse_icc_profile(candidate, "x"))


def test_unreadable_files_and_misuse(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="can't be read"):
        read_icc_profile(tmp_path / "absent.icc")
    with pytest.raises(ValueError, match="ink name"):
        small_profile(4, 2, ink_names=("", "b", "c", "d"))
    with pytest.raises(ValueError, match="the same number of each"):
        small_profile(4, 2, ink_names=("a", "b", "c"))


@pytest.mark.parametrize("inks", [1, 2, 3, 5, 6, 7, 8])
@pytest.mark.parametrize("version", [2, 4])
def test_every_number_of_inks_is_a_press(inks: int, version: int) -> None:
    profile = require_press_profile(parse_icc_profile(small_profile(inks, version), "some.icc"))
    assert profile.version == {2: "2.4.0", 4: "4.3.0"}[version]
    assert profile.channels == inks
    assert profile.ink_names == INK_NAMES[:inks]
    assert profile.description == "A press – near us"


def test_gray_presses_of_others() -> None:
    curve = b"curv" + bytes(4) + b"\0\0\0\1\2\0"
    profile = parse_icc_profile(make_profile("prtr", "GRAY", "XYZ ", [("kTRC", curve)]), "gray.icc")
    assert require_press_profile(profile).ink_names == ("Black",)
    with pytest.raises(ProfileError, match="no table from colour to inks"):
        require_press_profile(parse_icc_profile(make_profile("prtr", "GRAY", "XYZ ", []), "gray.icc"))


def test_measurements_come_back_whole() -> None:
    for version in (2, 4):
        profile = parse_icc_profile(small_profile(6, version, measurement_text=TEXT * 20_000), "x")
        assert measurement_text(profile) == TEXT * 20_000
    assert measurement_text(parse_icc_profile(imagecodecs.cms_profile("srgb"), "x")) is None


@pytest.mark.parametrize(
    ("element", "text"),
    [
        (text_type("CTI3"), "CTI3"),
        (b"text\0\0\0\0" + "Größe".encode("latin-1") + b"\0", "Größe"),
        (b"utf8\0\0\0\0" + "Größe".encode() + b"\0", "Größe"),
        (shown_text("Größe", 4), "Größe"),
        (shown_text("Größe 😀", 2), "Größe 😀"),
        (shown_text("", 4), ""),
    ],
)
def test_texts_of_every_type(element: bytes, text: str) -> None:
    profile = parse_icc_profile(make_profile("prtr", "CMYK", "Lab ", [("targ", element)]), "x")
    assert measurement_text(profile) == text


def test_english_is_preferred_and_translations_are_checked() -> None:
    records = b"deDE" + struct.pack(">II", 6, 40) + b"enGB" + struct.pack(">II", 4, 46)
    element = b"mluc" + bytes(4) + struct.pack(">II", 2, 12) + records + "Rot".encode("utf-16-be")
    element += "ab".encode("utf-16-be")
    assert measurement_text(parse_icc_profile(make_profile("prtr", "CMYK", "Lab ", [("targ", element)]), "x")) == "ab"
    for at, code in ((8, 5), (8, 0), (12, 16), (16 + 12 + 4, 40), (16 + 12 + 8, 4000)):
        broken = changed(element, at, struct.pack(">I", code))
        with pytest.raises(ProfileError, match="'targ' is damaged"):
            measurement_text(parse_icc_profile(make_profile("prtr", "CMYK", "Lab ", [("targ", broken)]), "x"))


def test_tags_are_found() -> None:
    profile = parse_icc_profile(SMALL + b"trailing", "x")
    assert tag_bytes(profile, "none") is None
    targ = tag_bytes(profile, "targ")
    assert targ is not None
    assert targ[8:-1].decode() == TEXT


def test_iccdev_finds_no_fault_in_the_structure() -> None:
    iccdev = pytest.importorskip("iccdev")
    for data in (SMALL, SHIPPED.read_bytes()):
        result = iccdev.validate_profile(data)
        assert result.status == iccdev.ValidationStatus.OK, result.report
    # It would have said so.
    assert iccdev.validate_profile(SMALL[:4000]).status != iccdev.ValidationStatus.OK


def test_iccdev_computes_the_same_inks_and_colours() -> None:
    iccdev = pytest.importorskip("iccdev")
    data = SHIPPED.read_bytes()
    press = press_transform(parse_icc_profile(data, "shipped"), "relative")
    inks = np.random.default_rng(1).random((30, 4)) * 0.7
    module = iccdev.IccCmm()
    module.attach(str(SHIPPED), intent=iccdev.Intent.RelativeColorimetric)
    module.begin()
    theirs = np.array([module.apply([float(v) for v in ink]) for ink in inks])
    ours = press.lab_from_inks(inks[np.newaxis])[0]
    as_fraction = (ours + np.array([0.0, 128.0, 128.0])) / np.array([100.0, 255.0, 255.0])
    np.testing.assert_allclose(theirs, as_fraction, atol=3e-3)
