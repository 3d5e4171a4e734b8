"""Print files of every number of inks, read back by programs that did not write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import tifffile

from tilefab.io.faces import PrintTags, read_print_pixels, write_print_tiff
from tilefab.io.tiff_inks import make_separated


@pytest.mark.parametrize("compression", ["none", "lzw", "deflate"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("inks", range(1, 9))
def test_every_number_of_inks(tmp_path: Path, inks: int, dtype: Any, compression: str) -> None:
    pixels = np.random.default_rng(inks).integers(0, np.iinfo(dtype).max + 1, (90, 70, inks)).astype(dtype)
    names = tuple(f"Ink {ink}" for ink in range(inks))
    path = tmp_path / "chart.tif"
    write_print_tiff(path, pixels, PrintTags(360.0, None, names, "chart", compression))
    with tifffile.TiffFile(path) as file:
        assert len(file.pages) == 1
        page = file.pages[0]
        np.testing.assert_array_equal(page.asarray().reshape(pixels.shape), pixels)
        assert page.photometric == tifffile.PHOTOMETRIC.SEPARATED
        assert page.samplesperpixel == inks
        assert page.extrasamples == ()
        assert page.tags[332].value == (1 if inks == 4 else 2)
        raw = page.tags[333].value
        assert (raw.encode() if isinstance(raw, str) else raw).rstrip(b"\0") == "\0".join(names).encode()
        assert page.tags[334].value == inks
        assert page.tags["XResolution"].value == (360, 1)
        assert "InterColorProfile" not in page.tags
    config = oiio.ImageSpec()
    config.attribute("oiio:RawColor", 1)
    source = oiio.ImageInput.open(str(path), config)
    spec = source.spec()
    assert (spec.height, spec.width, spec.nchannels) == pixels.shape
    read = source.read_image(0, 0, 0, inks, oiio.UINT8 if dtype == np.uint8 else oiio.UINT16)
    source.close()
    np.testing.assert_array_equal(np.asarray(read).reshape(pixels.shape), pixels)
    np.testing.assert_array_equal(read_print_pixels(path).reshape(pixels.shape), pixels)


@pytest.mark.parametrize(("inks", "names"), [(9, 9), (4, 3)])
def test_inks_and_names_that_don_t_fit(tmp_path: Path, inks: int, names: int) -> None:
    with pytest.raises(ValueError):
        write_print_tiff(
            tmp_path / "x.tif", np.zeros((4, 4, inks), np.uint8), PrintTags(72.0, None, ("a",) * names, "chart")
        )


def test_bigtiff_is_turned_too(tmp_path: Path) -> None:
    pixels = np.arange(5 * 4 * 6, dtype=np.uint8).reshape(5, 4, 6)
    path = tmp_path / "big.tif"
    tifffile.imwrite(
        path, pixels, bigtiff=True, byteorder="<", photometric="minisblack", planarconfig="contig", metadata=None
    )
    make_separated(path)
    with tifffile.TiffFile(path) as file:
        assert file.is_bigtiff
        assert file.pages[0].photometric == tifffile.PHOTOMETRIC.SEPARATED
        assert file.pages[0].extrasamples == ()
        np.testing.assert_array_equal(file.pages[0].asarray(), pixels)


def test_what_is_no_tiff(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"MM\0*" + bytes(20))
    with pytest.raises(ValueError):
        make_separated(tmp_path / "x")
