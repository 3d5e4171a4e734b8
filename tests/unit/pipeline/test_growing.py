"""Textures grown from files: what is compared, what is refused, what is written."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from PIL import Image, ImageCms

from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.errors import ImageError, OutputError, ProfileError, SynthesisError, TextureMapError
from tilefab.io.faces import write_preview
from tilefab.io.layers import Layer, read_layer, write_layer
from tilefab.io.source_map_file import load_source_map
from tilefab.pipeline import growing
from tilefab.pipeline.growing import GrowFiles, GrowReport, GrowSettings, apply_map, grow_texture
from tilefab.pipeline.growing_colours import comparison_of, preview_of
from tilefab.pipeline.progress import Silent
from tilefab.synthesis import METHODS, SynthesisRequest
from tilefab.types import SizePx

SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
SETTINGS = GrowSettings(SizePx(40, 36), seed=3, method="quilting", threads=1)
NAMES = {1: ("Y",), 3: ("R", "G", "B"), 5: ("R", "G", "B", "channel3", "channel4")}


def pebbles(channels: int, dtype: str, seed: int = 0) -> NDArray[Any]:
    """(30, 33, channels) smooth noise over the whole range of a type, or 0 to 1."""
    random = np.random.default_rng(seed)
    coarse = random.random((10, 11, channels))
    fine = np.kron(coarse, np.ones((3, 3, 1))) * 0.8 + random.random((30, 33, channels)) * 0.2
    kind = np.dtype(dtype)
    return fine.astype(kind) if kind.kind == "f" else (fine * np.iinfo(kind).max).astype(kind)


def layer_of(pixels: NDArray[Any], **facts: Any) -> Layer:
    return Layer("made.tif", pixels, NAMES[pixels.shape[2]], **facts)


def everything(pixels: NDArray[Any]) -> NDArray[np.bool_]:
    return np.ones(pixels.shape[:2], dtype=bool)


@pytest.fixture
def files(tmp_path: Path) -> GrowFiles:
    """An RGB exemplar of 8 bits."""
    pixels = pebbles(3, "uint8")
    write_layer(tmp_path / "in.png", pixels, layer_of(pixels, dpi=300.0, icc_profile=SRGB))
    return GrowFiles(tmp_path / "in.png", tmp_path / "out.png")


def grown(files: GrowFiles, settings: GrowSettings = SETTINGS, **watching: Any) -> GrowReport:
    return grow_texture(files, settings, Silent(), **watching)


# What is compared


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32", "float64"])
def test_colours_are_compared_in_lab(dtype: str) -> None:
    pixels = pebbles(3, dtype)
    compared = comparison_of(layer_of(pixels), everything(pixels))
    as_scanned = pixels if np.dtype(dtype).kind == "u" else pixels.astype(np.float32)
    expected = lab_from_xyz(scan_to_xyz(as_scanned, None))
    assert compared.is_lab
    assert compared.image.dtype == np.float32
    assert_allclose(compared.image, expected, atol=0.003)
    assert compared.notes == ()


def test_the_embedded_profile_counts() -> None:
    pixels = pebbles(3, "uint8")
    wide = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    with pytest.raises(ProfileError, match=r"made\.tif"):
        comparison_of(layer_of(pixels, icc_profile=wide), everything(pixels))
    plain, named = (
        comparison_of(layer_of(pixels, icc_profile=profile), everything(pixels)).image for profile in (None, SRGB)
    )
    assert_allclose(plain, named, atol=0.5)
    with pytest.raises(ProfileError, match="embedded profile"):
        comparison_of(layer_of(pixels, icc_profile=b"rubbish"), everything(pixels))


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_gray_is_compared_by_lightness(dtype: str) -> None:
    pixels = pebbles(1, dtype)
    compared = comparison_of(layer_of(pixels), everything(pixels))
    as_colour = comparison_of(layer_of(np.repeat(pixels, 3, axis=2)), everything(pixels))
    assert compared.image.shape == (30, 33, 1)
    assert not compared.is_lab
    assert_allclose(compared.image[..., 0], as_colour.image[..., 0], atol=0.01)


@pytest.mark.parametrize(("channels", "dtype"), [(5, "uint8"), (1, "int16"), (3, "uint32"), (5, "float32")])
def test_anything_else_is_scaled_channel_by_channel(channels: int, dtype: str) -> None:
    pixels = pebbles(channels, dtype)
    pixels[..., 0] = pixels[..., 0] // 8 + 5 if pixels.dtype.kind != "f" else pixels[..., 0] * 1000 - 500
    valid = everything(pixels)
    pixels[0, 0], valid[0, 0] = 0, False
    compared = comparison_of(layer_of(pixels), valid)
    for channel in range(channels):
        values = compared.image[..., channel][valid]
        assert (values.min(), values.max()) == (0, 100)
        given = pixels[..., channel][valid].astype(np.float64)
        assert_allclose(values, 100 * (given - given.min()) / np.ptp(given), rtol=1e-5, atol=1e-5)
    assert compared.image.min() >= 0
    assert len(compared.notes) == (channels < 5)


def test_heights_are_no_light() -> None:
    heights = pebbles(1, "float32") * 40 - 20
    compared = comparison_of(layer_of(heights), everything(heights))
    assert (compared.image.min(), compared.image.max()) == (0, 100)
    assert "compared by their range" in compared.notes[0]


def test_one_value_is_compared_as_one_value() -> None:
    flat = np.full((20, 20, 5), 7, dtype=np.uint8)
    assert not comparison_of(layer_of(flat), everything(flat)).image.any()


def test_what_is_no_number_is_a_hole() -> None:
    pixels = pebbles(3, "float32")
    pixels[4, 5, 1], pixels[9, 9, 0] = np.nan, np.inf
    compared = comparison_of(layer_of(pixels), everything(pixels))
    assert np.argwhere(~compared.valid).tolist() == [[4, 5], [9, 9]]
    assert np.isfinite(compared.image).all()
    assert compared.notes == ("made.tif: what is NaN or infinite, 2 of its pixels, is treated as a hole",)
    pixels[:] = np.nan
    with pytest.raises(ImageError, match="no usable pixel is a number"):
        comparison_of(layer_of(pixels), everything(pixels))


def test_light_far_above_white_keeps_its_contrast() -> None:
    pixels = pebbles(3, "float32") * 50
    compared = comparison_of(layer_of(pixels), everything(pixels))
    assert "brighter than white" in compared.notes[0]
    assert (compared.image[..., 0] > 99.9).mean() < 0.05
    assert np.ptp(compared.image[..., 0]) > 30


def test_one_layer_is_compared_like_another() -> None:
    heights = pebbles(1, "float32") * 40 - 10
    whole = comparison_of(layer_of(heights), everything(heights))
    part = np.clip(heights, 0.2, 0.9)
    alone = comparison_of(layer_of(part), everything(part))
    alike = comparison_of(layer_of(part), everything(part), like=whole)
    assert not np.allclose(alone.image, alike.image, atol=1)
    (low, high) = whole.ranges[0]
    assert_allclose(alike.image, (part - low) / (high - low) * 100, atol=1e-4)
    light = pebbles(3, "float32") * 8
    whole = comparison_of(layer_of(light), everything(light))
    assert whole.white > 1
    assert_array_equal(comparison_of(layer_of(light[:9]), everything(light[:9]), like=whole).image, whole.image[:9])
    for other, against in ((light, alone), (heights, whole), (pebbles(3, "float32").astype(np.uint32), whole)):
        with pytest.raises(ImageError, match="aren't of the kind"):
            comparison_of(layer_of(other), everything(other), like=against)


def test_previews_look_like_the_exemplar() -> None:
    pixels = pebbles(3, "uint8")
    picture = preview_of(comparison_of(layer_of(pixels), everything(pixels)))
    assert np.abs(picture.astype(int) - pixels).max() <= 1
    gray = pebbles(1, "uint16")
    picture = preview_of(comparison_of(layer_of(gray), everything(gray)))
    assert np.abs(picture.astype(int) - gray.astype(int) // 257).max() <= 1


# What is written


def places_of(pixels: NDArray[Any], valid: NDArray[np.bool_] | None = None) -> NDArray[np.int32]:
    """What the method makes of an exemplar."""
    compared = comparison_of(layer_of(pixels), everything(pixels) if valid is None else valid)
    request = SynthesisRequest(compared.image, compared.valid, SETTINGS.size, SETTINGS.seed, toroidal=False)
    return METHODS["quilting"](request).source


@pytest.mark.parametrize(
    ("suffix", "channels", "dtype"),
    [
        (".png", 3, "uint8"),
        (".png", 1, "uint16"),
        (".exr", 3, "float32"),
        (".exr", 3, "float16"),
        (".tif", 5, "uint16"),
    ],
)
def test_a_texture_is_exact_copies(tmp_path: Path, suffix: str, channels: int, dtype: str) -> None:
    pixels = pebbles(channels, dtype)
    write_layer(tmp_path / f"in{suffix}", pixels, layer_of(pixels, dpi=300.0))
    report = grown(GrowFiles(tmp_path / f"in{suffix}", tmp_path / f"out{suffix}"))
    out = read_layer(tmp_path / f"out{suffix}")
    assert out.pixels.dtype == pixels.dtype
    assert_array_equal(out.pixels, pixels.reshape(-1, channels)[places_of(pixels)])
    assert out.dpi == pytest.approx(300, abs=0.02)
    assert (report.rows, report.cols, report.complete) == (40, 36, True)
    assert 0 < report.coverage <= 1
    assert 0 < report.mean_seam_delta_e < report.worst_seam_delta_e


def test_profile_layers_map_and_preview_go_along(files: GrowFiles, tmp_path: Path) -> None:
    heights = pebbles(1, "float32", 1) * 9
    gloss = np.concatenate([pebbles(3, "uint16", 2), pebbles(1, "uint16", 2)], axis=2)
    write_layer(tmp_path / "height.exr", heights, layer_of(heights))
    write_layer(tmp_path / "gloss.png", gloss, Layer("x.png", gloss, ("R", "G", "B", "A"), 3, unassociated=True))
    layers = (
        (tmp_path / "height.exr", tmp_path / "new" / "height_out.exr"),
        (tmp_path / "gloss.png", tmp_path / "gloss_out.png"),
    )
    wanted = replace(files, layers=layers, map=tmp_path / "places.npz", preview=tmp_path / "preview.png")
    report = grown(wanted)
    kept = load_source_map(tmp_path / "places.npz")
    assert (kept.exemplar, kept.method, kept.seed, kept.toroidal, kept.complete) == (
        SizePx(30, 33),
        "quilting",
        3,
        False,
        True,
    )
    assert read_layer(files.output).icc_profile == SRGB
    assert_array_equal(read_layer(layers[0][1]).pixels, heights.reshape(-1, 1)[kept.source])
    assert_array_equal(read_layer(layers[1][1]).pixels, gloss.reshape(-1, 4)[kept.source])
    with Image.open(tmp_path / "preview.png") as picture:
        seen = np.asarray(picture.convert("RGB")).astype(int)
    assert np.abs(seen - read_layer(files.output).pixels).max() <= 2
    assert report.layers == tuple(str(target) for _, target in layers)
    # Applied later, the map makes the same of a layer.
    applied = apply_map(tmp_path / "places.npz", tmp_path / "gloss.png", tmp_path / "later.png")
    assert (tmp_path / "later.png").read_bytes() == layers[1][1].read_bytes()
    assert (applied.rows, applied.cols, applied.channels, applied.kind) == (40, 36, 4, "uint16")


def test_holes_are_never_shown(tmp_path: Path) -> None:
    pixels = np.concatenate([pebbles(3, "uint8"), np.full((30, 33, 1), 255, np.uint8)], axis=2)
    pixels[12:15, 3:9, 3] = 0
    pixels[pixels[..., 3] == 0, :3] = (255, 0, 255)
    write_layer(tmp_path / "in.png", pixels, Layer("x.png", pixels, ("R", "G", "B", "A"), 3, unassociated=True))
    mask = np.zeros((30, 33, 1), dtype=np.uint8)
    mask[:, 28:] = 255
    write_layer(tmp_path / "mask.png", mask, layer_of(mask))
    files = GrowFiles(tmp_path / "in.png", tmp_path / "out.png", mask=tmp_path / "mask.png", map=tmp_path / "m.npz")
    report = grown(files)
    out = read_layer(tmp_path / "out.png")
    assert out.channels == ("R", "G", "B")
    assert not (out.pixels == (255, 0, 255)).all(axis=2).any()
    places = load_source_map(tmp_path / "m.npz").source
    assert (places % 33 < 28).all()
    assert any("transparent" in note for note in report.notes)


def test_weights_count(files: GrowFiles, tmp_path: Path) -> None:
    weights = np.zeros((30, 33, 1), dtype=np.uint8)
    weights[8:20, 8:20] = 255
    write_layer(tmp_path / "w.png", weights, layer_of(weights))
    grown(replace(files, map=tmp_path / "plain.npz"))
    grown(replace(files, map=tmp_path / "held.npz", weights=tmp_path / "w.png"))
    plain, held = (load_source_map(tmp_path / name).source for name in ("plain.npz", "held.npz"))
    assert (plain != held).any()


def test_a_mask_may_not_leave_nothing(files: GrowFiles, tmp_path: Path) -> None:
    mask = np.full((30, 33, 1), 255, dtype=np.uint8)
    write_layer(tmp_path / "mask.png", mask, layer_of(mask))
    with pytest.raises(ImageError, match="leaves nothing"):
        grown(replace(files, mask=tmp_path / "mask.png"))
    mask[2:4, 2:4] = 0
    write_layer(tmp_path / "mask.png", mask, layer_of(mask))
    with pytest.raises(SynthesisError, match=r"in\.png: no texture can be grown from it by quilting: .*8 x 8"):
        grown(replace(files, mask=tmp_path / "mask.png"))
    assert not files.output.exists()


@pytest.mark.parametrize(("rows", "cols"), [(15, 40), (40, 15)])
def test_an_exemplar_too_small_is_refused(tmp_path: Path, rows: int, cols: int) -> None:
    pixels = np.zeros((rows, cols, 3), dtype=np.uint8)
    write_layer(tmp_path / "in.png", pixels, layer_of(pixels))
    with pytest.raises(ImageError, match="needs 16 a side"):
        grown(GrowFiles(tmp_path / "in.png", tmp_path / "out.png"))


def test_exemplars_of_one_colour_of_16_px_and_larger_than_the_result(tmp_path: Path) -> None:
    for pixels in (np.full((16, 16, 3), 90, np.uint8), np.full((200, 150, 3), 90, np.uint8), pebbles(3, "uint8")):
        write_layer(tmp_path / "in.png", pixels, layer_of(pixels))
        report = grown(GrowFiles(tmp_path / "in.png", tmp_path / "out.png"), replace(SETTINGS, size=SizePx(20, 18)))
        assert read_layer(tmp_path / "out.png").size == SizePx(20, 18)
        if not np.ptp(pixels):
            assert report.worst_seam_delta_e == 0


def test_layers_and_masks_of_another_size_are_refused(files: GrowFiles, tmp_path: Path) -> None:
    other = pebbles(1, "uint8")[:-1]
    write_layer(tmp_path / "small.png", other, layer_of(other))
    with pytest.raises(ImageError, match="33 x 29 pixels but its exemplar 33 x 30"):
        grown(replace(files, layers=((tmp_path / "small.png", tmp_path / "o.png"),)))
    for wanted in (replace(files, mask=tmp_path / "small.png"), replace(files, weights=tmp_path / "small.png")):
        with pytest.raises(ImageError, match="33 x 29 pixels but its scan 33 x 30"):
            grown(wanted)
    grown(replace(files, map=tmp_path / "m.npz"))
    with pytest.raises(ImageError, match="grown from 33 x 30"):
        apply_map(tmp_path / "m.npz", tmp_path / "small.png", tmp_path / "o.png")
    with pytest.raises(TextureMapError, match="no such file"):
        apply_map(tmp_path / "none.npz", tmp_path / "small.png", tmp_path / "o.png")
    assert not (tmp_path / "o.png").exists()


def test_nothing_that_is_read_is_written_over(files: GrowFiles, tmp_path: Path) -> None:
    wrong: list[tuple[GrowFiles, str]] = [
        (replace(files, output=files.exemplar), "one of the files to read"),
        (replace(files, preview=files.exemplar), "one of the files to read"),
        (replace(files, mask=tmp_path / "out.png"), "one of the files to read"),
        (replace(files, layers=((files.exemplar, files.output),)), "named twice"),
        (replace(files, preview=files.output), "named twice"),
        (replace(files, map=tmp_path / "m.png"), r"end its name in \.npz"),
        (replace(files, preview=tmp_path / "p.exr"), "unknown picture format"),
        (replace(files, output=tmp_path / "out.exr"), "EXR holds"),
        (replace(files, output=tmp_path / "out"), "no ending"),
        (replace(files, layers=((files.exemplar, tmp_path / "l.exr"),)), "EXR holds"),
    ]
    for wanted, match in wrong:
        with pytest.raises(OutputError, match=match):
            grown(wanted)
    grown(replace(files, map=tmp_path / "m.npz"))
    for path in (files.exemplar, tmp_path / "m.npz"):
        with pytest.raises(OutputError, match="one of the files to read"):
            apply_map(tmp_path / "m.npz", files.exemplar, path)


def test_what_cannot_be_written_is_told_before_the_work(
    files: GrowFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").write_text("")
    grown(files)
    before = files.output.read_bytes()

    def never(*_: Any) -> Any:
        raise AssertionError("it was grown")

    monkeypatch.setitem(METHODS, "quilting", never)
    wrong: list[tuple[GrowFiles, str]] = [
        (replace(files, output=tmp_path / "folder.png"), "not a plain file is in the way"),
        (replace(files, output=tmp_path / "file" / "out.png"), "a file of this name is in the way"),
        (replace(files, layers=((files.exemplar, tmp_path / "folder.png"),)), "not a plain file is in the way"),
        (replace(files, map=tmp_path / "file" / "m.npz"), "a file of this name is in the way"),
        (replace(files, preview=tmp_path / "folder.png"), "not a plain file is in the way"),
    ]
    for wanted, match in wrong:
        with pytest.raises(OutputError, match=match):
            grown(wanted)
    assert files.output.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.png", "in.png", "out.png"]


def test_a_size_that_a_method_cannot_make_is_explained(files: GrowFiles) -> None:
    small = replace(SETTINGS, method="uniform", size=SizePx(12, 15), toroidal=True)
    with pytest.raises(SynthesisError, match="needs 20 pixels a side, not 15 x 12; choose another size or method"):
        grown(files, small)


def test_layers_tell_what_was_unusual(files: GrowFiles, tmp_path: Path) -> None:
    Image.fromarray(pebbles(1, "uint8")[::-1, ::-1, 0]).save(tmp_path / "turned.tif", tiffinfo={274: 3})
    report = grown(replace(files, layers=((tmp_path / "turned.tif", tmp_path / "l.tif"),)))
    assert any("turned.tif was turned upright" in note for note in report.notes)


def test_the_map_outlives_a_texture_that_could_not_be_written(
    files: GrowFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, *_: Any) -> Any:
        raise OutputError(f"{path}: the disk is full", path=str(path))

    monkeypatch.setattr(growing, "write_layer", full)
    with pytest.raises(OutputError, match="disk is full"):
        grown(replace(files, map=tmp_path / "m.npz"))
    assert load_source_map(tmp_path / "m.npz").complete


def test_results_may_be_written_anew(files: GrowFiles) -> None:
    grown(files)
    first = files.output.read_bytes()
    grown(files)
    assert files.output.read_bytes() == first
    grown(files, replace(SETTINGS, seed=4))
    assert files.output.read_bytes() != first


# Watching


class Watching(Silent):
    """Keeps what it is told."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[tuple[str, float]] = []

    def stage(self, name: str, share: float) -> None:
        self.told.append((name, share))


def test_stages_begin_and_end(files: GrowFiles) -> None:
    watching = Watching()
    grow_texture(files, SETTINGS, watching)
    names = list(dict.fromkeys(name for name, _ in watching.told))
    assert names == ["Reading the exemplar", "Growing the texture", "Writing"]
    for name in names:
        shares = [share for told, share in watching.told if told == name]
        assert (shares[0], shares[-1]) == (0, 1)
        assert shares == sorted(shares)


def test_stopped_it_writes_what_there_is(files: GrowFiles, tmp_path: Path) -> None:
    heights = pebbles(1, "float32", 1)
    write_layer(tmp_path / "height.exr", heights, layer_of(heights))
    wanted = replace(
        files,
        layers=((tmp_path / "height.exr", tmp_path / "height_out.exr"),),
        map=tmp_path / "m.npz",
        preview=tmp_path / "p.png",
    )
    asked: list[None] = []

    def stopping() -> bool:
        asked.append(None)
        return len(asked) >= 5

    report = grown(wanted, stopping=stopping)
    assert len(asked) == 5
    assert not report.complete
    assert any("Stopped before it was finished" in note for note in report.notes)
    kept = load_source_map(tmp_path / "m.npz")
    assert not kept.complete
    assert_array_equal(read_layer(files.output).pixels, read_layer(files.exemplar).pixels.reshape(-1, 3)[kept.source])
    assert_array_equal(read_layer(tmp_path / "height_out.exr").pixels, heights.reshape(-1, 1)[kept.source])
    assert (tmp_path / "p.png").exists()


def test_what_was_being_written_is_removed(files: GrowFiles, tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    wanted = replace(files, map=tmp_path / "b" / "m.npz")
    left = [folder / f".tilefab-{os.getpid()}-x.png" for folder in (tmp_path, tmp_path / "b")]
    for path in left:
        path.touch()
    growing.remove_unfinished(wanted)
    assert not any(path.exists() for path in left)
    assert files.exemplar.exists()


def test_previews_are_written_while_it_works(files: GrowFiles, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    written: list[tuple[int, ...]] = []

    def keep(path: Path, rgb: NDArray[np.uint8], dpi: float) -> None:
        written.append(rgb.shape)
        write_preview(path, rgb, dpi)

    monkeypatch.setattr(growing, "write_preview", keep)
    monkeypatch.setattr(growing, "_PREVIEW_EVERY_S", 0.0)
    monkeypatch.setattr(growing, "_PREVIEW_SHARE", 1e9)
    monkeypatch.setattr(growing, "_PREVIEW_SIDE_PX", 20)
    grown(replace(files, preview=tmp_path / "p.png"))
    assert len(written) > 3
    assert set(written) == {(20, 18, 3)}
    # Seldom enough: one at the beginning, one at the end.
    written.clear()
    monkeypatch.setattr(growing, "_PREVIEW_EVERY_S", 1e9)
    grown(replace(files, preview=tmp_path / "p.png"))
    assert len(written) == 2


def test_a_preview_that_cannot_be_written_costs_no_texture(
    files: GrowFiles, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    tried: list[Path] = []

    def full(path: Path, *_: Any) -> None:
        tried.append(path)
        raise OutputError(f"{path}: the disk is full", path=str(path))

    monkeypatch.setattr(growing, "write_preview", full)
    monkeypatch.setattr(growing, "_PREVIEW_EVERY_S", 0.0)
    report = grown(replace(files, preview=tmp_path / "p.png"))
    assert report.complete
    assert files.output.exists()
    assert len(tried) == 2
    assert any("preview is not up to date" in note and "disk is full" in note for note in report.notes)
