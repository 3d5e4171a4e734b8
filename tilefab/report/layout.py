"""Blocks of known height, and how they fill pages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tilefab.report.style import (
    ACCENT,
    BODY,
    BOTTOM,
    HEADING,
    LEFT,
    MM,
    MUTED,
    TOP,
    WIDTH,
    Canvas,
    draw_lines,
    draw_rule,
    wrap,
)

Draw = Callable[[Canvas, float], None]
"""Draws on a canvas below a given y."""


@dataclass(frozen=True)
class Block:
    """Something of a fixed ``height`` in points; ``draw`` is called with the y of its top.

    ``keep`` holds it on the same page as the block after it; ``head`` is drawn again above it on a new page.
    """

    height: float
    draw: Draw
    keep: bool = False
    head: Block | None = None


@dataclass(frozen=True)
class Page:
    """One finished page: its section's name and what draws it."""

    section: str
    draw: Callable[[Canvas], None]


def flow(section: str, blocks: Sequence[Block], top: float = TOP) -> list[Page]:
    """Fill pages with blocks, top to bottom; later pages repeat the section's name."""
    pages: list[list[Block]] = [[]]
    room = top - BOTTOM
    place = 0
    while place < len(blocks):
        end = place
        while blocks[end].keep and end + 1 < len(blocks):
            end += 1
        group = blocks[place : end + 1]
        height = sum(block.height for block in group)
        if pages[-1] and height > room:
            pages.append([])
            room = TOP - BOTTOM
            heads = [section_heading(f"{section} (continued)"), *([group[0].head] if group[0].head else [])]
            pages[-1].extend(heads)
            room -= sum(head.height for head in heads)
        pages[-1].extend(group)
        room -= height
        place = end + 1
    return [Page(section, _drawer(page, top if number == 0 else TOP)) for number, page in enumerate(pages) if page]


def _drawer(blocks: Sequence[Block], top: float) -> Callable[[Canvas], None]:
    def draw(canvas: Canvas) -> None:
        y = top
        for block in blocks:
            block.draw(canvas, y)
            y -= block.height

    return draw


def space(height: float) -> Block:
    """White of some height."""
    return Block(height, lambda _canvas, _top: None)


def section_heading(text: str, note: str = "") -> Block:
    """Build a section's name over a rule, with a muted note below it."""
    lines = wrap(text, WIDTH, HEADING, 1)
    notes = wrap(note, WIDTH, MUTED, 3) if note else []
    height = HEADING.leading + 3 * MM + len(notes) * MUTED.leading + (2 * MM if notes else 0) + 2 * MM

    def draw(canvas: Canvas, top: float) -> None:
        y = draw_lines(canvas, lines, LEFT, top, HEADING) - 1.2 * MM
        draw_rule(canvas, LEFT, y, WIDTH, thickness=0.5)
        draw_rule(canvas, LEFT, y, 18 * MM, ACCENT, 2)
        draw_lines(canvas, notes, LEFT, y - 2 * MM, MUTED)

    return Block(height, draw, keep=True)


def text_block(text: str, x: float = LEFT, width: float = WIDTH, max_lines: int = 12) -> Block:
    """Build a paragraph."""
    lines = wrap(text, width, BODY, max_lines)
    return Block(len(lines) * BODY.leading + 1 * MM, lambda canvas, top: void(draw_lines(canvas, lines, x, top, BODY)))


def void(_value: object) -> None:
    """Drop a value where a drawing must return nothing."""


@dataclass(frozen=True)
class _Fact:
    """A fact broken into lines; its label takes ``label_width`` points."""

    labels: list[str]
    values: list[str]
    label_width: float

    @property
    def height(self) -> float:
        return max(len(self.labels) * MUTED.leading, len(self.values) * BODY.leading) + 1.4 * MM

    def draw(self, canvas: Canvas, x: float, top: float, width: float, height: float) -> None:
        draw_lines(canvas, self.labels, x, top - 0.6 * MM - 0.6, MUTED)
        draw_lines(canvas, self.values, x + self.label_width, top - 0.6 * MM, BODY)
        draw_rule(canvas, x, top - height, width, thickness=0.35)


def _broken(facts: Sequence[tuple[str, str]], width: float, label_width: float) -> list[_Fact]:
    return [
        _Fact(
            wrap(label, label_width - 2 * MM, MUTED, 3),
            wrap(value, width - label_width, BODY, 3, middle=True),
            label_width,
        )
        for label, value in facts
    ]


def fact_rows(facts: Sequence[tuple[str, str]], x: float, width: float) -> list[Block]:
    """Build one block a fact: muted label left, value right of it, a hairline below."""

    def block(fact: _Fact) -> Block:
        return Block(fact.height, lambda canvas, top: fact.draw(canvas, x, top, width, fact.height))

    return [block(fact) for fact in _broken(facts, width, 0.3 * width)]


def two_columns(facts: Sequence[tuple[str, str]], gap: float = 8 * MM) -> list[Block]:
    """Facts in two columns of the page's width, read down the left one first."""
    width = (WIDTH - gap) / 2
    broken = _broken(facts, width, 0.42 * width)
    half = (len(broken) + 1) // 2

    def block(pair: list[_Fact]) -> Block:
        height = max(fact.height for fact in pair)

        def draw(canvas: Canvas, top: float) -> None:
            for place, fact in enumerate(pair):
                fact.draw(canvas, LEFT + place * (width + gap), top, width, height)

        return Block(height, draw)

    return [block(broken[place::half]) for place in range(half)]
