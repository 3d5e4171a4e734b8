"""The report of a line's run, or of a shift of it: from journal, inspections and job to what the pages show."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from tilefab import __version__
from tilefab.config.line import LineFile
from tilefab.errors import JournalError, ProfileError
from tilefab.inspection.records import Defect, ImageProblem, TileDimensions
from tilefab.io.atomic import atomic_write_bytes
from tilefab.io.drift_file import parse_drift
from tilefab.io.inspection_records import InnovationRecord, InspectionAlarm, InspectionRecord
from tilefab.io.inspection_store import InspectionStore, pictures_folder
from tilefab.io.journal import ArmRecord, Journal, RunRecord
from tilefab.pipeline.inspection.job_facts import JobFacts, job_facts
from tilefab.pipeline.inspection.pictures import read_picture
from tilefab.pipeline.inspection.places import store_url
from tilefab.pipeline.inspection.report_spans import (
    inspector_alarms,
    kiln_zones,
    line_alarms,
    shade_lots,
    shifts,
    stops,
)
from tilefab.pipeline.progress import Progress
from tilefab.report.line_build import build_line_report
from tilefab.report.line_json import line_report_json
from tilefab.report.line_view import (
    CorrectionView,
    InnovationView,
    LimitsView,
    LineReportView,
    SpanView,
    TileView,
    WorstTileView,
)

HELD = "colour_held"
"""Code of the inspector's alarm that corrections are withheld."""

_IN_WORDS = {
    ImageProblem.BLACK: "black images",
    ImageProblem.BLOWN_OUT: "blown-out images",
    ImageProblem.TORN: "torn images",
    ImageProblem.NO_TILE: "images without a tile",
    ImageProblem.TWO_TILES: "images of two tiles",
    ImageProblem.WRONG_SIZE: "images of a tile of another size",
}
_WORST = 10
_MOST_RUNS = 100_000


@dataclass(frozen=True)
class Span:
    """What of a run a report is about.

    Attributes
    ----------
    begun, ended
        From when to when; ``None``: from its beginning, to its end.
    """

    begun: datetime | None = None
    ended: datetime | None = None

    @property
    def whole(self) -> bool:
        """Whether it is the whole run."""
        return self.begun is None and self.ended is None

    def holds(self, at: datetime | None) -> bool:
        """Whether a moment lies in it; one that isn't known lies in the whole run only."""
        if at is None:
            return self.whole
        return (self.begun is None or at >= self.begun) and (self.ended is None or at < self.ended)


WHOLE = Span()


def reported_runs(line_file: LineFile, run_id: int | None, span: Span) -> list[RunRecord]:
    """Runs that a report is asked for: one by its number, those of a shift, or else the newest.

    Raises
    ------
    JournalError
        If there is no such run.
    """
    with Journal.look(line_file.journal_url, line=line_file.name) as journal:
        runs = journal.runs(last=_MOST_RUNS)
        if run_id is not None:
            runs = [run for run in runs if run.run_id == run_id]
        elif span.whole:
            runs = runs[-1:]
        else:
            printed = {print_.run_id for print_ in journal.prints(since=span.begun, until=span.ended)}
            runs = [run for run in runs if run.run_id in printed | _seen_runs(line_file, span)]
    if not runs:
        what = f"run {run_id}" if run_id is not None else "run" if span.whole else "run that printed in that time"
        raise JournalError(
            f"{line_file.journal_url}: line {line_file.name!r} has no {what}", path=line_file.journal_url
        )
    return runs


def _seen_runs(line_file: LineFile, span: Span) -> set[int]:
    """Runs of which tiles came out of the kiln in a span."""
    url = store_url(line_file)
    if not InspectionStore.exists(url, line=line_file.name):
        return set()
    with InspectionStore.look(url, line=line_file.name) as store:
        return {tile.run_id for tile in store.tiles(since=span.begun, until=span.ended) if tile.run_id is not None}


def line_report_view(
    line_file: LineFile,
    run: RunRecord,
    span: Span,
    progress: Progress,
    *,
    now: datetime,
    utc_offset: timedelta = timedelta(0),
) -> LineReportView:
    """Gather all that the report of a run shows.

    Parameters
    ----------
    line_file
        The line.
    run
        The run.
    span
        The part of it.
    progress
        Who watches: the job's maps may have to be made.
    now
        When the report is made.
    utc_offset
        Of the factory's clock.

    Raises
    ------
    JournalError
        If journal or inspections can't be read.
    """
    gathered = _Gathered(line_file, run, span)
    facts = job_facts(Path(run.facts.job_file), run.facts.job_hash, progress)
    return _View(gathered, facts if isinstance(facts, JobFacts) else None, now, utc_offset).view(
        () if isinstance(facts, JobFacts) else (facts,)
    )


class _Gathered:
    """What journal and store hold of a run."""

    def __init__(self, line_file: LineFile, run: RunRecord, span: Span) -> None:
        self.line_file, self.run, self.span = line_file, run, span
        run_id = run.run_id
        with Journal.look(line_file.journal_url, line=line_file.name) as journal:
            arms = [arm for arm in journal.arms(run_id) if arm.printed_at is not None]
            self.corrections = journal.corrections(run_id)
            begun = span.begun or run.begun_at
            self.notes = journal.notes_between(begun, span.ended or run.finished_at, kinds=("state", "alarm", "kiln"))
        self.pictures = pictures_folder(line_file.state_directory)
        self.tiles: list[InspectionRecord] = []
        self.others: list[InspectionRecord] = []
        self.defects: dict[int, list[Defect]] = defaultdict(list)
        self.reasons: dict[int, tuple[str, ...]] = {}
        self.worst: list[InspectionRecord] = []
        self.innovations: list[InnovationRecord] = []
        self.alarms: list[InspectionAlarm] = []
        # A tile belongs to the shift in which it was photographed, or printed as long as it wasn't photographed.
        self.arms = [arm for arm in arms if span.holds(arm.printed_at)]
        url = store_url(line_file)
        if not InspectionStore.exists(url, line=line_file.name):
            return
        with InspectionStore.look(url, line=line_file.name) as store:
            since, until = span.begun, span.ended
            self.tiles = [tile for tile in store.tiles(run_id) if not tile.repeat]
            taken = {tile.arm_id: tile.taken_at for tile in self.tiles}
            self.arms = [arm for arm in arms if span.holds(taken.get(arm.arm_id, arm.printed_at))]
            last = max((tile.taken_at for tile in self.tiles), default=run.begun_at)
            seen_until = until or last + timedelta(seconds=1)
            self.others = [
                tile
                for tile in store.tiles(since=since or run.begun_at, until=seen_until)
                if tile.run_id is None and tile.face is None
            ]
            for found in store.defects(run_id):
                self.defects[found.inspection_id].append(found.defect)
            kept = {arm.arm_id for arm in self.arms}
            self.worst = [tile for tile in store.worst(run_id) if tile.arm_id in kept][:_WORST]
            for tile in self.worst:
                whole = store.full(tile.inspection_id)
                self.reasons[tile.inspection_id] = () if whole is None else whole.reasons
            self.innovations = store.innovations(run_id, since=since, until=until)
            self.alarms = store.alarms(since=since or run.begun_at, until=seen_until)


class _View:
    def __init__(self, gathered: _Gathered, facts: JobFacts | None, now: datetime, utc_offset: timedelta) -> None:
        self.of, self.facts, self.now, self.utc_offset = gathered, facts, now, utc_offset

    def view(self, warnings: tuple[str, ...]) -> LineReportView:
        of, run, facts = self.of, self.of.run, self.facts
        by_arm = {tile.arm_id: tile for tile in of.tiles}
        tiles = tuple(self._tile(arm, by_arm.get(arm.arm_id)) for arm in of.arms)
        begun, ended = self._span(tiles)
        printed = [tile.face for tile in tiles]
        colours = [tile.colour for tile in tiles if tile.colour is not None]
        size = facts.plan.tile_mm if facts is not None else None
        return LineReportView(
            title=run.facts.name,
            scope="Job report" if of.span.whole else "Shift report",
            line=of.line_file.name,
            run=run.run_id,
            job_file=run.facts.job_file,
            job_hash=run.facts.job_hash,
            map_hash=run.facts.map_hash,
            profile_hash=facts.plan.press_profile.sha256 if facts is not None else "",
            created=(self.now + self.utc_offset).strftime("%Y-%m-%d %H:%M"),
            software_version=__version__,
            begun_s=begun,
            ended_s=ended,
            utc_offset_min=round(self.utc_offset.total_seconds() / 60),
            facts=self._facts(),
            tile_size_mm=(size.width, size.height) if size is not None else self._measured_size(),
            planned=run.facts.faces,
            tiles=tiles,
            unreadable=self._unreadable(),
            strangers=sum(tile.problem is None for tile in of.others),
            corrections=self._corrections(),
            kiln=kiln_zones(of.notes),
            innovations=tuple(_innovation(one) for one in of.innovations),
            holds=inspector_alarms([alarm for alarm in of.alarms if alarm.code == HELD]),
            downtime=stops(of.notes, ended),
            alarms=self._alarms(),
            lots=shade_lots([tile for tile in of.tiles if of.span.whole or of.span.holds(tile.taken_at)]),
            inks=facts.inks(len(tiles)) if facts is not None else (),
            shifts=shifts(begun, ended, self.utc_offset) if of.span.whole else (),
            limits=self._limits(),
            variation=facts.variation(printed, colours) if facts is not None else None,
            ink_unit="m² of full cover",
            ink_saved_against="the profile's own separation of the same colours",
            worst=self._worst(tiles),
            tile_picture=facts.picture(printed[0] if printed else 0) if facts is not None else None,
            warnings=warnings,
        )

    def _facts(self) -> tuple[tuple[str, str], ...]:
        if self.facts is None:
            return ()
        plan = self.facts.plan
        return (
            ("Stone", ", ".join(scan.path.name for scan in plan.scans)),
            ("Tile", f"{plan.tile_mm.width:g} x {plan.tile_mm.height:g} mm, {plan.job.tile.dpi:g} dpi"),
            ("Press", plan.press_profile.description),
            ("Inks", ", ".join(plan.ink_names)),
            ("Seed", str(plan.seed)),
        )

    def _span(self, tiles: Sequence[TileView]) -> tuple[float, float]:
        """Of a shift, as it was asked for; of a whole run, from its beginning to the last that is known of a tile."""
        span, run = self.of.span, self.of.run
        begun = (span.begun or run.begun_at).timestamp()
        if span.ended is not None:
            return begun, max(begun + 1.0, min(span.ended, self.now).timestamp())
        moments = [moment for tile in tiles for moment in (tile.printed_s, tile.fired_s) if moment is not None]
        return begun, max([begun + 1.0, *moments])

    def _measured_size(self) -> tuple[float, float]:
        """Of the tiles, where the job can't be asked."""
        sizes = [tile.sizes for tile in self.of.tiles if tile.sizes is not None]
        if not sizes:
            return 100.0, 100.0
        return float(np.median([size[0] for size in sizes])), float(np.median([size[1] for size in sizes]))

    def _tile(self, arm: ArmRecord, found: InspectionRecord | None) -> TileView:
        printed_s = None if arm.printed_at is None else arm.printed_at.timestamp()
        if found is None:
            return TileView(arm.face, arm.arm_id, arm.correction, printed_s)
        return TileView(
            face=arm.face,
            arm=arm.arm_id,
            correction=arm.correction,
            printed_s=printed_s,
            fired_s=found.taken_at.timestamp(),
            image=found.image,
            grade=found.grade,
            colour=found.colour,
            dimensions=_dimensions(found.sizes, self._calibrated),
            defects=tuple(self.of.defects.get(found.inspection_id, ())),
            lot=found.shade_lot,
            reasons=self.of.reasons.get(found.inspection_id, ()),
        )

    @property
    def _calibrated(self) -> bool:
        """Whether the line's camera knows its scale."""
        camera = self.of.line_file.line.camera
        return camera is not None and camera.px_per_mm is not None

    def _unreadable(self) -> tuple[tuple[str, int], ...]:
        counted = Counter(tile.problem for tile in self.of.others if tile.problem is not None)
        return tuple((_IN_WORDS[problem], many) for problem, many in counted.most_common())

    def _corrections(self) -> tuple[CorrectionView, ...]:
        views = []
        for made in self.of.corrections:
            if not self.of.span.whole and not self.of.span.holds(made.made_at):
                continue
            sha256, off = "", None
            try:
                drift, sha256 = parse_drift(made.drift.encode(), f"correction {made.number}")
            except ProfileError:
                pass  # the journal's text was damaged; when and why it was made is still told
            else:
                off = self.facts.drift_delta_e(drift.state) if self.facts is not None else None
            views.append(CorrectionView(made.number, made.made_at.timestamp(), made.reason, sha256, off))
        return tuple(views)

    def _alarms(self) -> tuple[SpanView, ...]:
        own = inspector_alarms([alarm for alarm in self.of.alarms if alarm.code != HELD and not alarm.told])
        return tuple(sorted((*line_alarms(self.of.notes), *own), key=lambda alarm: alarm.begun_s))

    def _limits(self) -> LimitsView:
        limits = self.of.line_file.line.tolerances
        return LimitsView(
            limits.delta_e_mean,
            limits.delta_e_p95,
            limits.size_percent,
            limits.straightness_percent,
            limits.rectangularity_percent,
        )

    def _worst(self, tiles: Sequence[TileView]) -> tuple[WorstTileView, ...]:
        by_arm = {tile.arm: tile for tile in tiles}
        views = []
        for found in self.of.worst:
            if found.arm_id is None or found.pictures is None:
                continue
            kept = self.of.pictures
            predicted, fired = (read_picture(kept / name) for name in (found.pictures.predicted, found.pictures.fired))
            views.append(WorstTileView(by_arm[found.arm_id], predicted, fired))
        return tuple(views)


def _innovation(one: InnovationRecord) -> InnovationView:
    return InnovationView(one.at.timestamp(), one.values[0], one.accepted)


def _dimensions(sizes: tuple[float, float, float, float, float] | None, calibrated: bool) -> TileDimensions | None:
    """Dimensions from what the store holds in columns: means of opposite sides stand for each of them."""
    if sizes is None:
        return None
    width, height, size, straightness, rectangularity = sizes
    long = max(width, height)
    return TileDimensions(
        sides_mm=(width, height, width, height),
        width_mm=width,
        height_mm=height,
        size_deviation_percent=size,
        straightness_mm=straightness / 100.0 * long,
        straightness_percent=straightness,
        rectangularity_mm=rectangularity / 100.0 * long,
        rectangularity_percent=rectangularity,
        scale_known=calibrated,
    )


def write_line_reports(
    line_file: LineFile,
    output: Path,
    run_id: int | None,
    span: Span,
    progress: Progress,
    *,
    now: datetime,
    utc_offset: timedelta = timedelta(0),
) -> list[Path]:
    """Write the report of a run, or those of all runs of a shift, each as PDF and as JSON.

    Parameters
    ----------
    line_file, span, progress, now, utc_offset
        See `line_report_view`.
    output
        The PDF; where there are several runs, each gets its number into the name.
    run_id
        The run; ``None``: those of the span, or the newest.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    JournalError
        If there is no such run, or journal or inspections can't be read.
    ReportError
        If a page can't be drawn.
    OutputError
        If a file can't be written.
    """
    runs = reported_runs(line_file, run_id, span)
    files = []
    for run in runs:
        view = line_report_view(line_file, run, span, progress, now=now, utc_offset=utc_offset)
        pdf = output if len(runs) == 1 else output.with_name(f"{output.stem}_run{run.run_id}{output.suffix}")
        atomic_write_bytes(pdf, build_line_report(view))
        text = json.dumps(line_report_json(view), indent=1, ensure_ascii=False, allow_nan=False)
        atomic_write_bytes(pdf.with_suffix(".json"), text.encode())
        files += [pdf, pdf.with_suffix(".json")]
    return files
