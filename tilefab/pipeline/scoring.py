"""How good a grown texture is: the panel of measures against its exemplar, and gates for what they can't see."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.errors import ImageError
from tilefab.io.layers import read_layer
from tilefab.io.source_map_file import load_source_map
from tilefab.pipeline.growing_colours import Comparison, comparison_of
from tilefab.pipeline.progress import Progress
from tilefab.texture.copies import MAX_COPIES_OVER_RATIO, large_copies
from tilefab.texture.coverage import estimate_source
from tilefab.texture.hard_seams import MAX_HARD_SHARE, hard_seams
from tilefab.texture.matching import largest_square, window_is_valid
from tilefab.texture.panel import MAX_REPETITION, MAX_SEAMS, SHARPNESS_RANGE, Panel, measure_panel
from tilefab.texture.portilla_simoncelli import MIN_SIDE_PX
from tilefab.texture.repetition import usage
from tilefab.texture.seam_cost import seam_cost
from tilefab.types import FloatImage, Mask, SizePx

STAGE = "Measuring the texture"
_FEW_KNOWN = 0.5


@dataclass(frozen=True)
class Gate:
    """One thing that must not be wrong, whatever the measures say.

    Attributes
    ----------
    name
        In a word or two.
    value, limit
        What was measured, and what passes, in words.
    passed
        Whether it does.
    meaning
        What it means if it doesn't.
    """

    name: str
    value: float
    limit: str
    passed: bool
    meaning: str


@dataclass(frozen=True)
class Score:
    """How good a texture is.

    Attributes
    ----------
    texture, exemplar
        Files.
    portilla_simoncelli, radial_psd, bidirectional_de76, gradient
        See `tilefab.texture.panel.Panel`; less is nearer to the exemplar.
    coverage
        Share of the exemplar's usable pixels that is shown.
    seam_delta_e
        Mean colour difference across all seams, CIE76.
    map_estimated
        Whether the last two, copies and hard seams come of a map that was found by looking.
    known_share
        Share of the texture that shows the same as the exemplar; 1 with a map.
    gates
        What must not be wrong.
    notes
        What the user should know, a sentence each.
    """

    texture: str
    exemplar: str
    portilla_simoncelli: float
    radial_psd: float
    bidirectional_de76: float
    gradient: float
    coverage: float
    seam_delta_e: float
    map_estimated: bool
    known_share: float
    gates: tuple[Gate, ...]
    notes: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether every gate is passed."""
        return all(gate.passed for gate in self.gates)


@dataclass(frozen=True, eq=False)
class _Compared:
    """Two images as they are compared, and the map from one into the other."""

    exemplar: FloatImage
    valid: Mask
    texture: FloatImage
    source: NDArray[np.int32]
    known: Mask


def score_texture(
    texture_path: Path, exemplar_path: Path, progress: Progress, map_path: Path | None = None, threads: int = 1
) -> Score:
    """Measure a texture against the exemplar that it was grown from.

    Parameters
    ----------
    texture_path, exemplar_path
        Colour or gray images of one resolution. What is transparent of the exemplar isn't used.
    progress
        Told of the progress.
    map_path
        The map of places that was kept when it was grown; without one it is estimated.
    threads
        Changes nothing else.

    Raises
    ------
    ImageError, ProfileError
        If an image can't be used, is too small, or map and images don't belong together.
    TextureMapError
        If the map can't be used.
    """
    progress.stage(STAGE, 0.0)
    notes: list[str] = []
    judged = _colours(exemplar_path, threads)
    given = _colours(texture_path, threads, judged)
    exemplar, valid, texture = judged.image, judged.valid, given.image
    notes += judged.notes
    if not given.valid.all():
        share = 100 * float((~given.valid).mean())
        raise ImageError(
            f"{texture_path}: {share:.2g} % of it is transparent or no number; cut out a part that isn't",
            path=str(texture_path),
        )
    _check_size(texture_path, SizePx(*texture.shape[:2]))
    square = _largest_valid(exemplar_path, exemplar, valid, notes)
    progress.stage(STAGE, 0.1)
    if map_path is None:
        estimate = estimate_source(exemplar, texture, valid)
        compared = _Compared(exemplar, valid, texture, estimate.source, estimate.known)
        if estimate.known_share < _FEW_KNOWN:
            notes.append(
                f"Only {100 * estimate.known_share:.0f} % of the texture shows the same as the exemplar: it isn't made "
                "of copies, or was changed since. Copies and hard seams are judged on that part; coverage is a guess"
            )
    else:
        source = _kept_map(map_path, texture_path, exemplar_path, texture, exemplar)
        compared = _Compared(exemplar, valid, texture, source, np.ones(source.shape, dtype=bool))
    progress.stage(STAGE, 0.4)
    panel = measure_panel(_as_lab(square), _as_lab(texture))
    progress.stage(STAGE, 0.9)
    score = Score(
        texture=str(texture_path),
        exemplar=str(exemplar_path),
        portilla_simoncelli=panel.portilla_simoncelli,
        radial_psd=panel.radial_psd,
        bidirectional_de76=panel.bidirectional_de76,
        gradient=panel.gradient,
        coverage=usage(compared.source, (valid.shape[0], valid.shape[1]), valid).coverage,
        seam_delta_e=seam_cost(compared.source, exemplar).mean_delta_e,
        map_estimated=map_path is None,
        known_share=float(compared.known.mean()),
        gates=_gates(panel, compared),
        notes=tuple(notes),
    )
    progress.stage(STAGE, 1.0)
    return score


def _gates(panel: Panel, compared: _Compared) -> tuple[Gate, ...]:
    shape = (compared.exemplar.shape[0], compared.exemplar.shape[1])
    copies = large_copies(compared.source, shape, known=compared.known)
    hard = hard_seams(compared.source, compared.exemplar, compared.texture, compared.known)
    low, high = SHARPNESS_RANGE
    sharpness = panel.sharpness_ratio
    return (
        Gate(
            "repetition",
            panel.repetition,
            f"at most {MAX_REPETITION:g}",
            panel.repetition <= MAX_REPETITION,
            "the texture repeats itself at a fixed step, which the exemplar doesn't",
        ),
        Gate(
            "copies",
            copies.over_ratio if copies.most > 1 else 0.0,
            f"at most {MAX_COPIES_OVER_RATIO:g}",
            not copies.too_many,
            f"one place of the exemplar, row {copies.place[0]}, column {copies.place[1]}, comes back {copies.most} "
            "times in pieces larger than a sixteenth of the exemplar"
            if copies.most > 1
            else "one place of the exemplar comes back in pieces larger than a sixteenth of it",
        ),
        Gate(
            "blur",
            sharpness,
            f"at least {low:g}",
            sharpness >= low,
            "fine detail of the exemplar is lost",
        ),
        Gate(
            "noise",
            sharpness,
            f"at most {high:g}",
            sharpness <= high,
            "there is more fine detail than in the exemplar: grain, or ragged seams everywhere",
        ),
        Gate(
            "straight edges",
            panel.seams,
            f"at most {MAX_SEAMS:g}",
            panel.seams <= MAX_SEAMS,
            "edges line up in a row or column, as where blocks were laid side by side",
        ),
        Gate(
            "hard seams",
            hard.share,
            f"at most {MAX_HARD_SHARE:g}",
            hard.share <= MAX_HARD_SHARE,
            f"{hard.count} join{'' if hard.count == 1 else 's'} between pieces can be seen as lines, up to "
            f"{hard.longest_px:.0f} pixels long",
        ),
    )


def _colours(path: Path, threads: int, like: Comparison | None = None) -> Comparison:
    layer, valid = read_layer(path).opaque()
    channels = layer.pixels.shape[2]
    if like is not None and (like.image.shape[2] == 1) != (channels == 1):
        raise ImageError(
            f"{path}: one of texture and exemplar is gray, the other in colour; give both alike", path=str(path)
        )
    compared = comparison_of(layer, valid, threads, like)
    if channels > 1 and not compared.is_lab:
        raise ImageError(
            f"{path}: its {channels} channels aren't colours that a score could compare; give the layer of colours",
            path=str(path),
        )
    return compared


def _check_size(path: Path, size: SizePx) -> None:
    if min(size.rows, size.cols) < MIN_SIDE_PX:
        raise ImageError(
            f"{path}: {size.cols} x {size.rows} pixels are too few for a score, which needs {MIN_SIDE_PX} on a side",
            path=str(path),
        )


def _largest_valid(path: Path, exemplar: FloatImage, valid: Mask, notes: list[str]) -> FloatImage:
    """The exemplar if all of it may be used, else the largest square that may."""
    _check_size(path, SizePx(*valid.shape))
    if valid.all():
        return exemplar
    side = largest_square(valid)
    if side < MIN_SIDE_PX:
        raise ImageError(
            f"{path}: its largest square without holes has {side} pixels on a side, but a score needs {MIN_SIDE_PX}",
            path=str(path),
        )
    row, col = (int(k) for k in np.argwhere(window_is_valid(valid, side, side))[0])
    notes.append(
        f"{path.name} has holes: the texture is compared with its largest square without any, {side} pixels on a side"
    )
    return np.ascontiguousarray(exemplar[row : row + side, col : col + side])


def _kept_map(
    map_path: Path, texture_path: Path, exemplar_path: Path, texture: FloatImage, exemplar: FloatImage
) -> NDArray[np.int32]:
    kept = load_source_map(map_path)
    for path, image, size in (
        (texture_path, texture, SizePx(*kept.source.shape)),
        (exemplar_path, exemplar, kept.exemplar),
    ):
        if image.shape[:2] != (size.rows, size.cols):
            raise ImageError(
                f"{path}: has {image.shape[1]} x {image.shape[0]} pixels, but {map_path.name} was made for "
                f"{size.cols} x {size.rows}; give the map that belongs to it",
                path=str(path),
            )
    return kept.source


def _as_lab(image: FloatImage) -> FloatImage:
    """Gray as CIELAB of no chroma."""
    if image.shape[2] == 3:
        return image
    lab = np.zeros((*image.shape[:2], 3), dtype=np.float32)
    lab[..., :1] = image
    return lab
