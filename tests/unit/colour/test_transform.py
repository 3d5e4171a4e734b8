"""Scans and inks through Little CMS, held against this project's own arithmetic and tables."""

from pathlib import Path

import imagecodecs
import numpy as np
import pytest

from tilefab.colour.lut import backward_axes
from tilefab.colour.spaces import XYZ_D50_FROM_RGB_LIN, lab_from_xyz, rgb_lin_from_srgb
from tilefab.colour.transform import Intent, PressTransform, scan_to_xyz
from tilefab.errors import ProfileError

SHIPPED = Path(__file__).parents[3] / "profiles" / "demo_ceramic.icc"
SRGB = imagecodecs.cms_profile("srgb")


@pytest.fixture(scope="module")
def profile() -> bytes:
    return SHIPPED.read_bytes()


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
    lab = PressTransform(profile, "relative", 4).lab_from_inks(ink)
    as_float = scan_to_xyz(ink, profile)
    np.testing.assert_allclose(lab_from_xyz(as_float), lab, atol=0.02)
    counts = np.round(ink * 65535).astype(np.uint16)
    np.testing.assert_allclose(scan_to_xyz(counts, profile), as_float, atol=1e-4)
    # Absolute colours are darker: the tile is not a perfect diffuser.
    bare = np.zeros((1, 1, 4), np.uint8)
    assert scan_to_xyz(bare, profile)[0, 0, 1] == pytest.approx(1.0, abs=1e-3)
    assert scan_to_xyz(bare, profile, intent="absolute")[0, 0, 1] == pytest.approx(0.827, abs=2e-3)


def test_strips_and_threads_never_change_a_value(
    profile: bytes, rgb: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    press = PressTransform(profile, "perceptual", 4)
    lab = np.random.default_rng(3).uniform([0, -60, -60], [100, 60, 60], (37, 50, 3))
    ink = np.random.default_rng(4).random((37, 50, 4))
    whole = (
        scan_to_xyz(rgb, SRGB),
        scan_to_xyz(rgb, None),
        press.inks_from_lab(lab),
        press.lab_from_inks(ink),
    )
    monkeypatch.setattr("tilefab.colour.transform._STRIP_PIXELS", 150)
    for threads in (1, 2, 5):
        again = (
            scan_to_xyz(rgb, SRGB, threads=threads),
            scan_to_xyz(rgb, None, threads=threads),
            press.inks_from_lab(lab, threads=threads),
            press.lab_from_inks(ink, threads=threads),
        )
        assert all(np.array_equal(a, b) for a, b in zip(whole, again, strict=True))


@pytest.mark.parametrize(("intent", "tag"), [("relative", b"B2A1"), ("perceptual", b"B2A0")])
def test_inks_are_the_nodes_of_the_profile_s_table(profile: bytes, intent: Intent, tag: bytes) -> None:
    entry = profile.index(tag)
    offset = int.from_bytes(profile[entry + 4 : entry + 8], "big")
    grid = profile[offset + 10]
    begin = offset + 52 + 2 * 3 * 256
    table = np.frombuffer(profile, ">u2", grid**3 * 4, begin).reshape(grid, grid, grid, 4) / 65535.0
    _, axes = backward_axes(grid)
    lab = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)[2:, 8:-8, 8:-8]
    inks = PressTransform(profile, intent, 4).inks_from_lab(lab.reshape(len(lab), -1, 3))
    np.testing.assert_allclose(inks.reshape(*lab.shape[:3], 4), table[2:, 8:-8, 8:-8], atol=2e-3)


def test_white_gets_no_ink_and_the_intents_differ(profile: bytes) -> None:
    white = np.array([[[100.0, 0.0, 0.0]]])
    dark = np.array([[[25.0, 0.0, 0.0]]])
    inks = {}
    for intent in ("perceptual", "relative", "saturation", "absolute"):
        press = PressTransform(profile, intent, 4)
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
    with pytest.raises(ProfileError, match="for RGB"):
        PressTransform(SRGB, "relative", 3)
    with pytest.raises(ProfileError, match="has 4 inks, but 6"):
        PressTransform(profile, "relative", 6)
    with pytest.raises(ProfileError, match="Little CMS can't use"):
        PressTransform(profile[:4000], "relative", 4)
    with pytest.raises(ProfileError, match="nothing known"):
        PressTransform(b"", "relative", 4)


def test_misuse_is_refused(profile: bytes) -> None:
    press = PressTransform(profile, "relative", 4)
    with pytest.raises(ValueError, match="intent"):
        PressTransform(profile, "vivid", 4)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="threads"):
        press.inks_from_lab(np.zeros((1, 1, 3)), threads=0)
    with pytest.raises(ValueError, match="lab_d50"):
        press.inks_from_lab(np.zeros((4, 3)))
    with pytest.raises(ValueError, match="ink_frac"):
        press.lab_from_inks(np.zeros((4, 4, 3)))
    with pytest.raises(ValueError, match="shape"):
        scan_to_xyz(np.zeros((4, 4, 2), np.uint8), None)
    with pytest.raises(ValueError, match="int32"):
        scan_to_xyz(np.zeros((4, 4, 3), np.int32), None)
    assert press.inks_from_lab(np.zeros((0, 7, 3))).shape == (0, 7, 4)
