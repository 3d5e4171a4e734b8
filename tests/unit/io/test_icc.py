"""ICC profiles: reading what others wrote, refusing what is damaged, and writing what others read."""

import datetime
import shutil
import struct
import subprocess
from contextlib import suppress
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilefab.colour.lut import BackwardTables, ForwardTable, backward_axes
from tilefab.colour.transform import PressTransform
from tilefab.errors import ProfileError
from tilefab.io.icc import encode_output_profile, parse_icc_profile, read_icc_profile, require_press_profile

SHIPPED = Path(__file__).parents[3] / "profiles" / "demo_ceramic.icc"
TEXT = "CTI3\nsome measurements\n"


def small_tables() -> tuple[ForwardTable, BackwardTables]:
    draw = np.random.default_rng(7)
    forward_grid = draw.uniform([20, -40, -40], [100, 40, 40], (3, 3, 3, 3, 3))
    forward_grid[0, 0, 0, 0] = (100.0, 0.0, 0.0)
    curves, _ = backward_axes(5)
    tables = draw.random((2, 5, 5, 5, 4))
    straight = np.tile(np.linspace(0.0, 1.0, 256), (4, 1))
    return ForwardTable(straight, forward_grid), BackwardTables(curves, tables[0], tables[1], draw.random((5, 5, 5)))


def small_profile(**changes: object) -> bytes:
    forward, backward = small_tables()
    arguments: dict[str, object] = {
        "white_xyz": (0.797, 0.827, 0.643),
        "black_xyz": (0.02, 0.02, 0.016),
        "description": "A press – near us",
        "copyright_text": "Nobody's",
        "ink_names": ("Blue", "Brown", "Yellow", "Black"),
        "measurement_text": TEXT,
        "created": datetime.date(2026, 11, 22),
    }
    return encode_output_profile(forward, backward, **(arguments | changes))  # type: ignore[arg-type]


SMALL = small_profile()


def tag_place(data: bytes, tag: bytes) -> int:
    """Where a tag's entry stands in the tag table."""
    return data.index(tag, 132)


def changed(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


def test_what_was_written_is_read() -> None:
    profile = parse_icc_profile(SMALL, "small.icc")
    assert profile.description == "A press ? near us"
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
    assert small_profile() == SMALL
    assert struct.unpack_from(">6H", small_profile(created=None), 24) == (2000, 1, 1, 0, 0, 0)


def test_little_cms_reads_the_nodes() -> None:
    forward, backward = small_tables()
    press = PressTransform(SMALL, "relative", 4)
    corners = np.array(np.meshgrid(*[[0.0, 0.5, 1.0]] * 4, indexing="ij")).reshape(4, -1).T
    lab = press.lab_from_inks(corners[np.newaxis])[0]
    np.testing.assert_allclose(lab, forward.grid.reshape(-1, 3), atol=0.1)
    _, axes = backward_axes(5)
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(1, -1, 3)
    np.testing.assert_allclose(press.inks_from_lab(nodes)[0], backward.relative.reshape(-1, 4), atol=1e-3)
    perceptual = PressTransform(SMALL, "perceptual", 4)
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
        small_profile(ink_names=("", "b", "c", "d"))
    with pytest.raises(ValueError, match="4 of each"):
        small_profile(ink_names=("a", "b", "c"))


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
    press = PressTransform(data, "relative", 4)
    inks = np.random.default_rng(1).random((30, 4)) * 0.7
    module = iccdev.IccCmm()
    module.attach(str(SHIPPED), intent=iccdev.Intent.RelativeColorimetric)
    module.begin()
    theirs = np.array([module.apply([float(v) for v in ink]) for ink in inks])
    ours = press.lab_from_inks(inks[np.newaxis])[0]
    as_fraction = (ours + np.array([0.0, 128.0, 128.0])) / np.array([100.0, 255.0, 255.0])
    np.testing.assert_allclose(theirs, as_fraction, atol=3e-3)


def _feed(command: list[str], lines: str) -> str:
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    done = subprocess.run(command, input=lines, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_argyll_computes_the_same_inks() -> None:
    lab = np.array([[60.0, 5.0, 15.0], [40.0, -2.0, 3.0], [85.0, 1.0, 9.0], [100.0, 0.0, 0.0]])
    lines = "".join(f"{c[0]} {c[1]} {c[2]}\n" for c in lab)
    out = _feed(["icclu", "-v0", "-fb", "-ir", str(SHIPPED)], lines)
    theirs = np.array([[float(word) for word in line.split()] for line in out.splitlines() if line.strip()])
    ours = PressTransform(SHIPPED.read_bytes(), "relative", 4).inks_from_lab(lab[np.newaxis])[0]
    np.testing.assert_allclose(theirs, ours, atol=5e-4)


def test_transicc_computes_the_same_inks() -> None:
    out = _feed(["transicc", "-n", "-i*Lab2", f"-o{SHIPPED}", "-t1", "-c0"], "60\n5\n15\nq\n")
    theirs = np.array([float(word) for word in out.split()[:4]]) / 100.0
    ours = PressTransform(SHIPPED.read_bytes(), "relative", 4).inks_from_lab(np.array([[[60.0, 5.0, 15.0]]]))
    np.testing.assert_allclose(theirs, ours[0, 0], atol=5e-4)
