"""Images through a press profile or a device link, to print data."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import Intent, PressTransform, black_channel, lab_from_xyz, scan_to_xyz
from tilefab.colour.grid_bake import bake
from tilefab.colour.grid_layout import MOST_CHANNELS
from tilefab.colour.grid_table import CompiledTable, compile_table
from tilefab.colour.press_counts import InkUse, limit_counts
from tilefab.colour.spaces import XYZ_D50_FROM_RGB_LIN, rgb_lin_from_srgb
from tilefab.colour.stages import ColourTable, Float64Array
from tilefab.errors import ImageError, OutputError, ProfileError
from tilefab.io.atomic import refuse_overwriting
from tilefab.io.faces import PrintTags, write_print_tiff
from tilefab.io.icc import IccProfile, channels_of, read_icc_profile
from tilefab.io.icc_tables import link_table
from tilefab.io.ink_images import read_ink_image
from tilefab.io.press_profile import link_ink_names, press_transform
from tilefab.io.scans import Scan, read_scan
from tilefab.pipeline.plan import check_scan_profile
from tilefab.pipeline.progress import Progress
from tilefab.types import Array

RGB_NODES = 65
"""Nodes on each axis where the way from RGB to inks is sampled."""

_UNKNOWN_DPI = 72.0
_STRIP_PIXELS = 1 << 20
_SUFFIXES = (".tif", ".tiff")
_STAGES = ("Reading the image", "Converting to inks", "Writing the print data")

Convert = Callable[[Array, Array, int], None]
"""Writes what becomes of pixels into counts, both (rows, cols, channels), on some threads."""


@dataclass(frozen=True)
class ApplySettings:
    """How an image becomes print data.

    Attributes
    ----------
    bits
        8 or 16; None for as many as the image has, and 16 for floating point.
    ink_limit_percent
        Most ink of a pixel, above 0; None for none but the profile's or link's own.
    dpi
        Resolution to state; None for the image's.
    threads
        None for all cores; never changes a pixel.
    """

    bits: int | None = None
    ink_limit_percent: float | None = None
    dpi: float | None = None
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.bits not in (None, 8, 16):
            raise ValueError(f"{self.bits} bits: print data has 8 or 16")
        if self.ink_limit_percent is not None and not 0.0 < self.ink_limit_percent <= 100.0 * MOST_CHANNELS:
            raise ValueError(f"an ink limit of {self.ink_limit_percent} % is not above 0 and up to 800 %")


@dataclass(frozen=True)
class ApplyReport:
    """What became of an image.

    Attributes
    ----------
    output
        The print data.
    rows, cols, dpi, bits
        Its size and resolution, and bits of an ink.
    ink_names
        In channel order.
    mean_ink_percent
        Of each ink, over all pixels.
    max_total_ink_percent
        Largest total ink of a pixel.
    share_limited
        Share of pixels that were reduced to the ink limit.
    mpx_per_second
        Million pixels converted in a second, without reading and writing.
    notes
        What the operator should know, a sentence each.
    """

    output: str
    rows: int
    cols: int
    dpi: float
    bits: int
    ink_names: tuple[str, ...]
    mean_ink_percent: tuple[float, ...]
    max_total_ink_percent: float
    share_limited: float
    mpx_per_second: float
    notes: tuple[str, ...]


def apply_profile(
    image: Path,
    output: Path,
    profile_path: Path,
    progress: Progress,
    *,
    intent: Intent = "perceptual",
    source_profile: Path | None = None,
    settings: ApplySettings | None = None,
) -> ApplyReport:
    """Separate an RGB or gray image for a press.

    Parameters
    ----------
    image
        Anything that `read_scan` reads. Its colours are those of ``source_profile``, else of the embedded profile;
        without either, whole numbers are sRGB and floating point is linear light. Where it is transparent, no ink
        is laid.
    output
        TIFF to write, whole or not at all.
    profile_path
        Press profile of 1 to 8 inks; it is embedded.
    progress
        Told of the progress.
    intent
        Rendering intent; "absolute" takes the image's white for a perfect diffuser.
    source_profile
        Profile of the image's device.
    settings
        See `ApplySettings`.

    Raises
    ------
    ImageError, ProfileError
        If the image or a profile can't be used.
    OutputError
        If ``output`` is one of the files that are read, is no TIFF by its name, or can't be written.
    """
    settings = settings or ApplySettings()
    _check_output(output, (image, profile_path, source_profile))
    profile = read_icc_profile(profile_path)
    if profile.device_class == "link":
        raise ProfileError(f"{profile_path}: that is a device link: use --link", path=str(profile_path))
    transform = press_transform(profile, intent)
    progress.stage(_STAGES[0], 0.0)
    scan = read_scan(image)
    progress.stage(_STAGES[0], 1.0)
    channels = scan.pixels.shape[2]
    if channels not in (1, 3):
        raise ImageError(
            f"{image}: has {channels} channels, but a press profile is given RGB or gray; make a device link from its "
            "inks (tilefab profile link) and use --link",
            path=str(image),
        )
    source = _source_profile(image, channels, scan, source_profile)
    if scan.pixels.dtype.kind == "f":
        convert = _float_way(transform, source)
    else:
        table = _sampled(transform, source, channels)
        convert = _through(compile_table(table, scan.pixels.dtype, _dtype(scan.pixels, settings)))
    black = black_channel(profile.ink_names, transform.lab_from_inks(np.eye(transform.inks)[np.newaxis])[0])
    made = _convert((scan.pixels, scan.valid), convert, transform.inks, black, settings, progress)
    dpi = settings.dpi or scan.dpi
    return _write(made, (image, output), profile, profile.ink_names, dpi, scan.notes, progress)


def apply_link(
    image: Path,
    output: Path,
    link_path: Path,
    progress: Progress,
    *,
    profile_path: Path | None = None,
    settings: ApplySettings | None = None,
) -> ApplyReport:
    """Convert print data, or RGB, through a device link.

    Parameters
    ----------
    image
        A separated TIFF of the link's inks, or an 8 or 16 bit image where the link begins with RGB or gray.
    output
        TIFF to write, whole or not at all.
    link_path
        Device link from and to 1 to 8 channels.
    progress
        Told of the progress.
    profile_path
        Profile of the press that the link leads to, to embed and to take the inks' names from. None embeds none, for
        a link doesn't hold it.
    settings
        See `ApplySettings`.

    Raises
    ------
    ImageError, ProfileError
        If the image, the link or the profile can't be used, or don't fit.
    OutputError
        If ``output`` is one of the files that are read, is no TIFF by its name, or can't be written.
    """
    settings = settings or ApplySettings()
    _check_output(output, (image, link_path, profile_path))
    link = read_icc_profile(link_path)
    if link.device_class != "link":
        raise ProfileError(f"{link_path}: that is no device link: use --profile", path=str(link_path))
    table = link_table(link)
    inputs, inks = link.channels, channels_of(link.pcs)
    if table.target != "ink" or table.source not in ("ink", "rgb", "gray") or max(inputs, inks) > MOST_CHANNELS:
        raise ProfileError(
            f"{link_path}: leads from {link.colour_space} to {link.pcs}, but print data takes a link from RGB, gray or "
            "1 to 8 inks to 1 to 8 inks: choose another",
            path=str(link_path),
        )
    profile = None if profile_path is None else read_icc_profile(profile_path)
    if profile is not None and (profile.device_class != "prtr" or profile.channels != inks):
        raise ProfileError(
            f"{profile_path}: is no profile of a press with the {inks} inks of {link_path.name}: choose its own",
            path=str(profile_path),
        )
    progress.stage(_STAGES[0], 0.0)
    valid: NDArray[np.bool_] | None
    if table.source == "ink":
        print_data = read_ink_image(image)
        pixels, valid, dpi, notes = print_data.pixels, None, print_data.dpi, print_data.notes
    else:
        scan = read_scan(image)
        pixels, valid, dpi, notes = scan.pixels, scan.valid, scan.dpi, scan.notes
    progress.stage(_STAGES[0], 1.0)
    if pixels.shape[2] != inputs or pixels.dtype.kind == "f":
        raise ImageError(
            f"{image}: has {pixels.shape[2]} channels of {pixels.dtype}, but {link_path.name} takes {inputs} of 8 or "
            f"16 bits ({link.colour_space}): give an image made for it",
            path=str(image),
        )
    names = link_ink_names(link) if profile is None else profile.ink_names
    convert = _through(compile_table(table, pixels.dtype, _dtype(pixels, settings)))
    made = _convert((pixels, valid), convert, inks, black_channel(names), settings, progress)
    return _write(made, (image, output), profile, names, settings.dpi or dpi, notes, progress)


@dataclass(frozen=True, eq=False)
class _PrintData:
    """Counts (rows, cols, inks), the ink they take, and how long they took."""

    counts: Array
    use: InkUse
    seconds: float


def _convert(
    source: tuple[Array, NDArray[np.bool_] | None],
    convert: Convert,
    inks: int,
    black: int | None,
    settings: ApplySettings,
    progress: Progress,
) -> _PrintData:
    """Convert pixels, and leave bare what is not valid; only whole numbers are held of the whole image."""
    pixels, valid = source
    rows, cols = pixels.shape[:2]
    counts = np.empty((rows, cols, inks), _dtype(pixels, settings))
    threads = settings.threads or os.cpu_count() or 1
    # Kernels are compiled or loaded by then, which is no part of the speed.
    corner = np.empty((1, 1, inks), counts.dtype)
    convert(pixels[:1, :1], corner, 1)
    limit_counts(corner, settings.ink_limit_percent, black)
    begin = time.perf_counter()
    step = max(1, threads * _STRIP_PIXELS // cols)
    for top in range(0, rows, step):
        progress.stage(_STAGES[1], top / rows)
        strip = counts[top : top + step]
        convert(pixels[top : top + step], strip, threads)
        if valid is not None and not valid[top : top + step].all():
            strip[~valid[top : top + step]] = 0
    use = limit_counts(counts, settings.ink_limit_percent, black, threads=threads)
    seconds = time.perf_counter() - begin
    progress.stage(_STAGES[1], 1.0)
    return _PrintData(counts, use, seconds)


def _write(
    made: _PrintData,
    files: tuple[Path, Path],
    profile: IccProfile | None,
    names: tuple[str, ...],
    dpi: float | None,
    notes: tuple[str, ...],
    progress: Progress,
) -> ApplyReport:
    """Write the print data of an image, both named by ``files``, and report."""
    image, output = files
    if dpi is None:
        dpi = _UNKNOWN_DPI
        notes = (*notes, f"{image.name} doesn't state its resolution: {dpi:g} dpi is written; say it with --dpi")
    progress.stage(_STAGES[2], 0.0)
    text = f"tilefab profile apply: {image.name}".encode("ascii", "replace").decode()
    write_print_tiff(output, made.counts, PrintTags(dpi, None if profile is None else profile.data, names, text))
    progress.stage(_STAGES[2], 1.0)
    rows, cols = made.counts.shape[:2]
    return ApplyReport(
        output=str(output),
        rows=rows,
        cols=cols,
        dpi=dpi,
        bits=8 * made.counts.dtype.itemsize,
        ink_names=names,
        mean_ink_percent=tuple(round(100.0 * mean, 3) for mean in made.use.mean),
        max_total_ink_percent=round(100.0 * made.use.largest_total, 3),
        share_limited=round(made.use.share_limited, 6),
        mpx_per_second=round(rows * cols / 1e6 / max(made.seconds, 1e-9), 1),
        notes=notes,
    )


def _check_output(output: Path, read: tuple[Path | None, ...]) -> None:
    if output.suffix.lower() not in _SUFFIXES:
        raise OutputError(
            f"{output}: unknown format {output.suffix or '(no ending)'}; print data is a TIFF: end the name in .tif",
            path=str(output),
        )
    refuse_overwriting(output, read)


def _dtype(pixels: Array, settings: ApplySettings) -> np.dtype[Any]:
    bits = settings.bits or (8 if pixels.dtype == np.uint8 else 16)
    return np.dtype(np.uint8 if bits == 8 else np.uint16)


def _source_profile(image: Path, channels: int, scan: Scan, path: Path | None) -> bytes | None:
    """Profile that the image's colours are known by, or None."""
    if path is None:
        check_scan_profile(image, channels, scan.icc_profile)
        return scan.icc_profile
    profile = read_icc_profile(path)
    wanted = {1: "GRAY", 3: "RGB"}[channels]
    if profile.device_class not in ("scnr", "mntr", "spac", "prtr") or profile.colour_space != wanted:
        raise ProfileError(
            f"{path}: a profile of class {profile.device_class} for {profile.colour_space}, but {image.name} is "
            f"{wanted}: give the profile of the device that the image is from",
            path=str(path),
        )
    return profile.data


def _sampled(transform: PressTransform, source: bytes | None, channels: int) -> ColourTable:
    """The way from an image's whole numbers to inks, sampled into one grid."""

    def inks_of(values: Float64Array) -> Float64Array:
        if source is not None:
            xyz = scan_to_xyz(values[np.newaxis].astype(np.float32), source)
        else:
            rgb_lin = rgb_lin_from_srgb(np.repeat(values, 3, axis=1) if channels == 1 else values)
            xyz = (rgb_lin @ XYZ_D50_FROM_RGB_LIN.T)[np.newaxis]
        return np.asarray(transform.inks_from_lab(lab_from_xyz(xyz))[0], dtype=np.float64)

    if channels == 1:
        return bake(inks_of, "gray", "ink", 1)
    return bake(inks_of, "rgb", "ink", 3, nodes=RGB_NODES)


def _through(compiled: CompiledTable) -> Convert:
    def convert(strip: Array, out: Array, threads: int) -> None:
        compiled.apply(strip, threads=threads, out=out)

    return convert


def _float_way(transform: PressTransform, source: bytes | None) -> Convert:
    """Floating point: every pixel by itself, for its range is not known."""

    def convert(strip: Array, out: Array, threads: int) -> None:
        lab = lab_from_xyz(scan_to_xyz(strip, source, threads=threads))
        inks = transform.inks_from_lab(lab, threads=threads)
        out[:] = np.rint(inks * np.float32(np.iinfo(out.dtype).max))

    return convert
