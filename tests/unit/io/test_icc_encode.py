"""Profiles and links that are written: every number of inks, both versions, byte for byte where it matters."""

import hashlib
import struct
from typing import Literal

import numpy as np
import pytest

from tests.icc_samples import INK_NAMES, link_grid, small_link, small_profile, small_tables
from tilefab.colour.lut import backward_axes
from tilefab.colour.stages import Curves
from tilefab.io.icc import encode_device_link, parse_icc_profile, tag_bytes
from tilefab.io.icc_elements import lab_curves_for
from tilefab.io.icc_encode import ink_space
from tilefab.io.icc_tables import link_table, read_table

VERSIONS = (2, 4)


@pytest.mark.parametrize(
    ("names", "space"),
    [
        (("Brown",), "GRAY"),
        (("Brown", "Blue"), "2CLR"),
        (("Cyan", "Magenta", "Yellow"), "CMY "),
        (("c", "m", "y"), "CMY "),
        (("cyan ceramic", "Magenta 2", "YELLOW"), "CMY "),
        (("Blue", "Brown", "Yellow"), "3CLR"),
        (("Magenta", "Cyan", "Yellow"), "3CLR"),
        (INK_NAMES[:4], "CMYK"),
        (INK_NAMES[:5], "5CLR"),
        (INK_NAMES, "8CLR"),
    ],
)
def test_spaces(names: tuple[str, ...], space: str) -> None:
    assert ink_space(names) == space
    assert small_profile(len(names), 2, ink_names=names)[16:20].decode() == space


@pytest.mark.parametrize("names", [(), ("x",) * 9])
def test_no_inks_and_too_many(names: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="1 to 8"):
        ink_space(names)


@pytest.mark.parametrize("inks", range(1, 9))
@pytest.mark.parametrize("version", VERSIONS)
def test_nodes_are_read_where_they_were_put(inks: int, version: Literal[2, 4]) -> None:
    """At grid nodes, every interpolation gives the grid; so what is left is rounding, in the file and in its curves.

    The topmost a* and b* of version 2, just short of 128, can't be said in version 4, which ends at 127.
    """
    forward, backward = small_tables(inks)
    profile = parse_icc_profile(small_profile(inks, version), "x")
    nodes = [0.0, float(np.interp(0.5, forward.curves[0], np.linspace(0.0, 1.0, 256))), 1.0]
    recipes = np.stack(np.meshgrid(*[nodes] * inks, indexing="ij"), axis=-1)
    for tag in ("A2B0", "A2B1", "A2B2"):
        table = read_table(profile, tag)
        assert (table.source, table.target) == ("ink", "lab")
        np.testing.assert_allclose(table(recipes), forward.grid, atol=0.02)
    axes = backward_axes(5).values(5)
    lab = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    said = (lab.max(axis=-1) <= 127.0) | (version == 2)
    assert said.mean() > 0.6
    wanted = {"B2A0": backward.perceptual, "B2A1": backward.relative, "B2A2": backward.saturation}
    for tag, inks_there in wanted.items():
        table = read_table(profile, tag)
        assert (table.source, table.target) == ("lab", "ink")
        np.testing.assert_allclose(table(lab)[said], inks_there[said], atol=2e-4)
    np.testing.assert_allclose(read_table(profile, "gamt")(lab)[said, 0], backward.gamut[said], atol=2e-4)


def test_white_is_exactly_white_in_both_versions() -> None:
    forward, backward = small_tables(5)
    for version in VERSIONS:
        profile = parse_icc_profile(small_profile(5, version), "x")
        np.testing.assert_allclose(
            read_table(profile, "B2A1")(np.array([100.0, 0.0, 0.0])), backward.relative[-1, 2, 2], atol=2e-4
        )
        np.testing.assert_allclose(read_table(profile, "A2B1")(np.zeros(5)), [100.0, 0.0, 0.0], atol=1e-9)
    assert forward.grid[0, 0, 0, 0, 0, 0] == 100.0


def test_curves_of_version_4_stand_at_the_same_colours() -> None:
    curves = backward_axes(5).curves
    again = lab_curves_for(curves, 4)
    code = np.linspace(0.0, 65280.0, 20_001) / 65535.0  # of version 2, up to its L* 100
    ours = Curves(tuple(again))(np.tile(code * 257.0 / 256.0, (3, 1)).T)
    np.testing.assert_allclose(ours, Curves(tuple(curves))(np.tile(code, (3, 1)).T), atol=2.5e-5)
    assert again[0, -1] == 1.0
    assert lab_curves_for(curves, 2) is curves


def test_header_and_tags_of_version_4() -> None:
    data = small_profile(6, 4)
    assert data[8:24] == b"\x04\x30\x00\x00prtr6CLRLab "
    plain = bytearray(data)
    plain[44:48] = plain[64:68] = bytes(4)
    plain[84:100] = bytes(16)
    assert data[84:100] == hashlib.md5(plain).digest()
    profile = parse_icc_profile(data, "x")
    assert "bkpt" not in profile.tags
    adaptation = tag_bytes(profile, "chad") or b""
    assert struct.unpack(">9i", adaptation[8:]) == (65536, 0, 0, 0, 65536, 0, 0, 0, 65536)
    for tag, kind in (("desc", b"mluc"), ("cprt", b"mluc"), ("A2B0", b"mAB "), ("B2A2", b"mBA "), ("gamt", b"mBA ")):
        assert (tag_bytes(profile, tag) or b"")[:4] == kind
    assert small_profile(6, 4) == data
    assert small_profile(6, 2)[84:100] == bytes(16)


@pytest.mark.parametrize("version", VERSIONS)
def test_ink_names_carry_the_solids(version: Literal[2, 4]) -> None:
    forward, _ = small_tables(3)
    element = tag_bytes(parse_icc_profile(small_profile(3, version), "x"), "clrt") or b""
    scale = {2: (652.8, 256.0, 256.0), 4: (655.35, 257.0, 257.0)}[version]
    codes = struct.unpack_from(">3H", element, 12 + 38 + 32)
    lab = np.array(codes) / scale - (0.0, 128.0, 128.0)
    np.testing.assert_allclose(lab, forward.grid[0, -1, 0], atol=0.01)


LINKS = [(1, 4, "ink"), (3, 6, "ink"), (3, 4, "rgb"), (3, 8, "rgb"), (4, 4, "ink"), (4, 1, "ink"), (6, 6, "ink")]


@pytest.mark.parametrize(("inputs", "outputs", "source"), LINKS)
@pytest.mark.parametrize("version", VERSIONS)
def test_links_are_read_back(inputs: int, outputs: int, source: Literal["ink", "rgb"], version: Literal[2, 4]) -> None:
    profile = parse_icc_profile(small_link(inputs, outputs, version, source), "x")
    assert (profile.device_class, profile.channels) == ("link", inputs)
    assert set(profile.tags) >= {"desc", "cprt", "clot", "pseq", "A2B0"}
    assert ("clrt" in profile.tags) == (source == "ink")
    table = link_table(profile)
    assert (table.source, table.target) == (source, "ink")
    recipes = np.stack(np.meshgrid(*[[0.0, 0.25, 1.0]] * inputs, indexing="ij"), axis=-1)
    np.testing.assert_allclose(table(recipes), link_grid(inputs, outputs), atol=2e-4)


def test_link_axes_of_different_lengths_need_version_4() -> None:
    draw = np.random.default_rng(3)
    arguments = {
        "input_curves": np.tile([0.0, 1.0], (2, 1)),
        "grid": draw.random((3, 5, 2)),
        "ink_names_in": ("a", "b"),
        "ink_names_out": ("c", "d"),
        "description": "uneven",
        "copyright_text": "none",
    }
    profile = parse_icc_profile(encode_device_link(**arguments, version=4), "x")
    at = np.stack(np.meshgrid(np.linspace(0, 1, 3), np.linspace(0, 1, 5), indexing="ij"), axis=-1)
    np.testing.assert_allclose(link_table(profile)(at), arguments["grid"], atol=1e-5)
    with pytest.raises(ValueError, match="different lengths"):
        encode_device_link(**arguments, version=2)
    with pytest.raises(ValueError, match="don't belong together"):
        encode_device_link(**(arguments | {"ink_names_out": ("c",)}))
    with pytest.raises(ValueError, match="don't belong together"):
        encode_device_link(**(arguments | {"ink_names_in": ()}), source_space="rgb")
    with pytest.raises(ValueError, match="2 to 4096"):
        encode_device_link(**(arguments | {"input_curves": np.zeros((2, 4097))}))


@pytest.mark.parametrize("version", VERSIONS)
def test_iccdev_finds_no_fault(version: Literal[2, 4]) -> None:
    iccdev = pytest.importorskip("iccdev")
    made = {f"{inks} inks": small_profile(inks, version) for inks in range(1, 9)}
    made["CMY"] = small_profile(3, version, ink_names=("Cyan", "Magenta", "Yellow"))
    for inputs, outputs, source in LINKS:
        made[f"{source} {inputs} to {outputs}"] = small_link(inputs, outputs, version, source)
    for name, data in made.items():
        result = iccdev.validate_profile(data)
        assert result.status == iccdev.ValidationStatus.OK, f"{name}: {result.report}"
