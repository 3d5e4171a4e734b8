"""Which face a fired tile shows, or that it shows none of those looked among.

The tile is found in the image and brought to the cells of the fingerprints, turned every way it can lie. The faces
whose fingerprints differ least are rendered small and compared with the image place by place. A face is believed if
what of the tile can be compared is that face nearly everywhere, and isn't the next best face as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.inspection.finding import FoundTile, find_tile
from tilefab.inspection.fingerprint import FaceView, FingerprintIndex, code_bits
from tilefab.inspection.records import ImageProblem, Recognition
from tilefab.inspection.verification import COMPARED_PX, Comparison, compare, difference_of_faces, without_cover
from tilefab.inspection.views import Plane, cells_of_image, face_corners, matrix_of
from tilefab.types import FloatImage, Mask, SizeMm, SizePx

Float64Array = NDArray[np.float64]

PROBLEM_WORDS = {
    ImageProblem.BLACK: "the image is black: see to the light, the camera's cap and its exposure",
    ImageProblem.BLOWN_OUT: "the image is blown out: lower the exposure",
    ImageProblem.TORN: "rows or columns of the image are missing: see to the camera's cable and its transfer",
    ImageProblem.NO_TILE: "no tile is to be seen, or too little of one",
    ImageProblem.TWO_TILES: "more than one tile is to be seen: trigger the camera for each tile",
    ImageProblem.WRONG_SIZE: "what is to be seen isn't of this job's size",
}
"""What each problem of an image means and what to do."""

_NEARLY_SQUARE = 0.05
_TRIED_SCALES = (1.0, 0.987, 1.013)
_DISPLACED_CELLS, _DISPLACED_SCALES = 0.45, (1.0, 1.015)
_UNIT = SizePx(1, 1)
_SURELY_ALIKE = 0.1
_FAR_SHARE, _LIKELY_SHARE = 0.1, 0.3
_ALWAYS_BORNE = 0.02
# A face turned clockwise once more lies with its (x, y) where (1 - y, x) of the face lay.
_TURN = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_TURNED = tuple(np.linalg.matrix_power(_TURN, turns) for turns in range(4))


@dataclass(frozen=True)
class RecognitionSettings:
    """What it takes to believe a face.

    Attributes
    ----------
    candidates
        How many faces at most are rendered and compared.
    least_seen
        Share of the face that must be seen, and not be covered.
    least_compared
        Share of the face that must show enough stone to be compared.
    least_likeness
        Correlation over that.
    most_differing, of_apartness
        Share of that which may differ: at most the first, and at most the second of what the next best face differs in
        from the best, so that more is asked for where the faces of a job share much.
    least_apart
        Share of the face by which the next best face must differ more.
    """

    candidates: int = 3
    least_seen: float = 0.25
    least_compared: float = 0.08
    least_likeness: float = 0.6
    most_differing: float = 0.25
    of_apartness: float = 0.3
    least_apart: float = 0.01


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A face that the tile may show, and how: share of bits that differ, face, quarter turns, corners of the face."""

    share: float
    face: int
    quarter_turns: int
    corners_px: Float64Array


@dataclass(frozen=True, eq=False)
class _Match:
    candidate: _Candidate
    view: Plane
    found: Comparison


def recognise(
    xyz: FloatImage,
    index: FingerprintIndex,
    view: FaceView,
    size_mm: SizeMm,
    *,
    px_per_mm: float | None = None,
    settings: RecognitionSettings | None = None,
    found: FoundTile | ImageProblem | None = None,
) -> Recognition:
    """Recognise a tile in an image.

    Parameters
    ----------
    xyz
        float32 (rows, cols, 3), linear XYZ D50, 1 = the perfect white.
    index
        Fingerprints of the faces it can be; see `tilefab.inspection.fingerprint.fingerprints`.
    view
        Renders faces; some few are rendered.
    size_mm
        Size of the finished tile.
    px_per_mm
        Resolution of the image, if the camera is calibrated.
    settings
        What it takes to believe a face.
    found
        What `find_tile` said of the image, for who has asked it already.

    Returns
    -------
    Recognition
        Its ``corners_px`` are of the face as it was found to lie if there is one, else of the tile's outline.

    Raises
    ------
    ValueError
        If the image isn't (rows, cols, 3), or a size isn't positive.
    """
    settings = settings or RecognitionSettings()
    tile = find_tile(xyz, size_mm, px_per_mm=px_per_mm) if found is None else found
    if isinstance(tile, ImageProblem):
        return Recognition(None, 0, (), 1.0, 0.0, 0.0, 0.0, tile, PROBLEM_WORDS[tile])
    light = np.ascontiguousarray(xyz[:, :, 1])
    # What is seldom so is tried only if a tile isn't recognised at once.
    for poses, cover in ((_poses(tile), False), (_poses(tile) + _displaced(tile, index.grid), True)):
        candidates = _candidates(light, tile, poses, index, _turns(tile, size_mm), settings.candidates, cover=cover)
        if cover:
            candidates = [candidate for candidate in candidates if candidate.share < _LIKELY_SHARE]
        if candidates or not cover:
            said = _judged(tile, _compared(light, tile, candidates, view), settings, len(index))
        if said.face is not None or len(index) == 0:
            break
    return said


def _turns(tile: FoundTile, size_mm: SizeMm) -> tuple[int, ...]:
    """Quarter turns that the outline leaves possible."""
    if abs(size_mm.width / size_mm.height - 1.0) < _NEARLY_SQUARE:
        return (0, 1, 2, 3)
    return (1, 3) if tile.across else (0, 2)


def _poses(tile: FoundTile) -> list[Float64Array]:
    """Corners of the tile as it was found; if its size wasn't seen, of some sizes."""
    return [tile.scaled(scale) for scale in ((1.0,) if tile.measured else _TRIED_SCALES)]


def _displaced(tile: FoundTile, grid: SizePx) -> list[Float64Array]:
    """Corners where the face may lie instead: printed off the tile's middle, or with sides that look like the belt."""
    across, down = tile.corners_px[1] - tile.corners_px[0], tile.corners_px[3] - tile.corners_px[0]
    steps = (-_DISPLACED_CELLS / max(grid.rows, grid.cols), 0.0, _DISPLACED_CELLS / max(grid.rows, grid.cols))
    longest = max(float(np.linalg.norm(across)), float(np.linalg.norm(down)))
    across, down = across * longest / np.linalg.norm(across), down * longest / np.linalg.norm(down)
    middle = tile.corners_px.mean(axis=0)
    return [
        middle + scale * (tile.corners_px - middle) + right * across + below * down
        for scale in _DISPLACED_SCALES
        for below in steps
        for right in steps
    ]


def _candidates(
    light: Plane,
    tile: FoundTile,
    poses: list[Float64Array],
    index: FingerprintIndex,
    turns: tuple[int, ...],
    count: int,
    *,
    cover: bool,
) -> list[_Candidate]:
    """The faces whose fingerprints differ least from the tile, least first, each as it fits best.

    ``cover``: whether what stands out from the tile is left out, for it may be something that lies on it.
    """
    best: dict[int, _Candidate] = {}
    for pose in poses if len(index) else ():
        bits, known = _coded(light, tile, pose, index.grid, turns, cover)
        counts = known.sum(axis=(1, 2))
        if counts.min() == 0:
            continue
        for turned, row, most in zip(turns, index.differing(bits, known), counts.tolist(), strict=True):
            # Most ways to lay the tile are wrong, and nothing comes near in them.
            nearest = min((candidate.share for candidate in best.values()), default=1.0)
            if int(row.min()) / most > nearest + _FAR_SHARE:
                continue
            for place in np.argpartition(row, min(count, len(row)) - 1)[:count]:
                face, share = int(index.faces[place]), int(row[place]) / most
                if face not in best or share < best[face].share:
                    best[face] = _Candidate(share, face, turned, face_corners(pose, turned))
    return sorted(best.values(), key=lambda candidate: (candidate.share, candidate.face))[:count]


def _coded(
    light: Plane, tile: FoundTile, pose: Float64Array, grid: SizePx, turns: tuple[int, ...], cover: bool
) -> tuple[Mask, Mask]:
    """Bits of the tile's cells, (T, rows, cols), for each way it may be turned, and which of them are known."""

    def coded(turned: int) -> tuple[Mask, Mask]:
        matrix = matrix_of(face_corners(pose, turned), grid)
        cells = cells_of_image(light, tile.mask, matrix, grid)
        return code_bits(without_cover(cells) if cover else cells)

    if grid.rows == grid.cols:
        # The same cells, only in another order.
        first = coded(turns[0])
        both = [tuple(np.rot90(part, turned - turns[0]) for part in first) for turned in turns]
    else:
        both = [coded(turned) for turned in turns]
    return np.stack([bits for bits, _ in both]), np.stack([known for _, known in both])


def _compared(light: Plane, tile: FoundTile, candidates: list[_Candidate], view: FaceView) -> list[_Match]:
    """Candidates compared with the image, the best first."""
    out: list[_Match] = []
    for candidate in candidates:
        small = view(candidate.face, COMPARED_PX)
        best = max(out, key=lambda match: match.found.agrees, default=None)
        if best is not None and best.found.differs < _SURELY_ALIKE:
            if len(out) > 1 and candidate.share > best.candidate.share + _FAR_SHARE:
                break
            # However it is printed, the tile lies as it does.
            turns = (candidate.quarter_turns - best.candidate.quarter_turns) % 4
            matrix = best.found.matrix @ _TURNED[turns]
            out.append(_Match(candidate, small, compare(light, tile.mask, matrix, small, lies_there=True)))
        else:
            matrix = matrix_of(candidate.corners_px, _UNIT)
            out.append(_Match(candidate, small, compare(light, tile.mask, matrix, small)))
    return sorted(out, key=lambda match: -match.found.agrees)


def _judged(tile: FoundTile, matches: list[_Match], settings: RecognitionSettings, faces: int) -> Recognition:
    outline = tuple((float(x), float(y)) for x, y in tile.corners_px)
    if not matches:
        why = "nothing of the tile can be compared with the faces" if faces else "there are no faces to look among"
        return Recognition(None, 0, outline, 1.0, 0.0, 0.0, tile.visible, None, why)
    best, second = matches[0], matches[1] if len(matches) > 1 else None
    runner_up = second.found.likeness if second is not None else 0.0
    most = settings.most_differing
    if second is not None:
        most = min(most, max(_ALWAYS_BORNE, settings.of_apartness * second.found.differs))
        if _ALWAYS_BORNE < best.found.differs <= most:
            turns = (second.candidate.quarter_turns - best.candidate.quarter_turns) % 4
            apart = difference_of_faces(best.view, second.view, turns, best.found.compared)
            most = min(most, max(_ALWAYS_BORNE, settings.of_apartness * apart))
    likeness = best.found.likeness
    doubt = _doubt(best.found, second.found if second is not None else None, most, settings)
    if doubt is not None:
        sure = float(np.clip((best.found.differs - most) / 0.3, 0.0, 1.0))
        return Recognition(None, 0, outline, sure, likeness, runner_up, tile.visible, None, doubt)
    square = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 1.0, 1.0]]) @ best.found.matrix.T
    corners = tuple((float(x / depth), float(y / depth)) for x, y, depth in square)
    sure = float(np.clip(1.0 - best.found.differs / most, 0.0, 1.0))
    return Recognition(
        best.candidate.face,
        best.candidate.quarter_turns,
        corners,
        sure,
        likeness,
        runner_up,
        tile.visible,
        None,
        "",
    )


def _doubt(best: Comparison, second: Comparison | None, most: float, settings: RecognitionSettings) -> str | None:
    """Why the best face isn't to be believed; None if it is."""
    if best.seen < settings.least_seen or best.share < settings.least_compared:
        return f"only {100 * min(best.seen, best.share):.0f} % of the tile can be compared with the faces"
    if best.differs > most or best.likeness < settings.least_likeness:
        return (
            f"none of these faces: the nearest differs in {100 * best.differs:.0f} % of what is to be seen "
            f"(likeness {best.likeness:.2f})"
        )
    if second is not None:
        apart = float((best.alike & best.compared & ~second.alike).mean())
        if apart < settings.least_apart:
            return "two faces look the same in what is to be seen of the tile"
    return None
