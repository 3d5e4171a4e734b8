"""Scans through Little CMS, held against this project's own arithmetic; inks held against Little CMS and tables."""

from pathlib import Path

import imagecodecs
import numpy as np
import pytest

from tests.icc_samples import small_profile
from tilefab.colour.encoding import decode_lab16, encode_lab16
from tilefab.colour.spaces import XYZ_D50_FROM_RGB_LIN, delta_e_2000, lab_from_xyz, rgb_lin_from_srgb, xyz_from_lab
from tilefab.colour.stages import ColourTable, Grid, Matrix
from tilefab.colour.transform import Intent, PressTransform, scan_to_xyz
from tilefab.errors import ProfileError
from tilefab.io.icc import parse_icc_profile, read_icc_profile
from tilefab.io.press_profile import press_transform

SHIPPED = Path(__file__).parents[3] / "profiles" / "demo_ceramic.icc"
SRGB = imagecodecs.cms_profile("srgb")


@pytest.fixture(scope="module")
def profile() -> bytes:
    return SHIPPED.read_bytes()


def shipped(intent: Intent) -> PressTransform:
    return press_transform(read_icc_profile(SHIPPED), intent)


def made_up(inks: int, intent: Intent) -> PressTransform:
    return press_transform(parse_icc_profile(small_profile(inks, 2), "made up"), intent)


@pytest.fixture(scope="module")
def rgb() -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (40, 30, 3)).astype(np.uint8)


def test_no_profile_means_srgb(rgb: np.ndarray) -> None:
    plain = rgb_lin_from_srgb(rgb / 255.0) @ XYZ_D50_FROM_RGB_LIN.T
    own = scan_to_xyz(rgb, None)
    assert own.dtype == np.float32
    assert own.flags.c_contiguous
    np.testing.assert_allclose(own, plain, atol=1e-6)
    np.testing.assert_allclose(scan_to_xyz(rgb, SRGB), plain, atol=3e-4)
    deep = rgb.astype(np.uint16) * 257
    np.testing.assert_allclose(scan_to_xyz(deep, None), plain, atol=1e-6)
    np.testing.assert_allclose(scan_to_xyz(deep, SRGB), plain, atol=3e-4)


def test_floating_point_without_profile_is_linear_and_unbounded() -> None:
    pixels = np.full((2, 2, 3), 2.5, dtype=np.float32)
    np.testing.assert_allclose(scan_to_xyz(pixels, None)[0, 0], [2.41050, 2.5, 2.06225], atol=1e-5)
    with_profile = scan_to_xyz(np.full((1, 1, 3), 0.5, dtype=np.float32), SRGB)
    np.testing.assert_allclose(with_profile[0, 0, 1], 0.2140, atol=1e-3)


def test_grey_is_neutral(rgb: np.ndarray) -> None:
    grey = rgb[:, :, :1]
    lab = lab_from_xyz(scan_to_xyz(grey, None))
    assert np.abs(lab[..., 1:]).max() < 1e-3
    assert np.array_equal(scan_to_xyz(grey[:, :, 0], None), scan_to_xyz(grey, None))
    lab = lab_from_xyz(scan_to_xyz(grey, imagecodecs.cms_profile("gray", gamma=2.2)))
    assert np.abs(lab[..., 1:]).max() < 0.02


def test_cmyk_scan_goes_through_its_profile(profile: bytes) -> None:
    ink = np.random.default_rng(2).random((4, 5, 4))
    lab = shipped("relative").lab_from_inks(ink)
    as_float = scan_to_xyz(ink, profile)
    np.testing.assert_allclose(lab_from_xyz(as_float), lab, atol=0.2)
    counts = np.round(ink * 65535).astype(np.uint16)
    np.testing.assert_allclose(scan_to_xyz(counts, profile), as_float, atol=1e-4)
    # Absolute colours are darker: the tile is not a perfect diffuser.
    bare = np.zeros((1, 1, 4), np.uint8)
    assert scan_to_xyz(bare, profile)[0, 0, 1] == pytest.approx(1.0, abs=1e-3)
    assert scan_to_xyz(bare, profile, intent="absolute")[0, 0, 1] == pytest.approx(0.830, abs=2e-3)


def test_strips_and_threads_never_change_a_value(rgb: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    press, measured = shipped("perceptual"), shipped("absolute")
    lab = np.random.default_rng(3).uniform([0, -60, -60], [100, 60, 60], (37, 50, 3))
    ink = np.random.default_rng(4).random((37, 50, 4))
    whole = (
        scan_to_xyz(rgb, SRGB),
        scan_to_xyz(rgb, None),
        press.inks_from_lab(lab),
        press.lab_from_inks(ink),
        measured.inks_from_lab(lab),
        measured.lab_from_inks(ink, intent="absolute"),
    )
    monkeypatch.setattr("tilefab.colour.transform._STRIP_PIXELS", 150)
    monkeypatch.setattr("tilefab.colour.grid_layout._STRIP_PIXELS", 150)
    for threads in (1, 2, 5):
        again = (
            scan_to_xyz(rgb, SRGB, threads=threads),
            scan_to_xyz(rgb, None, threads=threads),
            press.inks_from_lab(lab, threads=threads),
            press.lab_from_inks(ink, threads=threads),
            measured.inks_from_lab(lab, threads=threads),
            measured.lab_from_inks(ink, intent="absolute", threads=threads),
        )
        assert all(np.array_equal(a, b) for a, b in zip(whole, again, strict=True))


LCMS_INTENTS: dict[Intent, int] = {"perceptual": 0, "relative": 1, "saturation": 2, "absolute": 3}


@pytest.mark.parametrize("intent", ["perceptual", "relative", "saturation", "absolute"])
def test_inks_are_those_of_little_cms(profile: bytes, intent: Intent) -> None:
    """It reads the table trilinearly, so only colours are near each other; at the nodes it is the same."""
    press = shipped(intent)
    lab = np.random.default_rng(5).uniform([30, -15, -12], [80, 18, 25], (30, 40, 3)).astype(np.float32)
    theirs = imagecodecs.cms_transform(
        lab,
        imagecodecs.cms_profile("lab4"),
        profile,
        colorspace="lab",
        outcolorspace="cmyk",
        outdtype="f4",
        intent=LCMS_INTENTS[intent],
    )
    inks = press.inks_from_lab(lab)
    assert np.abs(inks - np.clip(theirs / 100, 0, 1)).mean() < 0.01
    away = delta_e_2000(press.lab_from_inks(inks), press.lab_from_inks(np.clip(theirs / 100, 0, 1)))
    assert away.mean() < 0.2
    assert np.percentile(away, 95) < 0.7


@pytest.mark.parametrize("absolute", [False, True])
def test_colours_are_those_of_little_cms(profile: bytes, absolute: bool) -> None:
    ink = np.random.default_rng(6).random((30, 40, 4)).astype(np.float32)
    lab = shipped("relative").lab_from_inks(ink, intent="absolute" if absolute else "relative")
    theirs = imagecodecs.cms_transform(
        100 * ink,
        profile,
        imagecodecs.cms_profile("lab4"),
        colorspace="cmyk",
        outcolorspace="lab",
        outdtype="f4",
        intent=3 if absolute else 1,
    )
    assert delta_e_2000(lab, theirs).max() < 0.2


@pytest.mark.parametrize("inks", range(1, 9))
@pytest.mark.parametrize("intent", ["perceptual", "relative", "saturation"])
def test_every_number_of_inks_as_the_tables_say(inks: int, intent: Intent) -> None:
    press = made_up(inks, intent)
    assert press.inks == inks
    draw = np.random.default_rng(inks)
    lab = draw.uniform([0, -90, -90], [100, 90, 90], (7, 9, 3))
    np.testing.assert_allclose(press.inks_from_lab(lab), press.to_inks(lab), atol=2e-6)
    ink = draw.random((7, 9, inks))
    relative = press.lab_from_inks(ink)
    np.testing.assert_allclose(relative, press.to_lab(ink), atol=2e-4)
    # Absolute colours are scaled in XYZ by the media white (ICC.1:2010 section 6.3.2).
    scale = np.array(press.white_xyz) / [0.9642, 1.0, 0.8249]
    absolute = xyz_from_lab(press.lab_from_inks(ink, intent="absolute"))
    np.testing.assert_allclose(absolute, xyz_from_lab(relative) * scale, atol=1e-5)
    again = PressTransform(press.to_inks, press.to_lab, press.white_xyz, "absolute")
    of_relative = press.inks_from_lab(lab)
    np.testing.assert_allclose(again.inks_from_lab(lab_from_xyz(xyz_from_lab(lab) * scale)), of_relative, atol=2e-4)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("intent", ["relative", "absolute"])
@pytest.mark.parametrize("inks", [1, 4, 6])
def test_counts_are_within_one_of_floating_point(inks: int, intent: Intent, dtype: type) -> None:
    press = made_up(inks, intent)
    full = np.iinfo(dtype).max
    lab16 = encode_lab16(np.random.default_rng(7).uniform([0, -90, -90], [100, 90, 90], (11, 13, 3)))
    exact = np.rint(full * press.inks_from_lab(decode_lab16(lab16)).astype(np.float64))
    counts = press.counts_from_lab16(dtype)(lab16, threads=2)
    assert counts.dtype == dtype
    assert np.abs(counts - exact).max() <= 1
    colours = press.lab16_from_counts(dtype)(counts, threads=2)
    exact = encode_lab16(press.lab_from_inks(counts / full))
    assert colours.dtype == np.uint16
    assert np.abs(colours.astype(np.int64) - exact).max() <= 1


def test_tables_through_xyz_and_several_grids() -> None:
    press = made_up(3, "relative")
    turn = Matrix(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3))
    # CIELAB turned to XYZ and back by the caller's arithmetic, and a chain that is more than one grid.
    ramp = np.linspace(0.0, 1.0, 3)
    grid = Grid(np.stack(np.meshgrid(ramp, ramp, ramp, indexing="ij"), axis=-1))
    to_inks = ColourTable("xyz", "ink", (Matrix(np.eye(3) / 2.0, np.zeros(3)), turn, grid, turn))
    to_lab = ColourTable("ink", "xyz", (turn, grid, turn, Matrix(2.0 * np.eye(3), np.zeros(3))))
    through_xyz = PressTransform(to_inks, to_lab, press.white_xyz, "relative")
    lab = np.random.default_rng(8).uniform([5, -20, -20], [95, 20, 20], (6, 5, 3))
    inks = through_xyz.inks_from_lab(lab)
    np.testing.assert_allclose(inks, xyz_from_lab(lab) / 2.0, atol=1e-6)
    np.testing.assert_allclose(through_xyz.lab_from_inks(inks), lab, atol=2e-3)
    lab16 = encode_lab16(lab)
    counts = through_xyz.counts_from_lab16(np.uint16)(lab16)
    np.testing.assert_array_equal(counts, np.rint(65535 * through_xyz.inks_from_lab(decode_lab16(lab16))))
    np.testing.assert_allclose(decode_lab16(through_xyz.lab16_from_counts(np.uint16)(counts)), lab, atol=0.1)


def test_white_gets_no_ink_and_the_intents_differ() -> None:
    white = np.array([[[100.0, 0.0, 0.0]]])
    dark = np.array([[[25.0, 0.0, 0.0]]])
    inks = {}
    for intent in ("perceptual", "relative", "saturation", "absolute"):
        press = shipped(intent)
        inks[intent] = press.inks_from_lab(dark)
        if intent != "absolute":
            assert press.inks_from_lab(white).max() < 1e-4
    assert np.abs(inks["perceptual"] - inks["relative"]).max() > 0.01
    assert np.abs(inks["absolute"] - inks["relative"]).max() > 0.01


def test_wrong_profiles_are_explained(profile: bytes, rgb: np.ndarray) -> None:
    with pytest.raises(ProfileError, match="3 channels, but its ICC profile is for CMYK"):
        scan_to_xyz(rgb, profile)
    with pytest.raises(ProfileError, match="CMYK scan carries no ICC profile"):
        scan_to_xyz(np.zeros((2, 2, 4), np.uint8), None)
    with pytest.raises(ProfileError, match="Little CMS can't use"):
        scan_to_xyz(rgb, SRGB[:200])
    with pytest.raises(ProfileError, match="class 'prtr'"):
        press_transform(parse_icc_profile(SRGB, "sRGB"), "relative")


def test_misuse_is_refused() -> None:
    press = shipped("relative")
    with pytest.raises(ValueError, match="intent"):
        shipped("vivid")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="intent"):
        press.lab_from_inks(np.zeros((1, 1, 4)), intent="perceptual")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="threads"):
        press.inks_from_lab(np.zeros((1, 1, 3)), threads=0)
    with pytest.raises(ValueError, match="lab_d50"):
        press.inks_from_lab(np.zeros((4, 3)))
    with pytest.raises(ValueError, match="ink_frac"):
        press.lab_from_inks(np.zeros((4, 4, 3)))
    with pytest.raises(ValueError, match="int32"):
        press.counts_from_lab16(np.int32)
    with pytest.raises(ValueError, match="shape"):
        scan_to_xyz(np.zeros((4, 4, 2), np.uint8), None)
    with pytest.raises(ValueError, match="int32"):
        scan_to_xyz(np.zeros((4, 4, 3), np.int32), None)
    assert press.inks_from_lab(np.zeros((0, 7, 3))).shape == (0, 7, 4)


def test_tables_that_don_t_belong_together_are_refused() -> None:
    three, four = made_up(3, "relative"), made_up(4, "relative")
    with pytest.raises(ValueError, match="same 1 to 8"):
        PressTransform(three.to_inks, four.to_lab, three.white_xyz, "relative")
    with pytest.raises(ValueError, match="go from CIELAB or XYZ"):
        PressTransform(three.to_lab, three.to_lab, three.white_xyz, "relative")
    with pytest.raises(ValueError, match="media white"):
        PressTransform(three.to_inks, three.to_lab, (0.8, 0.0, 0.7), "relative")
