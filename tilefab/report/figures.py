"""Pictures and QR codes on the page."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from reportlab.graphics.barcode import qrencoder
from reportlab.lib.colors import black
from reportlab.lib.utils import ImageReader

from tilefab.errors import ReportError
from tilefab.report.style import MM, PALE, RULE, SMALL_MUTED, WHITE, Canvas, draw_text
from tilefab.report.view_model import RgbImage
from tilefab.types import Mask

QUIET_MODULES = 4
MIN_MODULE = 0.35 * MM
MAX_MODULE = 0.8 * MM
MIN_QR_SIDE = 14 * MM
_PRINT_DPI = 300
_JPEG_QUALITY = 90


def fit_size(rows: int, cols: int, width: float, height: float) -> tuple[float, float]:
    """Width and height in points of a picture as large as its box allows, never thinner than 2."""
    scale = min(width / cols, height / rows)
    return max(cols * scale, min(2.0, width)), max(rows * scale, min(2.0, height))


def draw_image(
    canvas: Canvas, image: RgbImage, x: float, top: float, width: float, height: float, *, centre: bool = True
) -> tuple[float, float, float, float]:
    """Draw a picture with a hairline frame in a box below ``top``; return the x, top, width and height taken.

    It is reduced to 300 dpi at its printed size and kept as a JPEG file without chroma subsampling.
    """
    wide, high = fit_size(image.shape[0], image.shape[1], width, height)
    left = x + (width - wide) / 2 if centre else x
    most = (max(1, int(wide / 72 * _PRINT_DPI)), max(1, int(high / 72 * _PRINT_DPI)))
    picture = Image.fromarray(np.ascontiguousarray(image))
    if picture.width > most[0] or picture.height > most[1]:
        size = (min(picture.width, most[0]), min(picture.height, most[1]))
        picture = picture.resize(size, Image.Resampling.LANCZOS, reducing_gap=3.0)
    data = io.BytesIO()
    picture.save(data, "JPEG", quality=_JPEG_QUALITY, subsampling=0)
    canvas.drawImage(ImageReader(io.BytesIO(data.getvalue())), left, top - high, wide, high)
    canvas.setStrokeColor(RULE)
    canvas.setLineWidth(0.4)
    canvas.setDash()
    canvas.rect(left, top - high, wide, high, stroke=1, fill=0)
    return left, top, wide, high


def draw_no_image(canvas: Canvas, x: float, top: float, width: float, height: float) -> None:
    """Draw an empty frame where a picture was not made."""
    canvas.setFillColor(PALE)
    canvas.setStrokeColor(RULE)
    canvas.setLineWidth(0.4)
    canvas.setDash(2, 2)
    canvas.rect(x, top - height, width, height, stroke=1, fill=1)
    canvas.setDash()
    draw_text(canvas, "no preview", x, top - height / 2 + 4, width, SMALL_MUTED, align="centre")


def qr_modules(text: str, name: str) -> Mask:
    """Modules of the smallest QR code (error correction M) for a text, no quiet zone; True is dark.

    Raises
    ------
    ReportError
        If the text doesn't fit any QR code; ``name`` says whose it is.
    """
    try:
        data = text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise ReportError(f"{name} holds a character that has no Unicode encoding; no QR code can be made") from error
    if len(data) > 2000:
        raise ReportError(f"{name} is {len(data)} bytes long; a QR code on this page holds at most 2000")
    code = qrencoder.QRCode(None, qrencoder.QRErrorCorrectLevel.M)
    code.addData(text)
    code.make()
    return np.array([[bool(module) for module in row] for row in code.modules], dtype=np.bool_)


def qr_least_side(modules: Mask) -> float:
    """Smallest side in points, quiet zone included, at which the code still scans from print."""
    return max(MIN_QR_SIDE, (len(modules) + 2 * QUIET_MODULES) * MIN_MODULE)


def qr_side(modules: Mask, box: float) -> float:
    """Side in points, quiet zone included, for a code in a box: all of it, unless the code is very small."""
    return max(MIN_QR_SIDE, min(box, (len(modules) + 2 * QUIET_MODULES) * MAX_MODULE))


def draw_qr(canvas: Canvas, modules: Mask, x: float, top: float, side: float) -> None:
    """Draw a code with its quiet zone in a square of ``side`` points: one path, so no hairlines show."""
    pitch = side / (len(modules) + 2 * QUIET_MODULES)
    canvas.setFillColor(WHITE)
    canvas.rect(x, top - side, side, side, stroke=0, fill=1)
    path = canvas.beginPath()
    for row, line in enumerate(modules):
        steps = np.flatnonzero(np.diff(np.concatenate(([False], line, [False])).astype(np.int8)))
        for start, end in zip(steps[::2], steps[1::2], strict=True):
            y = top - (QUIET_MODULES + row + 1) * pitch
            path.rect(x + (QUIET_MODULES + int(start)) * pitch, y, int(end - start) * pitch, pitch)
    canvas.setFillColor(black)
    canvas.drawPath(path, stroke=0, fill=1)
