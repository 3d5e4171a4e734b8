"""Layers keep every bit of every pixel, through every format that can hold them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import tifffile
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from PIL import Image, ImageCms

from tilefab.errors import ImageError, OutputError
from tilefab.io.layers import Layer, check_layer_path, read_layer, write_layer

SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def some_pixels(channels: int, dtype: str, seed: int = 0) -> NDArray[Any]:
    random = np.random.default_rng(seed)
    kind = np.dtype(dtype)
    if kind.kind == "f":
        return (random.standard_normal((9, 7, channels)) * 50).astype(kind)
    limits = np.iinfo(kind)
    return random.integers(limits.min, limits.max, size=(9, 7, channels), endpoint=True, dtype=kind)


def layer_of(pixels: NDArray[Any], names: tuple[str, ...] | None = None, **facts: Any) -> Layer:
    colours = ("R", "G", "B") if pixels.shape[2] >= 3 else ("R", "G") if pixels.shape[2] == 2 else ("Y",)
    made = (*colours, *(f"channel{k}" for k in range(len(colours), pixels.shape[2])))
    return Layer("made.tif", pixels, names or made, **facts)


@pytest.mark.parametrize(
    ("suffix", "dtypes", "channels"),
    [
        (".png", ("uint8", "uint16"), (1, 3)),
        (
            ".tif",
            ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float16", "float32", "float64"),
            (1, 2, 3, 4, 5, 12),
        ),
        (".TIFF", ("uint16",), (3,)),
        (".exr", ("float16", "float32", "uint32"), (1, 2, 3, 4, 5, 12)),
    ],
)
def test_what_is_written_is_read_back(
    tmp_path: Path, suffix: str, dtypes: tuple[str, ...], channels: tuple[int, ...]
) -> None:
    for dtype in dtypes:
        for count in channels:
            pixels = some_pixels(count, dtype, count)
            path = tmp_path / f"{dtype}_{count}{suffix}"
            assert write_layer(path, pixels, layer_of(pixels, dpi=300.0)) == ()
            read = read_layer(path)
            assert read.pixels.dtype == pixels.dtype
            assert_array_equal(read.pixels, pixels)
            assert read.alpha is None
            assert read.dpi == pytest.approx(300, abs=0.02)
            # And once more, as what it now is.
            again = tmp_path / f"again_{dtype}_{count}{suffix}"
            write_layer(again, read.pixels, read)
            assert_array_equal(read_layer(again).pixels, pixels)


def test_names_of_channels_stay_in_an_exr(tmp_path: Path) -> None:
    pixels = some_pixels(4, "float32")
    names = ("R", "G", "B", "height.Z")
    write_layer(tmp_path / "a.exr", pixels, Layer("x.exr", pixels, names))
    read = read_layer(tmp_path / "a.exr")
    assert read.channels == names
    assert_array_equal(read.pixels, pixels)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
def test_profile_and_resolution_go_along(tmp_path: Path, suffix: str) -> None:
    pixels = some_pixels(3, "uint8")
    notes = write_layer(tmp_path / f"a{suffix}", pixels, layer_of(pixels, dpi=254.0, icc_profile=SRGB))
    read = read_layer(tmp_path / f"a{suffix}")
    assert read.icc_profile == SRGB
    assert read.dpi == pytest.approx(254, abs=0.02)
    assert len(notes) == (suffix == ".jpg")


def test_what_a_format_cannot_hold_is_told(tmp_path: Path) -> None:
    floats = some_pixels(3, "float32")
    notes = write_layer(tmp_path / "a.exr", floats, layer_of(floats, icc_profile=SRGB))
    assert notes == ("a.exr doesn't hold the colour profile of made.tif: its format can't",)
    smooth = np.full((40, 40, 3), (120, 100, 80), dtype=np.uint8)
    (note,) = write_layer(tmp_path / "a.jpg", smooth, layer_of(smooth))
    assert "only nearly" in note
    assert np.abs(read_layer(tmp_path / "a.jpg").pixels.astype(int) - smooth).max() <= 2


@pytest.mark.parametrize(
    ("name", "channels", "dtype", "match"),
    [
        ("a.png", 3, "float32", r"PNG holds gray or RGB of 8 or 16 bits, but made.tif has 3 channels of float32"),
        ("a.png", 5, "uint8", "5 channels of uint8; use .tif"),
        ("a.png", 2, "uint8", "2 channels"),
        ("a.jpg", 3, "uint16", "JPG holds gray or RGB of 8 bits"),
        ("a.jpeg", 4, "uint8", "4 channels"),
        ("a.exr", 3, "uint16", "half or single floats.*use .tif"),
        ("a.exr", 1, "float64", "1 channel of float64"),
        ("a.gif", 3, "uint8", "unknown image format .gif; use .png"),
        ("a", 3, "uint8", "no ending"),
    ],
)
def test_a_format_that_cannot_hold_it_is_refused(
    tmp_path: Path, name: str, channels: int, dtype: str, match: str
) -> None:
    pixels = some_pixels(channels, dtype)
    for action in (
        lambda: check_layer_path(tmp_path / name, layer_of(pixels)),
        lambda: write_layer(tmp_path / name, pixels, layer_of(pixels)),
    ):
        with pytest.raises(OutputError, match=match):
            action()
    assert list(tmp_path.iterdir()) == []


def test_pixels_unlike_the_layer_are_a_mistake(tmp_path: Path) -> None:
    pixels = some_pixels(3, "uint8")
    for wrong in (pixels[..., :2], pixels.astype(np.uint16), pixels[..., 0]):
        with pytest.raises(ValueError, match="aren't like"):
            write_layer(tmp_path / "a.tif", wrong, layer_of(pixels))


@pytest.mark.parametrize("suffix", [".png", ".tif", ".exr"])
@pytest.mark.parametrize("channels", [2, 4])
def test_alpha_is_kept_and_can_be_taken_off(tmp_path: Path, suffix: str, channels: int) -> None:
    dtype = "float32" if suffix == ".exr" else "uint16"
    pixels = np.abs(some_pixels(channels, dtype))
    full = 1 if dtype == "float32" else 65535
    pixels[..., -1] = full
    pixels[2, 3, -1], pixels[4, 4, -1] = 0, 0.5 * full
    names = ("Y", "A") if channels == 2 else ("R", "G", "B", "A")
    layer = layer_of(pixels, names, alpha=channels - 1, unassociated=suffix != ".exr")
    write_layer(tmp_path / f"a{suffix}", pixels, layer)
    read = read_layer(tmp_path / f"a{suffix}")
    assert_array_equal(read.pixels, pixels)
    assert (read.alpha, read.channels[-1]) == (channels - 1, "A")
    opaque, valid = read.opaque()
    assert_array_equal(opaque.pixels, pixels[..., :-1])
    assert opaque.alpha is None
    assert opaque.channels == read.channels[:-1]
    assert sorted(map(tuple, np.argwhere(~valid).tolist())) == [(2, 3), (4, 4)]
    check_layer_path(tmp_path / f"b{suffix}", opaque)


def test_without_alpha_all_is_opaque() -> None:
    layer = layer_of(some_pixels(3, "uint8"))
    same, valid = layer.opaque()
    assert same is layer
    assert valid.all()


def test_an_image_without_an_opaque_pixel_is_refused() -> None:
    pixels = np.zeros((4, 4, 4), dtype=np.uint8)
    with pytest.raises(ImageError, match="whole image is transparent"):
        layer_of(pixels, ("R", "G", "B", "A"), alpha=3).opaque()


def test_cmyk_stays_cmyk(tmp_path: Path) -> None:
    pixels = some_pixels(4, "uint8")
    tifffile.imwrite(tmp_path / "a.tif", pixels, photometric="separated", planarconfig="contig")
    read = read_layer(tmp_path / "a.tif")
    assert_array_equal(read.pixels, pixels)
    assert read.channels == ("C", "M", "Y", "K")
    assert read.alpha is None
    write_layer(tmp_path / "b.tif", read.pixels, read)
    with tifffile.TiffFile(tmp_path / "b.tif") as file:
        assert file.pages[0].photometric == tifffile.PHOTOMETRIC.SEPARATED
        assert_array_equal(file.pages[0].asarray(), pixels)


def test_images_lying_on_their_side_are_turned_upright(tmp_path: Path) -> None:
    pixels = some_pixels(1, "uint8")
    spec: Any = oiio.ImageSpec(7, 9, 1, oiio.UINT8)
    spec.attribute("Orientation", 6)
    target: Any = oiio.ImageOutput.create(str(tmp_path / "a.tif"))
    assert target.open(str(tmp_path / "a.tif"), spec)
    assert target.write_image(pixels)
    target.close()
    read = read_layer(tmp_path / "a.tif")
    assert_array_equal(read.pixels[..., 0], np.rot90(pixels[..., 0], -1))
    assert read.notes == ("a.tif was turned upright, as its file says",)


def test_of_several_images_the_first_is_read(tmp_path: Path) -> None:
    first, second = some_pixels(3, "uint8"), some_pixels(3, "uint8", 1)
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(first, photometric="rgb")
        file.write(second, photometric="rgb")
    read = read_layer(tmp_path / "a.tif")
    assert_array_equal(read.pixels, first)
    assert "several images" in read.notes[0]


@pytest.mark.parametrize(
    ("content", "match"), [(None, "no such file"), (b"", "not an image"), (b"\x89PNG\r\n\x1a\nrubbish", "damaged")]
)
def test_what_is_no_image_is_refused(tmp_path: Path, content: bytes | None, match: str) -> None:
    if content is not None:
        (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ImageError, match=match):
        read_layer(tmp_path / "a.png")


def test_truncated_images_are_refused(tmp_path: Path) -> None:
    Image.fromarray(some_pixels(3, "uint8")).save(tmp_path / "a.png")
    whole = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.raises(ImageError, match="damaged"):
        read_layer(tmp_path / "a.png")


def test_numbers_that_cannot_be_kept_are_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 4), dtype=np.complex64))
    with pytest.raises(ImageError):
        read_layer(tmp_path / "a.tif")
