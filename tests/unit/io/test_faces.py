"""Print files and previews, read back by programs that did not write them."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

import tilefab
from tilefab.errors import ImageError, OutputError
from tilefab.io.faces import (
    PrintTags,
    check_preview_path,
    pixel_hash,
    read_print_pixels,
    write_preview,
    write_print_tiff,
)

PROFILE = (Path(__file__).parents[3] / "profiles" / "demo_ceramic.icc").read_bytes()
INKS = ("Blue", "Brown", "Yellow", "Black")
CODE = "tilefab face=7 seed=3 at=-5,9 size=90x70 map=00 job=11"


def inks(dtype: Any, rows: int = 90, cols: int = 70) -> NDArray[Any]:
    random = np.random.default_rng(5)
    return random.integers(0, np.iinfo(dtype).max + 1, (rows, cols, 4)).astype(dtype)


def tags(**changes: Any) -> PrintTags:
    return PrintTags(**{"dpi": 360.0, "icc_profile": PROFILE, "ink_names": INKS, "description": CODE} | changes)


@pytest.mark.parametrize("compression", ["none", "lzw", "deflate"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_print_file_says_and_holds_everything(tmp_path: Path, dtype: Any, compression: str) -> None:
    pixels, path = inks(dtype), tmp_path / "face.tif"
    write_print_tiff(path, pixels, tags(compression=compression))
    with tifffile.TiffFile(path) as file:
        assert len(file.pages) == 1
        page = file.pages[0]
        np.testing.assert_array_equal(page.asarray(), pixels)
        assert page.photometric == tifffile.PHOTOMETRIC.SEPARATED
        assert page.planarconfig == tifffile.PLANARCONFIG.CONTIG
        assert page.bitspersample == 8 * np.dtype(dtype).itemsize
        assert (page.imagelength, page.imagewidth, page.samplesperpixel) == (90, 70, 4)
        assert page.extrasamples == ()
        assert page.compression == {"none": 1, "lzw": 5, "deflate": 8}[compression]
        assert page.tags["InterColorProfile"].value == PROFILE
        assert page.tags[332].value == 1
        raw_names = page.tags[333].value
        assert (raw_names.encode() if isinstance(raw_names, str) else raw_names).rstrip(b"\0") == b"\0".join(
            name.encode() for name in INKS
        )
        assert page.tags[333].count == sum(len(name) + 1 for name in INKS)
        assert page.tags[334].value == 4
        assert page.tags["XResolution"].value == page.tags["YResolution"].value == (360, 1)
        assert page.tags["ResolutionUnit"].value == 2
        assert page.description == CODE
        assert page.software == f"tilefab {tilefab.__version__}"
    np.testing.assert_array_equal(read_print_pixels(path), pixels)


@pytest.mark.parametrize("compression", ["none", "lzw", "deflate"])
def test_pillow_reads_it_as_cmyk(tmp_path: Path, compression: str) -> None:
    pixels = inks(np.uint8)
    write_print_tiff(tmp_path / "face.tif", pixels, tags(compression=compression))
    with Image.open(tmp_path / "face.tif") as image:
        assert image.mode == "CMYK"
        assert image.size == (70, 90)
        assert tuple(float(v) for v in image.info["dpi"]) == (360.0, 360.0)
        assert image.info["icc_profile"] == PROFILE
        np.testing.assert_array_equal(np.asarray(image), pixels)


@pytest.mark.parametrize("dpi", [75.0, 254.5, 360.33, 2400.0])
def test_resolution_is_kept(tmp_path: Path, dpi: float) -> None:
    write_print_tiff(tmp_path / "face.tif", inks(np.uint8), tags(dpi=dpi))
    with Image.open(tmp_path / "face.tif") as image:
        assert float(image.info["dpi"][0]) == pytest.approx(dpi, rel=1e-6)


def test_a_large_face_lies_in_many_strips(tmp_path: Path) -> None:
    pixels = inks(np.uint16, 700, 300)
    write_print_tiff(tmp_path / "face.tif", pixels, tags(compression="lzw"))
    with tifffile.TiffFile(tmp_path / "face.tif") as file:
        assert len(file.pages[0].dataoffsets) > 5
    np.testing.assert_array_equal(read_print_pixels(tmp_path / "face.tif"), pixels)


def test_the_same_face_gives_the_same_file(tmp_path: Path) -> None:
    for name in ("a.tif", "b.tif"):
        write_print_tiff(tmp_path / name, inks(np.uint8), tags(compression="deflate"))
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_the_hash_is_that_of_little_endian_pixels_in_reading_order() -> None:
    pixels = inks(np.uint16, 8, 6)
    expected = hashlib.sha256(pixels.astype("<u2").tobytes()).hexdigest()
    assert pixel_hash(pixels) == expected
    assert pixel_hash(pixels.astype(">u2")) == expected
    assert pixel_hash(np.asfortranarray(pixels)) == expected
    changed = pixels.copy()
    changed[7, 5, 3] ^= 1
    assert pixel_hash(changed) != expected


@pytest.mark.parametrize("compression", ["none", "lzw", "deflate"])
def test_a_damaged_file_gives_other_pixels_or_an_image_error(tmp_path: Path, compression: str) -> None:
    pixels, path = inks(np.uint8, 20, 16), tmp_path / "face.tif"
    # No profile: else nearly every byte of so small a file would be its.
    write_print_tiff(path, pixels, tags(compression=compression, icc_profile=PROFILE[:132]))
    whole = path.read_bytes()
    refused = 0
    for cut in range(0, len(whole), 97):
        path.write_bytes(whole[:cut])
        try:
            same = np.array_equal(read_print_pixels(path), pixels)
        except ImageError as error:
            assert str(path) in error.message  # noqa: PT017
            refused += 1
            continue
        assert not same, f"cut to {cut} bytes of {len(whole)}"
    assert refused > 5
    random = np.random.default_rng(2)
    for _ in range(150):
        damaged = bytearray(whole)
        for place in random.integers(0, len(whole), 3):
            damaged[place] ^= 1 << int(random.integers(8))
        path.write_bytes(damaged)
        try:
            read_print_pixels(path)
        except ImageError as error:
            assert str(path) in error.message  # noqa: PT017


def test_what_is_no_print_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.tif").write_text("not a picture")
    for path in (tmp_path / "absent.tif", tmp_path / "text.tif", tmp_path):
        with pytest.raises(ImageError, match="can't be read back"):
            read_print_pixels(path)


def test_a_face_that_can_t_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError("24576 requested and 100 written")

    monkeypatch.setattr(tifffile, "imwrite", full)
    with pytest.raises(OutputError, match="is the disk full"):
        write_print_tiff(tmp_path / "face.tif", inks(np.uint8), tags())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", [".png", ".PNG", ".jpg", ".jpeg", ".tif", ".tiff"])
def test_previews_open_anywhere(tmp_path: Path, ending: str) -> None:
    ramp = np.arange(60, dtype=np.uint8)[:, None, None] * np.array([4, 3, 2], dtype=np.uint8)
    rgb = np.ascontiguousarray(np.broadcast_to(ramp, (60, 44, 3)))
    path = tmp_path / f"proof{ending}"
    write_preview(path, rgb, 72.0)
    with Image.open(io.BytesIO(path.read_bytes())) as image:
        assert image.mode == "RGB"
        assert image.size == (44, 60)
        assert float(image.info["dpi"][0]) == pytest.approx(72.0, abs=0.02)
        worst = np.abs(np.asarray(image).astype(int) - rgb).max()
    assert worst <= (8 if "jp" in ending else 0)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("name", ["proof.bmp", "proof", "proof.exr", "proof.png.txt"])
def test_other_endings_are_refused_before_any_work(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputError, match="unknown picture format"):
        check_preview_path(tmp_path / name)
    with pytest.raises(OutputError, match="unknown picture format"):
        write_preview(tmp_path / name, np.zeros((2, 2, 3), np.uint8), 72.0)
    assert list(tmp_path.iterdir()) == []


def test_a_preview_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="a file of this name is in the way"):
        write_preview(tmp_path / "file" / "proof.png", np.zeros((2, 2, 3), np.uint8), 72.0)
