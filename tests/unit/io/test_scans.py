"""Scans and masks of every kind, whole and damaged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import OpenImageIO as oiio
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from tilefab.errors import ImageError
from tilefab.io.scans import read_mask, read_scan, read_weights, scan_facts
from tilefab.types import SizePx

ROWS, COLS = 40, 56
PROFILES = Path(__file__).parents[3] / "profiles"


def picture(channels: int, dtype: str = "u1") -> NDArray[Any]:
    values = np.random.default_rng(1).integers(0, 256, (ROWS, COLS, channels))
    if dtype == "u1":
        return values.astype(np.uint8)
    return (values * 257).astype(np.uint16) if dtype == "u2" else (values / 255).astype(np.float32)


def write_exr(path: Path, pixels: NDArray[np.float32], kind: Any = oiio.FLOAT, names: tuple[str, ...] = ()) -> None:
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    if names:
        spec.channelnames = names
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec), target.geterror()
    assert target.write_image(pixels)
    assert target.close()


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4"])
@pytest.mark.parametrize("layout", ["strips", "tiles", "planes"])
def test_tiff_keeps_every_value(tmp_path: Path, dtype: str, layout: str) -> None:
    pixels, path = picture(3, dtype), tmp_path / "a.tif"
    if layout == "planes":
        tifffile.imwrite(path, np.moveaxis(pixels, 2, 0), photometric="rgb", planarconfig="separate")
    else:
        tiles = {"tile": (16, 16), "compression": "zlib"} if layout == "tiles" else {}
        tifffile.imwrite(path, pixels, photometric="rgb", **tiles)
    scan = read_scan(path)
    assert scan.pixels.dtype == pixels.dtype
    np.testing.assert_array_equal(scan.pixels, pixels)
    assert scan.pixels.flags.c_contiguous
    assert scan.valid.all()
    assert scan.dpi is None
    assert scan.icc_profile is None
    assert scan.notes == ()
    assert scan.path == str(path)


def test_half_floats_become_floats(tmp_path: Path) -> None:
    half = picture(3, "f4").astype(np.float16)
    tifffile.imwrite(tmp_path / "a.tif", half, photometric="rgb")
    write_exr(tmp_path / "a.exr", half.astype(np.float32), oiio.HALF)
    for name in ("a.tif", "a.exr"):
        scan = read_scan(tmp_path / name)
        assert scan.pixels.dtype == np.float32
        np.testing.assert_array_equal(scan.pixels, half.astype(np.float32))


@pytest.mark.parametrize("dtype", ["i2", "u4"])
def test_whole_numbers_of_other_widths_are_no_linear_light(tmp_path: Path, dtype: str) -> None:
    tifffile.imwrite(tmp_path / "a.tif", picture(3).astype(dtype), photometric="rgb")
    assert read_scan(tmp_path / "a.tif").pixels.dtype == np.uint16


def test_only_the_first_of_several_images_is_used(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for brightness in (10, 200):
            file.write(np.full((ROWS, COLS, 3), brightness, np.uint8), photometric="rgb")
    scan = read_scan(tmp_path / "a.tif")
    assert (scan.pixels == 10).all()
    assert scan.notes == ("a.tif holds several images: only the first is used",)


def test_exr_keeps_light_beyond_white(tmp_path: Path) -> None:
    pixels = picture(3, "f4") * 3
    write_exr(tmp_path / "a.exr", pixels)
    np.testing.assert_array_equal(read_scan(tmp_path / "a.exr").pixels, pixels)


def test_png_in_8_and_16_bits(tmp_path: Path) -> None:
    eight, sixteen = picture(3), picture(1, "u2")
    Image.fromarray(eight).save(tmp_path / "a.png")
    Image.fromarray(sixteen[..., 0]).save(tmp_path / "b.png")
    np.testing.assert_array_equal(read_scan(tmp_path / "a.png").pixels, eight)
    scan = read_scan(tmp_path / "b.png")
    assert scan.pixels.dtype == np.uint16
    np.testing.assert_array_equal(scan.pixels, sixteen)


def test_jpeg_comes_near(tmp_path: Path) -> None:
    smooth = np.broadcast_to(np.arange(COLS, dtype=np.uint8)[None, :, None] * 4, (ROWS, COLS, 3))
    Image.fromarray(smooth).save(tmp_path / "a.jpg", quality=98, subsampling=0)
    scan = read_scan(tmp_path / "a.jpg")
    assert scan.pixels.shape == (ROWS, COLS, 3)
    assert np.abs(scan.pixels.astype(int) - smooth).max() <= 6


@pytest.mark.parametrize("ending", ["png", "jpg", "tif"])
def test_resolution_and_profile_are_found(tmp_path: Path, ending: str) -> None:
    profile = imagecodecs.cms_profile("srgb")
    Image.fromarray(picture(3)).save(tmp_path / f"a.{ending}", dpi=(300, 300), icc_profile=profile)
    scan = read_scan(tmp_path / f"a.{ending}")
    assert scan.dpi == pytest.approx(300, abs=0.1)
    assert scan.icc_profile == profile


@pytest.mark.parametrize(
    ("value", "unit", "dpi"),
    [
        (300, "INCH", 300.0),
        (100, "CENTIMETER", 254.0),
        (300, "NONE", None),
        (1, "INCH", None),
        (50_000, "INCH", None),
        (72.009, "INCH", 72.009),
    ],
)
def test_units_of_resolution(tmp_path: Path, value: float, unit: str, dpi: float | None) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, picture(3), photometric="rgb", resolution=(value, value), resolutionunit=unit)
    expected = None if dpi is None else pytest.approx(dpi, rel=1e-5)
    assert read_scan(path).dpi == expected
    assert scan_facts(path).dpi == expected


def test_facts_come_from_the_header(tmp_path: Path) -> None:
    profile = imagecodecs.cms_profile("srgb")
    with_alpha = {"photometric": "rgb", "extrasamples": ["unassalpha"], "iccprofile": profile}
    tifffile.imwrite(tmp_path / "a.tif", picture(4, "u2"), **with_alpha)
    facts = scan_facts(tmp_path / "a.tif")
    assert facts.size == SizePx(ROWS, COLS)
    assert (facts.channels, facts.icc_profile) == (3, profile)
    tifffile.imwrite(tmp_path / "b.tif", picture(4), photometric="separated")
    facts = scan_facts(tmp_path / "b.tif")
    assert (facts.channels, facts.icc_profile) == (4, None)


@pytest.mark.parametrize("ending", ["png", "jpg", "tif"])
def test_gray_is_said_to_be_neutral(tmp_path: Path, ending: str) -> None:
    Image.fromarray(picture(1)[..., 0]).save(tmp_path / f"a.{ending}")
    scan = read_scan(tmp_path / f"a.{ending}")
    assert scan.pixels.shape == (ROWS, COLS, 1)
    assert "grayscale" in scan.notes[0]


@pytest.mark.parametrize(("ending", "channels"), [("png", 2), ("png", 4), ("tif", 2), ("tif", 4), ("exr", 4)])
def test_alpha_becomes_the_mask(tmp_path: Path, ending: str, channels: int) -> None:
    pixels = picture(channels)
    pixels[..., -1] = 255
    pixels[5:15, 8:28, -1] = 0
    path = tmp_path / f"a.{ending}"
    if ending == "exr":
        write_exr(path, (pixels / 255).astype(np.float32))
    else:
        Image.fromarray(pixels).save(path)
    scan = read_scan(path)
    assert scan.pixels.shape == (ROWS, COLS, channels - 1)
    np.testing.assert_array_equal(scan.valid, pixels[..., -1] == 255)
    assert any("alpha" in note and f"{100 * 200 / (ROWS * COLS):.1f} %" in note for note in scan.notes)
    if ending != "exr":
        np.testing.assert_array_equal(scan.pixels[scan.valid], pixels[..., :-1][scan.valid])


def test_half_transparent_is_not_used(tmp_path: Path) -> None:
    pixels = picture(4)
    pixels[..., 3] = 255
    pixels[0, :3, 3] = 254, 128, 1
    Image.fromarray(pixels).save(tmp_path / "a.png")
    assert read_scan(tmp_path / "a.png").valid[0, :4].tolist() == [False, False, False, True]


def test_an_all_transparent_scan_is_refused(tmp_path: Path) -> None:
    pixels = picture(4)
    pixels[..., 3] = 0
    Image.fromarray(pixels).save(tmp_path / "a.png")
    with pytest.raises(ImageError, match="whole scan is transparent"):
        read_scan(tmp_path / "a.png")


@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_cmyk_keeps_its_values_and_profile(tmp_path: Path, dtype: str) -> None:
    pixels, profile = picture(4, dtype), (PROFILES / "demo_ceramic.icc").read_bytes()
    tifffile.imwrite(tmp_path / "a.tif", pixels, photometric="separated", iccprofile=profile)
    scan = read_scan(tmp_path / "a.tif")
    np.testing.assert_array_equal(scan.pixels, pixels)
    assert scan.icc_profile == profile


def test_further_channels_beside_rgb_are_left_out(tmp_path: Path) -> None:
    pixels = picture(5)
    tifffile.imwrite(
        tmp_path / "4.tif", pixels[..., :4].copy(), photometric="rgb", extrasamples=["unspecified"], metadata=None
    )
    tifffile.imwrite(tmp_path / "5.tif", pixels, photometric="rgb", extrasamples=["unspecified"] * 2, metadata=None)
    write_exr(tmp_path / "z.exr", picture(4, "f4"), names=("R", "G", "B", "Z"))
    for name, channels in (("4.tif", 4), ("5.tif", 5), ("z.exr", 4)):
        scan = read_scan(tmp_path / name)
        assert scan.pixels.shape == (ROWS, COLS, 3)
        assert scan.valid.all()
        assert f"{name} has {channels} channels: only R, G and B are used" in scan.notes
    np.testing.assert_array_equal(read_scan(tmp_path / "4.tif").pixels, pixels[..., :3])


def test_channels_of_no_colour_are_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", picture(2), photometric="minisblack", extrasamples=["unspecified"])
    with pytest.raises(ImageError, match="2 channels"):
        read_scan(tmp_path / "a.tif")
    tifffile.imwrite(tmp_path / "b.tif", picture(6), photometric="separated", extrasamples=["unspecified"] * 2)
    with pytest.raises(ImageError, match="6 channels"):
        read_scan(tmp_path / "b.tif")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none_are_refused_with_their_place(tmp_path: Path, value: float) -> None:
    pixels = picture(3, "f4")
    pixels[7, 9, 1] = pixels[11, 2, 0] = value
    write_exr(tmp_path / "a.exr", pixels)
    with pytest.raises(ImageError, match=r"2 pixels are NaN or infinite, the first at row 7, column 9"):
        read_scan(tmp_path / "a.exr")


def test_numbers_that_are_none_don_t_matter_where_transparent(tmp_path: Path) -> None:
    pixels = np.dstack([picture(3, "f4"), np.ones((ROWS, COLS, 1), np.float32)])
    pixels[7, 9] = np.nan, 1, 1, 0
    write_exr(tmp_path / "a.exr", pixels)
    scan = read_scan(tmp_path / "a.exr")
    assert np.isfinite(scan.pixels).all()
    assert np.argwhere(~scan.valid).tolist() == [[7, 9]]


def test_negative_light_is_none(tmp_path: Path) -> None:
    pixels = picture(3, "f4") + np.float32(0.1)
    pixels[3, 4, 2] = -0.25
    write_exr(tmp_path / "a.exr", pixels)
    scan = read_scan(tmp_path / "a.exr")
    assert scan.pixels[3, 4, 2] == 0
    assert scan.pixels.min() == 0
    assert "1 pixels with negative values" in scan.notes[0]


def _whole(tmp_path: Path, ending: str) -> Path:
    path = tmp_path / f"whole.{ending}"
    if ending == "exr":
        write_exr(path, picture(3, "f4"))
    elif ending == "tiled.tif":
        tifffile.imwrite(path, picture(3), photometric="rgb", tile=(16, 16), compression="zlib")
    elif ending == "lzw.tif":
        tifffile.imwrite(path, picture(3, "u2"), photometric="rgb", compression="lzw", predictor=True)
    else:
        Image.fromarray(picture(3)).save(path)
    return path


@pytest.mark.parametrize("share", [0.97, 0.8, 0.5, 0.2, 0.02, 0.0])
@pytest.mark.parametrize("ending", ["tif", "tiled.tif", "lzw.tif", "png", "jpg", "exr"])
def test_a_file_cut_short_is_refused(tmp_path: Path, ending: str, share: float) -> None:
    whole = _whole(tmp_path, ending).read_bytes()
    path = tmp_path / f"cut.{ending}"
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(ImageError) as caught:
        read_scan(path)
    assert caught.value.message.startswith(f"{path}: damaged or not an image: ")
    assert caught.value.message.endswith("scan or export it again")
    assert "\n" not in caught.value.message
    assert caught.value.exit_code == 4
    assert caught.value.path == str(path)


@pytest.mark.parametrize("read", [read_scan, scan_facts, lambda path: read_mask(path, (ROWS, COLS))])
def test_what_is_no_image_is_refused(tmp_path: Path, read: Any) -> None:
    with pytest.raises(ImageError, match=r"absent\.tif: there is no such file"):
        read(tmp_path / "absent.tif")
    with pytest.raises(ImageError, match="is a folder"):
        read(tmp_path)
    (tmp_path / "a.tif").write_text("schema_version = 1\n" * 40)
    with pytest.raises(ImageError, match="not an image"):
        read(tmp_path / "a.tif")
    (tmp_path / "a.xyz").write_bytes(bytes(100))
    with pytest.raises(ImageError, match="not an image"):
        read(tmp_path / "a.xyz")


@pytest.mark.parametrize("kind", ["gray", "rgb", "gray16", "float", "bits", "gray+alpha"])
def test_white_of_a_mask_is_not_used(tmp_path: Path, kind: str) -> None:
    bad = np.zeros((ROWS, COLS), dtype=bool)
    bad[10:20, 30:] = True
    path = tmp_path / "mask.tif"
    if kind == "bits":
        Image.fromarray(bad).save(path)
    elif kind == "float":
        tifffile.imwrite(path, bad.astype(np.float32))
    elif kind == "gray16":
        tifffile.imwrite(path, bad.astype(np.uint16) * 40_000)
    elif kind == "rgb":
        tifffile.imwrite(path, np.repeat(bad[..., None], 3, axis=2).astype(np.uint8) * 255, photometric="rgb")
    elif kind == "gray":
        tifffile.imwrite(path, bad.astype(np.uint8) * 200)
    else:
        both = np.stack([bad.astype(np.uint8) * 255, np.full((ROWS, COLS), 255, np.uint8)], axis=2)
        tifffile.imwrite(path, both, photometric="minisblack", extrasamples=["unassalpha"])
    np.testing.assert_array_equal(read_mask(path, (ROWS, COLS)), ~bad)


def test_gray_of_a_mask_up_to_half_is_used(tmp_path: Path) -> None:
    levels = np.tile(np.arange(256, dtype=np.uint8), (4, 1))
    tifffile.imwrite(tmp_path / "mask.tif", levels)
    assert read_mask(tmp_path / "mask.tif", (4, 256)).sum(axis=1).tolist() == [128] * 4


def test_a_mask_must_be_as_large_as_its_scan(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "mask.tif", np.zeros((ROWS, COLS), np.uint8))
    with pytest.raises(ImageError, match=f"mask has {COLS} x {ROWS} pixels but its scan 30 x 20"):
        read_mask(tmp_path / "mask.tif", (20, 30))


def test_a_mask_must_leave_something(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "mask.tif", np.full((ROWS, COLS), 255, np.uint8))
    with pytest.raises(ImageError, match="leaves nothing"):
        read_mask(tmp_path / "mask.tif", (ROWS, COLS))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_scan_marked_as_turned_is_turned_upright_as_pillow_does(tmp_path: Path, orientation: int) -> None:
    from PIL import Image, ImageOps

    picture = np.random.default_rng(8).integers(0, 255, (12, 20, 3)).astype(np.uint8)
    path = tmp_path / "turned.tif"
    tifffile.imwrite(path, picture, photometric="rgb", extratags=[(274, "H", 1, orientation, True)])
    with Image.open(path) as image:
        upright = np.asarray(ImageOps.exif_transpose(image))
    scan = read_scan(path)
    assert np.array_equal(scan.pixels, upright)
    assert scan.pixels.flags.c_contiguous
    facts = scan_facts(path)
    assert (facts.size.rows, facts.size.cols) == upright.shape[:2]
    assert any("turned upright" in note for note in scan.notes) == (orientation != 1)


def test_a_cmyk_jpeg_is_refused_for_its_colours_would_change(tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "cmyk.jpg"
    Image.new("CMYK", (8, 8)).save(path)
    with pytest.raises(ImageError, match="CMYK JPEG"):
        read_scan(path)


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4"])
@pytest.mark.parametrize("channels", [1, 3])
def test_weights_are_the_grey_of_an_image(tmp_path: Path, dtype: str, channels: int) -> None:
    grey = np.arange(256, dtype=np.uint8).reshape(8, 32)
    values = {"u1": grey, "u2": grey.astype(np.uint16) * 257, "f4": (grey / 255).astype(np.float32)}[dtype]
    pixels = np.repeat(values[..., None], channels, axis=2)
    tifffile.imwrite(tmp_path / "w.tif", pixels, photometric="rgb" if channels == 3 else "minisblack")
    weights = read_weights(tmp_path / "w.tif", (8, 32))
    assert weights.dtype == np.uint8
    np.testing.assert_array_equal(weights, grey)


def test_weights_without_a_value_or_beyond_the_scale_are_bounded(tmp_path: Path) -> None:
    write_exr(tmp_path / "w.exr", np.array([[[np.nan], [np.inf], [-np.inf], [7.0], [-1.0]]], dtype=np.float32))
    assert read_weights(tmp_path / "w.exr", (1, 5)).tolist() == [[0, 255, 0, 255, 0]]


def test_weights_must_be_as_large_as_their_scan(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "w.tif", np.zeros((ROWS, COLS), np.uint8))
    with pytest.raises(ImageError, match=f"image of weights has {COLS} x {ROWS} pixels but its scan 30 x 20"):
        read_weights(tmp_path / "w.tif", (20, 30))


def test_a_tall_scan_is_read_as_a_low_one(tmp_path: Path) -> None:
    """Scans are gone through in bands; what is wrong or transparent in a later band counts as well."""
    pixels = np.full((1100, 3, 4), 0.5, dtype=np.float32)
    pixels[..., 3] = 1
    pixels[700, 1, 0] = -1
    pixels[1050, 2, 3] = 0
    pixels[1050, 2, 1] = np.nan
    write_exr(tmp_path / "a.exr", pixels, names=("R", "G", "B", "A"))
    scan = read_scan(tmp_path / "a.exr")
    assert np.argwhere(~scan.valid).tolist() == [[1050, 2]]
    assert any("1 pixels with negative values" in note for note in scan.notes)
    assert scan.pixels[700, 1].tolist() == [0, 0.5, 0.5]
    assert not scan.pixels[1050, 2].any()
    pixels[800, 0, 2] = np.inf
    pixels[900, 0, 2] = np.inf
    write_exr(tmp_path / "b.exr", pixels, names=("R", "G", "B", "A"))
    with pytest.raises(ImageError, match="2 pixels are NaN or infinite, the first at row 800, column 0"):
        read_scan(tmp_path / "b.exr")
