"""Growing a texture from an exemplar's file, and its map of places applied to further layers."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.errors import ImageError, OutputError, SynthesisError
from tilefab.io.atomic import atomic_path, refuse_overwriting, remove_leftovers
from tilefab.io.faces import check_preview_path, write_preview
from tilefab.io.layers import Layer, check_layer_path, read_layer, write_layer
from tilefab.io.scans import read_mask, read_weights
from tilefab.io.source_map_file import SourceMap, check_source_map_path, load_source_map, save_source_map
from tilefab.pipeline.growing_colours import Comparison, comparison_of, preview_of
from tilefab.pipeline.progress import Progress
from tilefab.synthesis import DEFAULT_METHOD, METHODS, Step, SynthesisRequest, SynthesisResult, render
from tilefab.texture.seam_cost import seam_cost
from tilefab.types import Mask, SizePx

SMALLEST_EXEMPLAR_PX = 16
STAGES = ("Reading the exemplar", "Growing the texture", "Writing")
_UNKNOWN_DPI = 72.0
_PREVIEW_SIDE_PX = 2048
_PREVIEW_EVERY_S = 2.0
_PREVIEW_SHARE = 0.1


@dataclass(frozen=True)
class GrowFiles:
    """Files that a texture is grown from, and those to write.

    Attributes
    ----------
    exemplar
        Image of any depth and number of channels; where it is transparent it isn't used.
    output
        The texture: of the exemplar's depth, channels, resolution and profile.
    mask
        White where the exemplar isn't to be used.
    weights
        The brighter, the less may be cut there.
    layers
        Further images of the exemplar's size, and where to write the texture of each.
    map
        Where to keep the map of places.
    preview
        Picture that is written again and again while the texture grows.
    """

    exemplar: Path
    output: Path
    mask: Path | None = None
    weights: Path | None = None
    layers: tuple[tuple[Path, Path], ...] = ()
    map: Path | None = None
    preview: Path | None = None

    @property
    def targets(self) -> tuple[Path, ...]:
        """Every file to write."""
        maybe = (self.output, *(target for _, target in self.layers), self.map, self.preview)
        return tuple(path for path in maybe if path is not None)


@dataclass(frozen=True)
class GrowSettings:
    """How a texture is grown; see `tilefab.synthesis.SynthesisRequest`."""

    size: SizePx
    seed: int = 0
    method: str = DEFAULT_METHOD
    toroidal: bool = False
    feature_px: int | None = None
    fast: bool = False
    threads: int | None = None


@dataclass(frozen=True)
class GrowReport:
    """What was grown.

    Attributes
    ----------
    output, map, layers
        Files written.
    rows, cols
        Size.
    method, seed, toroidal
        How.
    complete
        False if it was stopped.
    seconds
        That the method took.
    coverage
        Share of the exemplar's usable pixels that is shown.
    mean_seam_delta_e, worst_seam_delta_e
        Step of colour across seams, CIE76; of what is no colour, in hundredths of its range.
    notes
        What the user should know, a sentence each.
    """

    output: str
    map: str | None
    layers: tuple[str, ...]
    rows: int
    cols: int
    method: str
    seed: int
    toroidal: bool
    complete: bool
    seconds: float
    coverage: float
    mean_seam_delta_e: float
    worst_seam_delta_e: float
    notes: tuple[str, ...]


def grow_texture(
    files: GrowFiles,
    settings: GrowSettings,
    progress: Progress,
    stopping: Callable[[], bool] = lambda: False,
) -> GrowReport:
    """Grow a texture and write it, its layers and its map.

    Parameters
    ----------
    files, settings
        What is wanted; the method must be one of `tilefab.synthesis.METHODS`.
    progress
        Told of the progress.
    stopping
        Asked after each step: once True, what there is by then is written.

    Raises
    ------
    ImageError, ProfileError
        If an image can't be used.
    SynthesisError
        If nothing can be grown of the exemplar.
    OutputError
        If a file to write is one to read, can't hold what is to be written, or can't be written.
    """
    _check_files(files)
    progress.stage(STAGES[0], 0.0)
    whole = read_layer(files.exemplar)
    exemplar, valid = whole.opaque()
    check_layer_path(files.output, exemplar)
    layers = [(_read_fitting(path, exemplar), target) for path, target in files.layers]
    for layer, target in layers:
        check_layer_path(target, layer)
    compared = _compared(exemplar, _masked(exemplar, valid, files), settings.threads)
    weights = None if files.weights is None else read_weights(files.weights, valid.shape)
    for target in files.targets:
        _try_to_write(target)
    progress.stage(STAGES[0], 1.0)
    notes = [*whole.notes, *(note for layer, _ in layers for note in layer.notes), *compared.notes]
    if whole.alpha is not None:
        notes.append(f"{files.exemplar.name}: {100 * float((~valid).mean()):.1f} % is transparent and not used")
    begin = time.monotonic()
    preview = None if files.preview is None else _Preview(files.preview, compared, exemplar.dpi)
    grown = _grow(files, settings, (compared, weights), progress, _Watcher(progress, stopping, preview))
    seconds = time.monotonic() - begin
    progress.stage(STAGES[1], 1.0)
    notes += grown.notes
    if not grown.complete:
        notes.append("Stopped before it was finished: what is written is as far as it had come")
    progress.stage(STAGES[2], 0.0)
    # The map first: should the disk be full then, all else can be made from it.
    if files.map is not None:
        facts = (settings.method, settings.seed, settings.toroidal, grown.complete, grown.notes)
        save_source_map(files.map, SourceMap(grown.source, exemplar.size, *facts))
    targets = [(exemplar, files.output), *layers]
    for number, (layer, target) in enumerate(targets):
        notes += write_layer(target, render(layer.pixels, grown.source), layer)
        progress.stage(STAGES[2], (number + 1) / (len(targets) + 1))
    if preview is not None:
        notes += preview.finish(grown.source)
    progress.stage(STAGES[2], 1.0)
    seams = seam_cost(grown.source, compared.image, toroidal=settings.toroidal)
    shown = np.zeros(compared.valid.size, dtype=bool)
    shown[grown.source.ravel()] = True
    return GrowReport(
        output=str(files.output),
        map=None if files.map is None else str(files.map),
        layers=tuple(str(target) for _, target in files.layers),
        rows=settings.size.rows,
        cols=settings.size.cols,
        method=settings.method,
        seed=settings.seed,
        toroidal=settings.toroidal,
        complete=grown.complete,
        seconds=round(seconds, 2),
        coverage=round(float(np.count_nonzero(shown) / np.count_nonzero(compared.valid)), 4),
        mean_seam_delta_e=round(seams.mean_delta_e, 3),
        worst_seam_delta_e=round(seams.worst_delta_e, 3),
        notes=tuple(notes),
    )


def remove_unfinished(files: GrowFiles) -> None:
    """Remove what was being written when the work was left behind; files that are whole stay."""
    for folder in {target.parent for target in files.targets}:
        remove_leftovers(folder)


@dataclass(frozen=True)
class AppliedMap:
    """A layer that a kept map was applied to.

    Attributes
    ----------
    output
        File written.
    rows, cols, channels, kind
        Size, number of channels, and type of its numbers.
    notes
        What the user should know, a sentence each.
    """

    output: str
    rows: int
    cols: int
    channels: int
    kind: str
    notes: tuple[str, ...]


def apply_map(map_path: Path, layer_path: Path, output: Path) -> AppliedMap:
    """Make of a further layer of an exemplar what was grown of the exemplar: exact copies of its pixels.

    Raises
    ------
    TextureMapError
        If the map can't be used.
    ImageError
        If the layer can't be read, or isn't of the exemplar's size.
    OutputError
        If ``output`` is one of the files that are read, can't hold the layer, or can't be written.
    """
    refuse_overwriting(output, (map_path, layer_path))
    places = load_source_map(map_path)
    layer = read_layer(layer_path)
    if layer.size != places.exemplar:
        raise ImageError(
            f"{layer_path}: has {layer.size.cols} x {layer.size.rows} pixels, but {map_path.name} was grown from "
            f"{places.exemplar.cols} x {places.exemplar.rows}; give a layer of that size",
            path=str(layer_path),
        )
    check_layer_path(output, layer)
    notes = write_layer(output, render(layer.pixels, places.source), layer)
    rows, cols = places.source.shape
    return AppliedMap(str(output), rows, cols, len(layer.channels), layer.pixels.dtype.name, (*layer.notes, *notes))


class _Preview:
    """Writes what a texture looks like so far, seldom enough that growing it takes hardly longer.

    One that can't be written is no reason to lose the texture.
    """

    def __init__(self, path: Path, compared: Comparison, dpi: float | None) -> None:
        self._path, self._dpi = path, dpi or _UNKNOWN_DPI
        self._exemplar = preview_of(compared)
        self._next = 0.0
        self._failure: str | None = None

    def offer(self, step: Step) -> None:
        """Write the draft of a step if the last one is old enough."""
        begin = time.monotonic()
        if step.draft is None or begin < self._next or self._failure is not None:
            return
        self._write(step.draft())
        end = time.monotonic()
        self._next = end + max(_PREVIEW_EVERY_S, (end - begin) / _PREVIEW_SHARE)

    def finish(self, source: NDArray[np.int32]) -> tuple[str, ...]:
        """Write the whole texture's picture, and tell if it or an earlier one could not be written."""
        self._write(source)
        return () if self._failure is None else (f"The preview is not up to date: {self._failure}",)

    def _write(self, source: NDArray[np.int32]) -> None:
        """Write a map's picture, reduced by a whole number if it is large."""
        factor = -(-max(source.shape) // _PREVIEW_SIDE_PX)
        picture = render(self._exemplar, source[::factor, ::factor])
        try:
            write_preview(self._path, picture, self._dpi / factor)
            self._failure = None
        except OutputError as error:
            self._failure = error.message


@dataclass(frozen=True)
class _Watcher:
    progress: Progress
    stopping: Callable[[], bool]
    preview: _Preview | None

    def __call__(self, step: Step) -> bool:
        self.progress.stage(STAGES[1], step.share)
        if self.preview is not None:
            self.preview.offer(step)
        return not self.stopping()


def _grow(
    files: GrowFiles,
    settings: GrowSettings,
    given: tuple[Comparison, NDArray[np.uint8] | None],
    progress: Progress,
    watcher: _Watcher,
) -> SynthesisResult:
    compared, weights = given
    progress.stage(STAGES[1], 0.0)
    try:
        request = SynthesisRequest(
            compared.image,
            compared.valid,
            settings.size,
            settings.seed,
            toroidal=settings.toroidal,
            weights=weights,
            feature_px=settings.feature_px,
            threads=settings.threads,
            fast=settings.fast,
        )
        return METHODS[settings.method](request, watcher)
    except ValueError as error:
        raise SynthesisError(
            f"{files.exemplar}: no texture can be grown from it by {settings.method}: {error}; choose another size or "
            "method, give a larger exemplar, or mask less of it",
            path=str(files.exemplar),
        ) from error


def _check_files(files: GrowFiles) -> None:
    """Find out which names can't be written to, before anything is read."""
    if files.map is not None:
        check_source_map_path(files.map)
    if files.preview is not None:
        check_preview_path(files.preview)
    read = (files.exemplar, files.mask, files.weights, *(path for path, _ in files.layers))
    for target in files.targets:
        refuse_overwriting(target, read)
    _refuse_doubles(files.targets)


class _TriedError(Exception):
    """A file could be begun."""


def _try_to_write(target: Path) -> None:
    """Find out whether a file can be written, before the work of making it; what stands there stays as it is."""
    with suppress(_TriedError), atomic_path(target):
        raise _TriedError


def _refuse_doubles(targets: Iterable[Path]) -> None:
    seen: set[Path] = set()
    for target in targets:
        if target.resolve() in seen:
            raise OutputError(f"{target}: is named twice as a file to write: choose another name", path=str(target))
        seen.add(target.resolve())


def _read_fitting(path: Path, exemplar: Layer) -> Layer:
    layer = read_layer(path)
    if layer.size != exemplar.size:
        raise ImageError(
            f"{path}: the layer has {layer.size.cols} x {layer.size.rows} pixels but its exemplar "
            f"{exemplar.size.cols} x {exemplar.size.rows}; both must be of one size",
            path=str(path),
        )
    return layer


def _masked(exemplar: Layer, valid: Mask, files: GrowFiles) -> Mask:
    rows, cols = valid.shape
    if min(rows, cols) < SMALLEST_EXEMPLAR_PX:
        raise ImageError(
            f"{exemplar.path}: has {cols} x {rows} pixels, but an exemplar needs {SMALLEST_EXEMPLAR_PX} a side",
            path=exemplar.path,
        )
    if files.mask is None:
        return valid
    valid = valid & read_mask(files.mask, (rows, cols))
    if not valid.any():
        raise ImageError(f"{exemplar.path}: mask and transparency leave nothing of it", path=exemplar.path)
    return valid


def _compared(exemplar: Layer, valid: Mask, threads: int | None) -> Comparison:
    return comparison_of(exemplar, valid, threads or os.cpu_count() or 1)
