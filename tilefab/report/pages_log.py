"""What was done to the slab, and what the operator should know."""

from __future__ import annotations

from collections.abc import Sequence

from tilefab.report.layout import Block, Page, flow, section_heading, space, text_block
from tilefab.report.style import (
    BODY,
    INK,
    LEFT,
    MM,
    MUTED,
    STRONG,
    SUBHEADING,
    WHITE,
    WIDTH,
    Canvas,
    TextStyle,
    draw_lines,
    draw_rule,
    draw_text,
    wrap,
)

_STEP_WIDTH = 44 * MM
_MARK = TextStyle(STRONG.font, 8, 10, WHITE)


def log_pages(preparation: Sequence[tuple[str, str]], warnings: Sequence[str]) -> list[Page]:
    """Make the pages with the preparation log and the warnings."""
    blocks = [section_heading("Preparation and warnings"), _subheading("What was done to the slab")]
    blocks += [_step(place, step, sentence) for place, (step, sentence) in enumerate(preparation, 1)]
    if not preparation:
        blocks.append(text_block("Nothing: the scan was used as it was."))
    blocks += [space(7 * MM), _subheading("Warnings")]
    blocks += [_warning(warning) for warning in warnings]
    if not warnings:
        blocks.append(text_block("No warnings."))
    return flow("Preparation and warnings", blocks)


def _subheading(text: str) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        draw_text(canvas, text, LEFT, top, WIDTH, SUBHEADING)

    return Block(SUBHEADING.leading + 1.5 * MM, draw, keep=True)


def _step(place: int, step: str, sentence: str) -> Block:
    names = wrap(step, _STEP_WIDTH - 10 * MM, STRONG, 3)
    sentences = wrap(sentence, WIDTH - _STEP_WIDTH, BODY, 20)
    height = max(len(names), len(sentences)) * BODY.leading + 2.4 * MM

    def draw(canvas: Canvas, top: float) -> None:
        draw_text(canvas, str(place), LEFT, top - 1.2 * MM, 7 * MM, MUTED)
        draw_lines(canvas, names, LEFT + 7 * MM, top - 1.2 * MM, STRONG)
        draw_lines(canvas, sentences, LEFT + _STEP_WIDTH, top - 1.2 * MM, BODY)
        draw_rule(canvas, LEFT, top - height, WIDTH, thickness=0.35)

    return Block(height, draw)


def _warning(warning: str) -> Block:
    lines = wrap(warning, WIDTH - 13 * MM, BODY, 20)
    box = len(lines) * BODY.leading + 3 * MM

    def draw(canvas: Canvas, top: float) -> None:
        canvas.setStrokeColor(INK)
        canvas.setLineWidth(0.6)
        canvas.setDash()
        canvas.rect(LEFT, top - box, WIDTH, box, stroke=1, fill=0)
        canvas.setFillColor(INK)
        canvas.rect(LEFT, top - box, 7 * MM, box, stroke=0, fill=1)
        draw_text(canvas, "!", LEFT, top - 1.6 * MM, 7 * MM, _MARK, align="centre")
        draw_lines(canvas, lines, LEFT + 10 * MM, top - 1.5 * MM, BODY)

    return Block(box + 2 * MM, draw)
