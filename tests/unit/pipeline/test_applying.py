"""Images through profiles and links to print data, held against the same in floating point."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from tests.icc_samples import INK_NAMES, small_link, small_profile
from tilefab.colour import delta_e_2000, lab_from_xyz, scan_to_xyz
from tilefab.errors import ImageError, OutputError, ProfileError
from tilefab.io.faces import PrintTags, read_print_pixels, write_print_tiff
from tilefab.io.icc import parse_icc_profile, read_icc_profile
from tilefab.io.icc_tables import link_table
from tilefab.io.press_profile import press_transform
from tilefab.pipeline.applying import ApplySettings, apply_link, apply_profile
from tilefab.pipeline.progress import Silent

SHIPPED = Path(__file__).parents[3] / "profiles" / "demo_ceramic.icc"
# Of near greys, which the press can print.
STONE = np.random.default_rng(1).integers(-30, 40, (40, 30, 1)) + np.random.default_rng(2).integers(
    [144, 128, 110], [156, 140, 124], (40, 30, 3)
)


def picture(path: Path, pixels: np.ndarray) -> Path:
    kind = "rgb" if pixels.ndim == 3 else "minisblack"
    tifffile.imwrite(path, pixels, photometric=kind, resolution=(254, 254), resolutionunit="INCH")
    return path


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("bits", [8, 16])
def test_rgb_prints_the_wanted_colours(tmp_path: Path, dtype: Any, bits: int) -> None:
    rgb = (STONE * (257 if dtype == np.uint16 else 1)).astype(dtype)
    out = tmp_path / "out.tif"
    settings = ApplySettings(bits=bits)
    report = apply_profile(
        picture(tmp_path / "in.tif", rgb), out, SHIPPED, Silent(), intent="relative", settings=settings
    )
    counts = read_print_pixels(out)
    assert counts.dtype == (np.uint8 if bits == 8 else np.uint16)
    press = press_transform(read_icc_profile(SHIPPED), "relative")
    wanted = lab_from_xyz(scan_to_xyz(rgb, None))
    printed = press.lab_from_inks(counts / np.iinfo(counts.dtype).max)
    exact = press.lab_from_inks(press.inks_from_lab(wanted))
    assert delta_e_2000(printed, exact).mean() < 0.2
    assert delta_e_2000(printed, exact).max() < 1.5
    assert delta_e_2000(printed, wanted).mean() < 0.5
    assert (report.rows, report.cols, report.dpi, report.bits) == (40, 30, 254.0, bits)
    np.testing.assert_allclose(
        report.mean_ink_percent, 100 * counts.reshape(-1, 4).mean(axis=0) / np.iinfo(counts.dtype).max, atol=1e-3
    )
    with tifffile.TiffFile(out) as file:
        assert file.pages.first.tags["InterColorProfile"].value == SHIPPED.read_bytes()


def test_eight_inks_within_a_limit_whatever_the_threads(tmp_path: Path) -> None:
    profile = tmp_path / "eight.icc"
    profile.write_bytes(small_profile(8, 2))
    source = picture(tmp_path / "in.tif", STONE.astype(np.uint8))
    found = []
    for threads in (1, 3):
        settings = ApplySettings(ink_limit_percent=210.0, threads=threads)
        report = apply_profile(source, tmp_path / "out.tif", profile, Silent(), settings=settings)
        assert report.max_total_ink_percent <= 210.0
        assert report.share_limited > 0
        assert report.ink_names == INK_NAMES
        found.append(read_print_pixels(tmp_path / "out.tif"))
    np.testing.assert_array_equal(*found)
    assert found[0].shape == (40, 30, 8)


def test_gray_is_the_same_as_equal_rgb(tmp_path: Path) -> None:
    gray = STONE[..., 0].astype(np.uint8)
    both = []
    for pixels in (gray, np.repeat(gray[..., np.newaxis], 3, axis=2)):
        apply_profile(picture(tmp_path / "in.tif", pixels), tmp_path / "out.tif", SHIPPED, Silent())
        both.append(read_print_pixels(tmp_path / "out.tif").astype(int))
    assert np.abs(both[0] - both[1]).mean() < 1.0


@pytest.mark.parametrize("inputs", [1, 3, 4, 6])
def test_print_data_through_a_link(tmp_path: Path, inputs: int) -> None:
    link = tmp_path / "a.link"
    link.write_bytes(small_link(inputs, 5, 2))
    pixels = np.random.default_rng(inputs).integers(0, 256, (20, 30, inputs)).astype(np.uint8)
    source, out = tmp_path / "in.tif", tmp_path / "out.tif"
    write_print_tiff(source, pixels, PrintTags(300.0, None, INK_NAMES[:inputs], "in"))
    report = apply_link(source, out, link, Silent(), settings=ApplySettings(bits=16))
    exact = link_table(parse_icc_profile(link.read_bytes(), "link"))(pixels / 255)
    assert np.abs(read_print_pixels(out) - np.rint(65535 * exact)).max() <= 1
    assert (report.dpi, report.ink_names) == (300.0, INK_NAMES[:5])


def test_what_doesn_t_fit_is_explained(tmp_path: Path) -> None:
    source, out = picture(tmp_path / "in.tif", STONE.astype(np.uint8)), tmp_path / "out.tif"
    link = tmp_path / "a.link"
    link.write_bytes(small_link(4, 5, 2))
    with pytest.raises(ProfileError, match="use --link"):
        apply_profile(source, out, link, Silent())
    with pytest.raises(ProfileError, match="use --profile"):
        apply_link(source, out, SHIPPED, Silent())
    with pytest.raises(ImageError, match="RGB, not inks"):
        apply_link(source, out, link, Silent())
    with pytest.raises(OutputError, match="choose another name"):
        apply_profile(source, source, SHIPPED, Silent())
    with pytest.raises(OutputError, match="unknown format"):
        apply_profile(source, tmp_path / "out.psd", SHIPPED, Silent())
    write_print_tiff(source, np.zeros((4, 4, 3), np.uint8), PrintTags(300.0, None, ("a", "b", "c"), "in"))
    with pytest.raises(ImageError, match="has 3 channels"):
        apply_link(source, out, link, Silent())
    with pytest.raises(ProfileError, match="5 inks"):
        apply_link(source, out, link, Silent(), profile_path=SHIPPED)
    assert not out.exists()
