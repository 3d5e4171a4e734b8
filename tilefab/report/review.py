"""Sheets to choose from by eye: many small pictures with their numbers and costs, as HTML or as one picture."""

from __future__ import annotations

import base64
import html
import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from tilefab.report.view_model import RgbImage

_JPEG_QUALITY = 82
_SHEET_PX = 1800
_MARGIN_PX = 16
_TEXT_PX = 13
_TITLE_PX = 20
_INK = (28, 28, 28)
_PAPER = 250

_STYLE = """
:root { color-scheme: light dark; }
body { font: 14px/1.45 system-ui, sans-serif; margin: 1.5rem; padding-bottom: 4rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
p { max-width: 60rem; } code { font-size: 1rem; }
.cards { display: flex; flex-wrap: wrap; gap: .7rem; }
figure { margin: 0; padding: .25rem; border: 2px solid transparent; }
figure img { display: block; max-width: 40rem; }
figure[data-number] { cursor: pointer; }
figure.chosen { border-color: #c22; }
figcaption { font-size: .8rem; }
#list { position: fixed; left: 0; right: 0; bottom: 0; padding: .6rem 1.5rem; background: Canvas;
  border-top: 1px solid #888; overflow-wrap: anywhere; }
"""

_SCRIPT = """
const chosen = new Set();
for (const card of document.querySelectorAll("figure[data-number]")) {
  card.addEventListener("click", () => {
    const number = Number(card.dataset.number);
    if (!chosen.delete(number)) chosen.add(number);
    for (const other of document.querySelectorAll(`figure[data-number="${number}"]`))
      other.classList.toggle("chosen", chosen.has(number));
    const numbers = [...chosen].sort((a, b) => a - b).join(", ");
    document.querySelector("#numbers").textContent = `[${numbers}]`;
  });
}
"""


@dataclass(frozen=True, eq=False)
class ReviewCard:
    """One thing to look at.

    Parameters
    ----------
    image
        Its picture.
    lines
        What is to be known of it, the first as its name.
    number
        What it is chosen by; ``None`` if it can't be.
    """

    image: RgbImage
    lines: tuple[str, ...]
    number: int | None = None


@dataclass(frozen=True, eq=False)
class ReviewSection:
    """A title, a text and cards in the order in which they are shown."""

    title: str
    text: str
    cards: tuple[ReviewCard, ...]


@dataclass(frozen=True, eq=False)
class ReviewView:
    """Everything on a sheet: title, a text, sections, and whether its numbers can be chosen."""

    title: str
    text: str
    sections: tuple[ReviewSection, ...]
    choosable: bool


def review_html(view: ReviewView) -> str:
    """The sheet as one HTML file that needs no other: pictures are in it, and a click on a crop puts it on a list."""
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f"<title>{html.escape(view.title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{html.escape(view.title)}</h1>",
        f"<p>{html.escape(view.text)}</p>",
    ]
    for section in view.sections:
        parts.append(f"<h2>{html.escape(section.title)}</h2><p>{html.escape(section.text)}</p>")
        parts.append('<div class="cards">')
        for card in section.cards:
            number = f' data-number="{card.number}"' if view.choosable and card.number is not None else ""
            first, *others = card.lines
            caption = "<br>".join([f"<b>{html.escape(first)}</b>", *(html.escape(line) for line in others)])
            parts.append(
                f'<figure{number}><img alt="{html.escape(first)}" src="{_data_uri(card.image)}">'
                f"<figcaption>{caption}</figcaption></figure>"
            )
        parts.append("</div>")
    if view.choosable:
        parts.append(
            '<div id="list">In [texture] of the job file: <code>drop = <span id="numbers">[]</span></code></div>'
            f"<script>{_SCRIPT}</script>"
        )
    parts.append("</body></html>\n")
    return "\n".join(parts)


def review_picture(view: ReviewView) -> NDArray[np.uint8]:
    """The sheet as one picture, (rows, cols, 3) sRGB."""
    font, title_font = ImageFont.load_default(_TEXT_PX), ImageFont.load_default(_TITLE_PX)
    placed: list[tuple[int, int, ReviewCard]] = []
    texts: list[tuple[int, str, bool]] = [(_MARGIN_PX, view.title, True)]
    top = _MARGIN_PX + 2 * _TITLE_PX
    top = _add_text(texts, top, view.text)
    for section in view.sections:
        texts.append((top + _MARGIN_PX, section.title, True))
        top = _add_text(texts, top + _MARGIN_PX + 2 * _TITLE_PX, section.text)
        left, top, height = _MARGIN_PX, top + _MARGIN_PX // 2, 0
        for card in section.cards:
            wide = max(card.image.shape[1], max(int(font.getlength(_plain(line))) for line in card.lines))
            if left > _MARGIN_PX and left + wide > _SHEET_PX - _MARGIN_PX:
                left, top, height = _MARGIN_PX, top + height + _MARGIN_PX, 0
            placed.append((top, left, card))
            height = max(height, card.image.shape[0] + (len(card.lines) + 1) * (_TEXT_PX + 3))
            left += wide + _MARGIN_PX
        top += height + _MARGIN_PX
    width = max([_SHEET_PX, *(left + card.image.shape[1] + _MARGIN_PX for _, left, card in placed)])
    sheet = Image.new("RGB", (width, top + _MARGIN_PX), (_PAPER, _PAPER, _PAPER))
    draw = ImageDraw.Draw(sheet)
    for at, text, is_title in texts:
        draw.text((_MARGIN_PX, at), _plain(text), fill=_INK, font=title_font if is_title else font)
    for at, left, card in placed:
        sheet.paste(Image.fromarray(np.ascontiguousarray(card.image)), (left, at))
        for k, line in enumerate(card.lines):
            below = at + card.image.shape[0] + 3 + k * (_TEXT_PX + 3)
            draw.text((left, below), _plain(line), fill=_INK, font=font)
    return np.asarray(sheet, dtype=np.uint8)


def _add_text(texts: list[tuple[int, str, bool]], top: int, text: str) -> int:
    """Lay a text out in lines; where it ends."""
    line = ""
    most = _SHEET_PX // (_TEXT_PX // 2 + 1)
    for word in text.split():
        if line and len(line) + len(word) >= most:
            texts.append((top, line, False))
            top, line = top + _TEXT_PX + 5, ""
        line = f"{line} {word}".strip()
    texts.append((top, line, False))
    return top + _TEXT_PX + 5


def _plain(text: str) -> str:
    """What the font of pictures has."""
    return text.encode("latin-1", "replace").decode("latin-1")


def _data_uri(image: RgbImage) -> str:
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, "JPEG", quality=_JPEG_QUALITY)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
