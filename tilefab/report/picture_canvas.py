"""A canvas that draws pages as pictures: what the pages use of reportlab's canvas, done with Pillow.

Pages don't know which of the two they are drawn on. Coordinates are points from the lower left corner. Everything is
drawn at twice the resolution and reduced, so that edges are soft; curves of circles are Pillow's.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

from PIL import Image, ImageDraw, ImageFont
from reportlab.pdfbase import pdfmetrics

_OVERSAMPLING = 2
_POINTS_PER_INCH = 72.0

Point = tuple[float, float]
Rgb8 = tuple[int, int, int]


@dataclass
class PicturePath:
    """Pieces of straight lines, as they were added."""

    pieces: list[list[Point]] = field(default_factory=list)
    closed: list[bool] = field(default_factory=list)

    def moveTo(self, x: float, y: float) -> None:  # noqa: N802
        """Begin a piece."""
        self.pieces.append([(x, y)])
        self.closed.append(False)

    def lineTo(self, x: float, y: float) -> None:  # noqa: N802
        """Go on with the last piece."""
        self.pieces[-1].append((x, y))

    def close(self) -> None:
        """Close the last piece."""
        self.closed[-1] = True

    def rect(self, x: float, y: float, width: float, height: float) -> None:
        """Add a closed rectangle."""
        self.pieces.append([(x, y), (x + width, y), (x + width, y + height), (x, y + height)])
        self.closed.append(True)


@dataclass(frozen=True)
class _Pen:
    """What is remembered by `saveState`."""

    fill: Rgb8 = (0, 0, 0)
    stroke: Rgb8 = (0, 0, 0)
    width: float = 1.0
    dash: tuple[float, ...] = ()
    font: str = ""
    size: float = 8.0


class PictureCanvas:
    """One page as a picture.

    Parameters
    ----------
    width, height
        Size of the page in points.
    dpi
        Resolution of the picture.
    """

    def __init__(self, width: float, height: float, dpi: float) -> None:
        self._scale = _OVERSAMPLING * dpi / _POINTS_PER_INCH
        self._height = height
        self._dpi = dpi
        across, down = (_OVERSAMPLING * round(side * dpi / _POINTS_PER_INCH) for side in (width, height))
        self._image = Image.new("RGB", (across, down), (255, 255, 255))
        self._draw = ImageDraw.Draw(self._image)
        self._pen = _Pen()
        self._saved: list[tuple[_Pen, Image.Image | None, Image.Image | None]] = []
        self._clip: tuple[Image.Image, Image.Image] | None = None
        self._fonts: dict[tuple[str, float], ImageFont.FreeTypeFont] = {}

    def png(self) -> bytes:
        """The page as a PNG file."""
        size = (self._image.width // _OVERSAMPLING, self._image.height // _OVERSAMPLING)
        file = io.BytesIO()
        self._image.resize(size, Image.Resampling.BOX).save(file, "PNG", dpi=(self._dpi, self._dpi))
        return file.getvalue()

    def _at(self, x: float, y: float) -> Point:
        return (x * self._scale, (self._height - y) * self._scale)

    # The names below are reportlab's.

    def setFillColor(self, colour: Any) -> None:  # noqa: N802
        """Colour of areas and text."""
        self._pen = replace(self._pen, fill=_rgb8(colour))

    def setStrokeColor(self, colour: Any) -> None:  # noqa: N802
        """Colour of lines."""
        self._pen = replace(self._pen, stroke=_rgb8(colour))

    def setLineWidth(self, width: float) -> None:  # noqa: N802
        """Width of lines in points."""
        self._pen = replace(self._pen, width=width)

    def setLineJoin(self, _join: int) -> None:  # noqa: N802
        """Lines always meet round here."""

    def setLineCap(self, _cap: int) -> None:  # noqa: N802
        """Lines always end flat here."""

    def setDash(self, *pattern: Any) -> None:  # noqa: N802
        """Lengths of strokes and gaps in points, as numbers or one list; nothing: a full line."""
        lengths = pattern[0] if pattern and isinstance(pattern[0], list | tuple) else pattern
        self._pen = replace(self._pen, dash=tuple(float(length) for length in lengths))

    def setFont(self, name: str, size: float) -> None:  # noqa: N802
        """Font of texts."""
        self._pen = replace(self._pen, font=name, size=size)

    def saveState(self) -> None:  # noqa: N802
        """Remember pen, font and clipping."""
        before, mask = self._clip if self._clip else (None, None)
        self._saved.append((self._pen, before, mask))
        self._clip = None

    def restoreState(self) -> None:  # noqa: N802
        """Go back to what was remembered last; what was drawn outside the clipping path since is gone."""
        if self._clip is not None:
            before, mask = self._clip
            self._image.paste(Image.composite(self._image, before, mask))
        self._pen, before_outer, mask_outer = self._saved.pop()
        self._clip = (before_outer, mask_outer) if before_outer is not None and mask_outer is not None else None

    def beginPath(self) -> PicturePath:  # noqa: N802
        """Return an empty path."""
        return PicturePath()

    def clipPath(self, path: PicturePath, *, stroke: int = 0, fill: int = 0) -> None:  # noqa: N802
        """Keep what follows, up to `restoreState`, inside a path."""
        mask = Image.new("L", self._image.size, 0)
        pen = ImageDraw.Draw(mask)
        for piece in path.pieces:
            pen.polygon([self._at(*point) for point in piece], fill=255)
        self._clip = (self._image.copy(), mask)
        if stroke or fill:
            self.drawPath(path, stroke=stroke, fill=fill)

    def drawPath(self, path: PicturePath, *, stroke: int = 1, fill: int = 0) -> None:  # noqa: N802
        """Draw a path."""
        for piece, closed in zip(path.pieces, path.closed, strict=True):
            if fill and len(piece) > 2:
                self._draw.polygon([self._at(*point) for point in piece], fill=self._pen.fill)
            if stroke and len(piece) > 1:
                self._stroke([*piece, piece[0]] if closed else piece)

    def rect(self, x: float, y: float, width: float, height: float, *, stroke: int = 1, fill: int = 0) -> None:
        """Draw a rectangle."""
        path = PicturePath()
        path.rect(x, y, width, height)
        self.drawPath(path, stroke=stroke, fill=fill)

    def line(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Draw a line."""
        self._stroke([(x0, y0), (x1, y1)])

    def circle(self, x: float, y: float, radius: float, *, stroke: int = 1, fill: int = 0) -> None:
        """Draw a circle."""
        left, top = self._at(x - radius, y + radius)
        right, bottom = self._at(x + radius, y - radius)
        self._draw.ellipse(
            (left, top, right, bottom),
            fill=self._pen.fill if fill else None,
            outline=self._pen.stroke if stroke else None,
            width=max(1, round(self._pen.width * self._scale)),
        )

    def _stroke(self, points: list[Point]) -> None:
        width = max(1, round(self._pen.width * self._scale))
        placed = [self._at(*point) for point in points]
        runs = [placed] if not any(self._pen.dash) else _dashes(placed, [d * self._scale for d in self._pen.dash])
        for run in runs:
            self._draw.line(run, fill=self._pen.stroke, width=width, joint="curve" if len(run) > 2 else None)

    def drawImage(self, image: Any, x: float, y: float, width: float, height: float) -> None:  # noqa: N802
        """Draw a reportlab ImageReader."""
        size, data = image.getSize(), image.getRGBData()
        picture = Image.frombytes("RGB", size, data)
        left, top = self._at(x, y + height)
        right, bottom = self._at(x + width, y)
        box = (round(left), round(top), max(round(right), round(left) + 1), max(round(bottom), round(top) + 1))
        self._image.paste(picture.resize((box[2] - box[0], box[3] - box[1]), Image.Resampling.BILINEAR), box[:2])

    def drawString(self, x: float, y: float, text: str) -> None:  # noqa: N802
        """Draw a text from its left end."""
        self._text(x, y, text, "ls")

    def drawRightString(self, x: float, y: float, text: str) -> None:  # noqa: N802
        """Draw a text up to its right end."""
        self._text(x, y, text, "rs")

    def drawCentredString(self, x: float, y: float, text: str) -> None:  # noqa: N802
        """Draw a text about its middle."""
        self._text(x, y, text, "ms")

    def _text(self, x: float, y: float, text: str, anchor: str) -> None:
        self._draw.text(self._at(x, y), text, fill=self._pen.fill, font=self._font(), anchor=anchor)

    def _font(self) -> ImageFont.FreeTypeFont:
        key = (self._pen.font, self._pen.size)
        if key not in self._fonts:
            file = pdfmetrics.getFont(self._pen.font).face.filename
            self._fonts[key] = ImageFont.truetype(file, self._pen.size * self._scale)
        return self._fonts[key]


def _rgb8(colour: Any) -> Rgb8:
    red, green, blue = (round(255.0 * float(part)) for part in (colour.red, colour.green, colour.blue))
    return red, green, blue


def _dashes(points: list[Point], pattern: list[float]) -> list[list[Point]]:
    """Strokes of a dashed line."""
    if len(pattern) % 2:
        pattern = pattern * 2
    runs: list[list[Point]] = []
    place, left, on = 0, pattern[0], True
    run = [points[0]]
    for (x0, y0), (x1, y1) in pairwise(points):
        length, done = math.hypot(x1 - x0, y1 - y0), 0.0
        while length - done > left:
            done += left
            at = (x0 + (x1 - x0) * done / length, y0 + (y1 - y0) * done / length)
            if on:
                runs.append([*run, at])
            run, on = [at], not on
            place = (place + 1) % len(pattern)
            left = max(pattern[place], 0.5)
        left -= length - done
        run.append((x1, y1))
    if on and len(run) > 1:
        runs.append(run)
    return runs
