"""Made-up but lifelike views of line reports: a shift with drift, corrections, defects and stops, from one seed."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from tilefab.inspection.records import ColourFigures, Defect, DefectKind, Grade, TileDimensions
from tilefab.inspection.shade import ShadeSettings, ShadeState, assign_lot
from tilefab.report.line_view import (
    CorrectionView,
    InkUseView,
    InnovationView,
    KilnZoneView,
    LimitsView,
    LineReportView,
    LotView,
    ShiftView,
    SpanView,
    TileView,
    VariationView,
    WorstTileView,
)
from tilefab.report.view_model import RgbImage

BEGUN_S = 1_795_500_000.0 - 1_795_500_000.0 % 86400 + 5 * 3600
WIDTH_MM, HEIGHT_MM = 600.0, 300.0
_NOZZLE_MM = 212.4
_PREDICTED = (62.0, 3.0, 11.0)


def stone(rows: int, cols: int, seed: int, tint: tuple[float, float, float] = (150.0, 138.0, 122.0)) -> RgbImage:
    """A picture with soft clouds and veins."""
    generator = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:cols] / max(rows, cols)
    field = np.zeros((rows, cols))
    for octave in range(6):
        waves = 2.0**octave * generator.uniform(1.5, 3.0, 4)
        turn, phase = generator.uniform(0, np.pi, 4), generator.uniform(0, 2 * np.pi, 4)
        for wave, angle, start in zip(waves, turn, phase, strict=True):
            field += 0.55**octave * np.sin(2 * np.pi * wave * (x * np.cos(angle) + y * np.sin(angle)) + start)
    field += generator.normal(0, 0.25, field.shape)
    veins = np.exp(-((np.sin(6 * field) / 0.35) ** 2))
    grey = 1.0 + 0.09 * field - 0.18 * veins
    return np.clip(np.array(tint) * grey[..., np.newaxis], 0, 255).astype(np.uint8)


def _colour(difference: np.ndarray, spread: float) -> ColourFigures:
    size = float(np.hypot(np.linalg.norm(difference), spread))
    fired = np.add(_PREDICTED, difference)
    return ColourFigures(
        delta_e_mean=0.85 * size,
        delta_e_p95=1.9 * size,
        delta_e_worst=3.1 * size,
        worst_at_mm=(100.0, 50.0),
        cmc_mean=0.8 * size,
        cmc_p95=1.7 * size,
        lightness=float(difference[0]),
        chroma=float(difference[1]),
        hue=float(difference[2]),
        fired_lab=(float(fired[0]), float(fired[1]), float(fired[2])),
        predicted_lab=_PREDICTED,
    )


def _dimensions(generator: np.random.Generator) -> TileDimensions:
    width, height = WIDTH_MM + generator.normal(0.1, 0.15), HEIGHT_MM + generator.normal(0.05, 0.1)
    return TileDimensions(
        sides_mm=(width, height, width, height),
        width_mm=width,
        height_mm=height,
        size_deviation_percent=100 * (width / WIDTH_MM - 1),
        straightness_mm=0.1,
        straightness_percent=generator.normal(0.0, 0.03),
        rectangularity_mm=0.2,
        rectangularity_percent=generator.normal(0.02, 0.04),
        scale_known=True,
    )


def _defects(generator: np.random.Generator, hour: float) -> tuple[Defect, ...]:
    found = []

    def add(kind: DefectKind, x: float, y: float, wide: float, high: float, grade: Grade) -> None:
        found.append(Defect(kind, x, y, wide, high, 0.7 * wide * high, 4.0, 2.0, grade))

    if 3.1 < hour < 3.9:
        add(DefectKind.NOZZLE_LINE, _NOZZLE_MM + generator.normal(0, 0.3), 150.0, 0.3, 300.0, Grade.SECOND)
    if generator.random() < 0.012:
        x, y = generator.uniform(10, WIDTH_MM - 10), generator.uniform(10, HEIGHT_MM - 10)
        add(DefectKind.SPOT, x, y, 1.2, 1.1, Grade.SECOND if generator.random() < 0.5 else Grade.FIRST)
    if generator.random() < 0.006:
        x, y = generator.uniform(10, WIDTH_MM - 10), generator.uniform(10, HEIGHT_MM - 10)
        add(DefectKind.PINHOLE, x, y, 0.8, 0.8, Grade.FIRST)
    if generator.random() < 0.004:
        add(DefectKind.CHIP, generator.choice([6.0, 594.0]), generator.choice([5.0, 295.0]), 12.0, 9.0, Grade.SCRAP)
    if generator.random() < 0.003:
        x, y = generator.uniform(100, 500), generator.uniform(50, 250)
        add(DefectKind.CRACK, x, y, generator.uniform(8, 40), generator.uniform(4, 30), Grade.SCRAP)
    if generator.random() < 0.002:
        add(DefectKind.BANDING, 300.0, generator.uniform(40, 260), 600.0, 8.0, Grade.SECOND)
    return tuple(found)


def _worse(one: Grade, other: Grade) -> Grade:
    order = (Grade.FIRST, Grade.SECOND, Grade.SCRAP)
    return order[max(order.index(one), order.index(other))]


@functools.cache
def typical(count: int = 1296, *, seed: int = 5) -> LineReportView:
    """A shift of eight hours: the kiln wanders and steps, corrections follow a delay of 55 minutes later."""
    generator = np.random.default_rng(seed)
    span_s = 8 * 3600.0
    pace, delay = span_s / count, 55 * 60.0
    printed = BEGUN_S - delay + pace * np.arange(int(count * (span_s + delay) / span_s))
    printed = printed[(printed < BEGUN_S + 4.6 * 3600) | (printed > BEGUN_S + 4.9 * 3600)]
    drift = np.cumsum(generator.normal(0, 0.8 / np.sqrt(count), (len(printed), 3)), axis=0)
    drift[int(0.35 * len(printed)) :] += (-0.9, 0.35, 0.8)
    noise = generator.normal(0, 0.08, drift.shape)
    corrections: list[CorrectionView] = []
    applied, numbers, innovations = np.zeros(3), [], []
    offsets = np.zeros_like(drift)
    estimate, state = np.zeros(3), ShadeState()
    late = max(1, int(delay / pace))
    for place in range(len(printed)):
        offsets[place] = applied
        numbers.append(len(corrections))
        if place >= late:
            seen = place - late
            surprise = drift[seen] + noise[seen] - estimate
            told = float(np.clip(surprise[0] / 0.092, -4.5, 4.5) + (5.0 if place % 331 == 0 else 0.0))
            innovations.append(InnovationView(float(printed[place]), told, abs(told) < 4.8))
            estimate = estimate + 0.25 * surprise
            if place % max(1, len(printed) // 60) == 0 and np.linalg.norm(estimate - applied) > 0.3:
                applied = estimate.copy()
                reason = f"drift of {np.linalg.norm(estimate):.2f} estimated from {place} tiles, lighter and yellower"
                cost, number = float(np.linalg.norm(estimate)), len(corrections) + 1
                corrections.append(CorrectionView(number, float(printed[place]), reason, f"{place:064x}", cost))
    tiles, settings = [], ShadeSettings(1.2, _PREDICTED)
    members: dict[str, list[tuple[float, np.ndarray]]] = {}
    for place, at_s in enumerate(printed):
        fired_s = float(at_s + delay + generator.normal(0, 20))
        if fired_s > BEGUN_S + span_s or generator.random() < 0.01:
            tiles.append(TileView(place, place + 1, numbers[place], float(at_s)))
            continue
        difference = drift[place] - offsets[place] + noise[place]
        state, lot = assign_lot(state, (difference[0], difference[1], difference[2]), settings)
        members.setdefault(lot, []).append((fired_s, difference))
        colour, defects = _colour(difference, 0.5), _defects(generator, (fired_s - BEGUN_S) / 3600)
        grade = Grade.SECOND if colour.delta_e_mean > 1.5 else Grade.FIRST
        reasons = [f"mean ΔE {colour.delta_e_mean:.2f} is beyond 1.5"] if grade is Grade.SECOND else []
        for defect in defects:
            grade = _worse(grade, defect.grade)
            reasons.append(f"{defect.kind.value.replace('_', ' ')} at {defect.x_mm:.0f}, {defect.y_mm:.0f} mm")
        tiles.append(
            TileView(
                face=place,
                arm=place + 1,
                correction=numbers[place],
                printed_s=float(at_s),
                fired_s=fired_s,
                image=f"20261124T{place:06d}.000Z_{place:05d}.png",
                grade=grade,
                colour=colour,
                dimensions=_dimensions(generator),
                defects=defects,
                lot=lot,
                reasons=tuple(reasons) if grade is not Grade.FIRST else (),
            )
        )
    lots = tuple(
        LotView(
            lot.name,
            lot.tiles,
            lot.mean_lab,
            lot.spread_delta_e,
            min(at_s for at_s, _ in members[lot.name]),
            max(at_s for at_s, _ in members[lot.name]),
            (156 + 3 * place, 146, 128 - 4 * place),
        )
        for place, lot in enumerate(state.lots)
    )
    zones = []
    for zone in range(7):
        times = np.arange(BEGUN_S, BEGUN_S + span_s, 60.0)
        wander = np.cumsum(generator.normal(0, 0.22 + 0.05 * zone, times.size)) * 0.4
        wander += 3.0 * (zone in (4, 5)) / (1 + np.exp(-(times - BEGUN_S - 2.2 * 3600) / 300))
        setpoint = (320.0, 610.0, 880.0, 1120.0, 1195.0, 1190.0, 640.0)[zone]
        zones.append(KilnZoneView(f"zone {zone + 1}", tuple(times), tuple(setpoint + wander), setpoint))
    return LineReportView(
        title="Verde Alpi 600 × 300, honed",
        scope="Shift report",
        line="Line 2",
        run=17,
        job_file="jobs/verde_alpi.toml",
        job_hash="8f14e45fceea167a5a36dedd4bea2543",
        map_hash="c9f0f895fb98ab9159f51fd0297e236d",
        profile_hash="45c48cce2e2d7fbdea1afc51c7c6ad26",
        created="2026-11-24 15:02",
        software_version="0.1.0",
        begun_s=BEGUN_S,
        ended_s=BEGUN_S + span_s,
        utc_offset_min=60,
        facts=(("Press profile", "ceramic4, four inks"), ("Kiln delay", "55 min"), ("Camera", "4 px/mm, calibrated")),
        tile_size_mm=(WIDTH_MM, HEIGHT_MM),
        planned=4000,
        tiles=tuple(tiles),
        unreadable=(("blown out", 2), ("torn", 1)),
        strangers=1,
        corrections=tuple(corrections),
        kiln=tuple(zones),
        innovations=tuple(innovations),
        holds=(
            SpanView(BEGUN_S + 5.0 * 3600, BEGUN_S + 5.3 * 3600, "stale", "no fired tile was measured for 15 minutes"),
        ),
        downtime=(
            SpanView(BEGUN_S + 4.6 * 3600, BEGUN_S + 4.9 * 3600, "printer", "Print head 3: purge, vacuum low"),
            SpanView(BEGUN_S + 6.7 * 3600, BEGUN_S + 6.74 * 3600, "conveyor", "Tile askew before the eye"),
        ),
        alarms=(
            SpanView(BEGUN_S + 3.2 * 3600, BEGUN_S + 3.9 * 3600, "nozzle_line", "nozzle line at 212.4 mm"),
            SpanView(BEGUN_S + 4.6 * 3600, BEGUN_S + 4.9 * 3600, "printer_stopped", "Print head 3: vacuum low"),
            SpanView(BEGUN_S + 5.0 * 3600, BEGUN_S + 5.3 * 3600, "correction_held", "no fired tile for 15 minutes"),
        ),
        lots=lots,
        inks=(
            InkUseView("Blue", 61.2, 4.4),
            InkUseView("Brown", 118.6, 21.7),
            InkUseView("Beige", 84.0, 9.1),
            InkUseView("Black", 22.9, -5.2),
        ),
        limits=LimitsView(1.5, 3.0, 0.5, 0.5, 0.5),
        variation=VariationView(
            "V2",
            2.31,
            0.92,
            4.8,
            False,
            None,
            "The V class is what the measured variation looks like: an aid, not the measure of ANSI A137.1.",
        ),
        ink_unit="m² of full coverage",
        ink_saved_against="the same colours without replacing mixtures by black",
        worst=_worst(tiles),
        tile_picture=stone(150, 300, 1),
        warnings=("Three photographs of the camera could not be read; see `inspect.log`.",),
    )


def _worst(tiles: list[TileView]) -> tuple[WorstTileView, ...]:
    order = {Grade.SCRAP: 0, Grade.SECOND: 1, Grade.FIRST: 2}
    graded = [(order[tile.grade], -tile.colour.delta_e_mean, tile) for tile in tiles if tile.grade and tile.colour]
    worst = []
    for _, _, tile in sorted(graded, key=lambda row: row[:2])[:10]:
        predicted = stone(150, 300, tile.face)
        fired = np.clip(predicted * np.array([1.04, 0.99, 0.93]), 0, 255).astype(np.uint8)
        for defect in tile.defects:
            col, row = int(defect.x_mm / 2), int(defect.y_mm / 2)
            fired[max(row - 2, 0) : row + 3, max(col - 4, 0) : col + 5] = 235
        difference = np.abs(fired.astype(int) - predicted).sum(axis=2) * 4
        heat = np.clip(255 - difference, 0, 255).astype(np.uint8)
        worst.append(WorstTileView(tile, predicted, fired, np.repeat(heat[..., np.newaxis], 3, axis=2)))
    return tuple(worst)


@functools.cache
def empty() -> LineReportView:
    """Nothing happened, nothing is known."""
    return replace(
        typical(40),
        title="",
        scope="Job report",
        job_file="",
        created="",
        software_version="",
        facts=(),
        planned=None,
        tiles=(),
        unreadable=(),
        strangers=0,
        corrections=(),
        kiln=(),
        innovations=(),
        holds=(),
        downtime=(),
        alarms=(),
        lots=(),
        inks=(),
        limits=LimitsView(),
        variation=None,
        ink_unit="",
        ink_saved_against="",
        worst=(),
        tile_picture=None,
        warnings=(),
        ended_s=BEGUN_S,
    )


def one_tile() -> LineReportView:
    """A job of one tile, photographed, without corrections or kiln."""
    whole = typical(40)
    tile = next(tile for tile in whole.tiles if tile.grade is not None)
    return replace(
        empty(),
        title="One",
        tiles=(tile,),
        lots=whole.lots[:1],
        ended_s=BEGUN_S + 3600.0,
        worst=(WorstTileView(tile, stone(40, 20, 1), None, None),),
        limits=LimitsView(1.5, 3.0),
        alarms=(SpanView(BEGUN_S + 60.0, None, "camera_silent", "no photograph for 10 minutes"),),
    )


def long_job(count: int = 100_000) -> LineReportView:
    """A job of very many tiles over a month, in three shifts a day."""
    whole = typical(300)
    stretch = 28 * 3.0
    times = -(-count // len(whole.tiles))

    def later(at_s: float | None, turn: int) -> float | None:
        if at_s is None:
            return None
        return BEGUN_S + ((at_s - BEGUN_S) / (8 * 3600) + turn) / times * stretch * 8 * 3600

    tiles = tuple(
        replace(
            tile,
            face=turn * len(whole.tiles) + place,
            arm=turn * len(whole.tiles) + place + 1,
            printed_s=later(tile.printed_s, turn),
            fired_s=later(tile.fired_s, turn),
        )
        for turn in range(times)
        for place, tile in enumerate(whole.tiles)
    )[:count]
    shifts = tuple(
        ShiftView(f"shift {place + 1}", BEGUN_S + place * 8 * 3600, BEGUN_S + (place + 1) * 8 * 3600)
        for place in range(int(stretch))
    )
    corrections = tuple(
        replace(one, number=turn * len(whole.corrections) + one.number, at_s=float(later(one.at_s, turn) or 0.0))
        for turn in range(times)
        for one in whole.corrections
    )
    innovations = tuple(
        replace(one, at_s=float(later(one.at_s, turn) or 0.0)) for turn in range(times) for one in whole.innovations
    )
    return replace(
        whole,
        scope="Job report",
        planned=count,
        tiles=tiles,
        corrections=corrections,
        innovations=innovations,
        shifts=shifts,
        ended_s=BEGUN_S + stretch * 8 * 3600,
    )
