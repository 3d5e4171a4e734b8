"""How smooth a profile's separation is: straight lines in Lab, ramps of neutrals, hues and single inks."""

from __future__ import annotations

import numpy as np

from tilefab import rng
from tilefab.colour.spaces import delta_e_2000
from tilefab.pipeline.profile_match import spread, triple
from tilefab.pipeline.profile_solid import Solid
from tilefab.pipeline.profile_tables import CheckedTables, Float64Array, srgb8
from tilefab.report.profile_view import FieldView, RampView, SmoothnessView, ToneView

LINES = 10_000
LINE_STEPS = 32
STEP_DELTA_E = 1.0
_DEEP = 0.95
_LINES_AT_ONCE = 2000
_MOST_TRIES = 4
_RAMP = 257
_TONES = 101
_BACK_L = 0.1
_FIELD_ROWS, _FIELD_COLS = 160, 720
_FIELD_L = (92.0, 18.0)


def smoothness(tables: CheckedTables, solid: Solid, lab: Float64Array, lines: int = LINES) -> SmoothnessView:
    """Second differences and jumps along straight lines of colour inside the gamut; reversals along ramps.

    Every line begins at one printable colour, goes 32 steps of 1 (CIE76) towards another, and counts where it stays
    inside the solid, off its surface.

    Parameters
    ----------
    tables
        The profile.
    solid
        Colours that can be mixed.
    lab
        Some of them (K, 3).
    lines
        How many lines to follow; fewer where a small gamut has too little room for them.
    """
    neutral = neutral_ramp(tables, "relative").printed if tables.backward else None
    tone = tone_curves(tables)
    inside = _lines_inside(tables, solid, lab, lines) if tables.backward and len(lab) > 1 else []
    count = sum(len(inks) for inks, _, _ in inside)
    neutral_reversals = None if neutral is None else reversals(neutral[:, 0], -1.0)
    ink_reversals = tuple(_turns(lightness) for lightness in tone.lab[:, :, 0])
    if not count:
        return SmoothnessView(0, STEP_DELTA_E, None, None, None, None, None, neutral_reversals, ink_reversals)
    bend_inks = [100.0 * np.abs(np.diff(inks, 2, axis=1)).max(axis=2).ravel() for inks, _, _ in inside]
    bend_lab = [np.linalg.norm(np.diff(out, 2, axis=1), axis=2).ravel() for _, out, _ in inside]
    jumps = [np.abs(np.diff(inks, axis=1)) for inks, _, _ in inside]
    part = int(np.argmax([jump.max() for jump in jumps]))
    line, step, ink = np.unravel_index(int(jumps[part].argmax()), jumps[part].shape)
    return SmoothnessView(
        lines=count,
        step_delta_e=STEP_DELTA_E,
        ink_bend_percent=spread(np.concatenate(bend_inks)),
        lab_bend=spread(np.concatenate(bend_lab)),
        jump_percent=float(100.0 * jumps[part].max()),
        jump_ink=tables.profile.ink_names[int(ink)],
        jump_lab=triple(inside[part][2][line, step]),
        neutral_reversals=neutral_reversals,
        ink_reversals=ink_reversals,
    )


def _lines_inside(
    tables: CheckedTables, solid: Solid, lab: Float64Array, lines: int
) -> list[tuple[Float64Array, Float64Array, Float64Array]]:
    """Inks (n, 33, N), printed and wanted Lab (n, 33, 3) of the lines that stay inside, in parts."""
    random = rng.generator(0, "lines in Lab")
    steps = STEP_DELTA_E * np.arange(LINE_STEPS + 1)[:, np.newaxis]
    found: list[tuple[Float64Array, Float64Array, Float64Array]] = []
    left = lines
    for _ in range(max(1, _MOST_TRIES * lines // _LINES_AT_ONCE)):
        start, end = lab[random.integers(len(lab), size=(2, _LINES_AT_ONCE))]
        length = np.linalg.norm(end - start, axis=1)
        far = length >= LINE_STEPS * STEP_DELTA_E
        if not far.any():
            continue
        way = (end[far] - start[far]) / length[far, np.newaxis]
        wanted = start[far, np.newaxis] + way[:, np.newaxis] * steps
        wanted = wanted[solid.at(wanted).min(axis=1) > _DEEP][:left]
        if len(wanted):
            inks = tables.ink_frac(wanted.reshape(-1, 3))
            printed = tables.lab(inks).reshape(wanted.shape)
            found.append((inks.reshape(*wanted.shape[:2], -1), printed, wanted))
            left -= len(wanted)
        if not left:
            break
    return found


def reversals(values: Float64Array, direction: float) -> int:
    """How often a curve (K,) goes back by more than 0.1; ``direction`` is 1 for one that rises, -1 for one that falls.

    >>> reversals(np.array([9.0, 7.0, 8.0, 5.0, 5.05, 2.0]), -1.0)
    1
    """
    count, going_back = 0, False
    extreme = low = float(direction * values[0])
    for value in direction * values[1:]:
        if value >= extreme:
            extreme, low, going_back = float(value), float(value), False
        elif going_back:
            # A new piece begins where the curve has gone on for a while and turns again.
            if value > low + _BACK_L:
                extreme, low, going_back = float(value), float(value), False
            low = min(low, float(value))
        elif value < extreme - _BACK_L:
            count, low, going_back = count + 1, float(value), True
    return count


def _turns(lightness: Float64Array) -> int:
    return reversals(lightness, 1.0 if lightness[-1] > lightness[0] else -1.0)


def tone_curves(tables: CheckedTables) -> ToneView:
    """Each ink alone, from none to full."""
    amount = np.linspace(0.0, 1.0, _TONES)
    recipes = np.eye(tables.inks)[:, np.newaxis, :] * amount[:, np.newaxis]
    lab = tables.lab(recipes.reshape(-1, tables.inks)).reshape(tables.inks, _TONES, 3)
    return ToneView(amount, lab, np.asarray(delta_e_2000(lab, lab[:, :1])), srgb8(lab))


def dark_lab(tables: CheckedTables) -> Float64Array:
    """Relative Lab of what the relative intent prints for black."""
    return np.asarray(tables.printed(np.zeros((1, 3)))[0], dtype=np.float64)


def neutral_ramp(tables: CheckedTables, intent: str) -> RampView:
    """Neutral colours from the medium's white down to L* 0, through an intent."""
    wanted = np.zeros((_RAMP, 3))
    wanted[:, 0] = np.linspace(100.0, 0.0, _RAMP)
    return _ramp(tables, intent, wanted, intent)


def hue_ramp(tables: CheckedTables, title: str, middle: Float64Array, intent: str = "relative") -> RampView:
    """From white to a colour and on to black, at even steps of CIE76."""
    corners = np.stack([np.array([100.0, 0.0, 0.0]), middle, dark_lab(tables)])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], _RAMP)
    wanted = np.stack([np.interp(at, along, corners[:, axis]) for axis in range(3)], axis=1)
    return _ramp(tables, title, wanted, intent)


def _ramp(tables: CheckedTables, title: str, wanted: Float64Array, intent: str) -> RampView:
    inks = tables.ink_frac(wanted, intent)
    printed = tables.lab(inks)
    return RampView(title, wanted, printed, 100.0 * inks, srgb8(wanted), srgb8(printed))


def smooth_fields(tables: CheckedTables, chroma: Float64Array) -> tuple[FieldView, ...]:
    """Smooth fields of colour as the relative intent prints them: bands of the tables show as bands.

    Parameters
    ----------
    tables
        The profile.
    chroma
        (H,) largest printable C* at even steps of hue from 0 on.
    """
    rows, cols = np.linspace(0.0, 1.0, _FIELD_ROWS)[:, np.newaxis], np.linspace(0.0, 1.0, _FIELD_COLS)
    high, low = _FIELD_L
    down = np.broadcast_to(high + (low - high) * rows, (_FIELD_ROWS, _FIELD_COLS))
    along = np.broadcast_to(100.0 + (dark_lab(tables)[0] - 100.0) * cols, down.shape)
    most = float(np.max(chroma))
    turn = 2.0 * np.pi * cols
    reach = np.interp(cols * len(chroma), np.arange(len(chroma) + 1), np.append(chroma, chroma[0]))
    tint = 0.25 * most * (rows - 0.5)
    planes = (
        ("every hue, at six tenths of its largest chroma; light to dark downwards", down, 0.6 * reach, turn),
        ("every hue, grey to largest chroma downwards, at L* 55", np.full(down.shape, 55.0), rows * reach, turn),
        ("white to black, from bluish to yellowish downwards", along, tint, np.full(down.shape, 0.5 * np.pi)),
        ("white to black, from greenish to reddish downwards", along, tint, np.zeros(down.shape)),
    )
    found = []
    for title, lightness, c, hue in planes:
        lab = np.stack(np.broadcast_arrays(lightness, c * np.cos(hue), c * np.sin(hue)), axis=-1)
        printed = tables.printed(lab.reshape(-1, 3)).reshape(lab.shape)
        found.append(FieldView(title, srgb8(printed)))
    return tuple(found)
