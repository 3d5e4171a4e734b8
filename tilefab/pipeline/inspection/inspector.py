"""The inspector of a line: each image of the camera becomes a tile that is known, judged, put down and learnt from."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path

from tilefab.control.drift_events import Event, Rejected
from tilefab.errors import ImageError, JournalError, OutputError, ProfileError, TilefabError
from tilefab.inspection.records import ImageProblem, TileInspection
from tilefab.inspection.shade import ShadeSettings, assign_lot
from tilefab.io.inspection_records import Pictures, SeenTile, SkippedImage
from tilefab.io.inspection_store import InspectionStore
from tilefab.io.journal import CorrectionRecord, PrintRecord, RunRecord
from tilefab.pipeline.inspection.alarm_desk import TOPIC as WARNING
from tilefab.pipeline.inspection.alarm_desk import AlarmDesk
from tilefab.pipeline.inspection.benches import OPEN_AT_ONCE, Bench, Benches, WhenPrinted
from tilefab.pipeline.inspection.correcting import Learnt, control_number
from tilefab.pipeline.inspection.expected import TRANSITS, chosen_print
from tilefab.pipeline.inspection.images import CameraImage
from tilefab.pipeline.inspection.kept import KeptPictures, badness, displaced
from tilefab.pipeline.inspection.line_journal import LineJournal
from tilefab.pipeline.inspection.loop import ColourLoop
from tilefab.pipeline.inspection.messages import Messages
from tilefab.pipeline.inspection.noticing import ImageHealth, defect_runs, is_over, kept_defects, repeating_defects
from tilefab.pipeline.inspection.one_tile import InspectedTile
from tilefab.pipeline.inspection.remembering import RunState, run_name, run_state
from tilefab.pipeline.inspection.watching import CameraFolder, ImageFile, thinned

MOST_WAITING = 400
"""Images that may wait; if there are more, some are left out so that what is learnt is never hours old."""

_AT_ONCE = 8
_FEW_WAITING = 40
_MOST_OF_A_JOB = 5000
"""Faces of a job that are all looked among, if a tile is none of those that were printed."""
_SILENT_TILES = 3
_LONG_S = 120.0
_MISSED_LOOKS = 3
_UNREAD_ROUNDS = 20
"""The daemon makes its journal, or brings it up to date, while it starts."""
_FRAMES_TOLD = 6
_JOURNAL, _DEFECT = "journal", "defect"


@dataclass(frozen=True)
class InspectorSettings:
    """How the inspector works, in minutes and seconds of the clock on the wall.

    Attributes
    ----------
    silent
        How long no image may come although tiles should.
    """

    silent: timedelta


@dataclass(frozen=True, eq=False)
class _Found:
    """A tile that was looked at: the run whose face it shows, if any, and the arm that printed it."""

    tile: InspectedTile
    run: RunRecord | None = None
    bench: Bench | None = None
    record: PrintRecord | None = None
    repeat: bool = False


class Inspector:
    """Works through a camera's images; whoever calls `round` again and again keeps it going.

    Parameters
    ----------
    settings
        How.
    store
        Where all is put down.
    camera
        Where images come from.
    read_image
        Reads one.
    journal
        What was printed.
    benches
        What tiles of a run are inspected with.
    loop
        Learns from tiles, and corrects.
    alarms, messages
        What an operator must know, and what is under way to the daemon.
    pictures
        Of the worst tiles.
    log
        Told of each tile.
    now, monotonic
        The clock on the wall, and one that is never set.
    """

    def __init__(
        self,
        settings: InspectorSettings,
        *,
        store: InspectionStore,
        camera: CameraFolder,
        read_image: Callable[[Path], CameraImage],
        journal: LineJournal,
        benches: Benches,
        loop: ColourLoop,
        alarms: AlarmDesk,
        messages: Messages,
        pictures: KeptPictures,
        log: Callable[..., None],
        now: Callable[[], datetime],
        monotonic: Callable[[], float],
    ) -> None:
        self._settings, self._store, self._camera, self._read_image = settings, store, camera, read_image
        self._journal, self._benches, self._loop, self._alarms = journal, benches, loop, alarms
        self._messages, self._pictures, self._log = messages, pictures, log
        self._now, self._monotonic = now, monotonic
        self._runs: dict[int, RunState] = {}
        self._health = ImageHealth()
        self._missed = self._unread = 0
        self._last_image_at = now()
        self._last_image_s = monotonic()
        for tile in store.tiles(last=TRANSITS):
            if tile.printed_at is not None and not tile.repeat:
                journal.expected.took(tile.taken_at - tile.printed_at)
        pictures.tidy([tile.pictures for tile in store.worst(last=1_000_000) if tile.pictures is not None])

    def round(self) -> int:
        """Do what there is to do, some images at most; how many were dealt with.

        Raises
        ------
        JournalError
            If what was found can't be put down. Whoever starts it anew loses nothing: an image that isn't put down is
            inspected again.
        """
        now, now_s = self._now(), self._monotonic()
        readable = self._journal.follow(now, self._store.seen_arms)
        self._unread = 0 if readable else self._unread + 1
        if self._unread in (0, _UNREAD_ROUNDS):
            self._about("inspection_run", _JOURNAL, self._journal.problem)
        if readable:
            self._loop.follow(now, now_s)
        done = self._look() if readable else 0
        if done:
            # What it took to deal with them isn't the camera's silence.
            self._last_image_s = self._monotonic()
        self._loop.tick(self._now(), self._monotonic())
        self._watch_camera(self._now(), self._monotonic())
        self._talk()
        return done

    def close(self) -> None:
        """End; what is under way to the daemon is left to itself."""
        self._journal.close()

    # Images

    def _look(self) -> int:
        waiting = self._camera.look()
        # A folder may be away for a moment while its disk is mounted.
        self._missed = self._missed + 1 if self._camera.problem else 0
        if self._missed in (0, _MISSED_LOOKS):
            self._about("camera_folder", "", self._camera.problem)
        if len(waiting) > MOST_WAITING:
            waiting, left = thinned(waiting, MOST_WAITING)
            self._skip(left, "the inspector was behind")
            text = f"{len(left)} images were left out, since {len(waiting) + len(left)} waited"
            self._alarms.raise_alarm("inspection_behind", text)
        elif len(waiting) < _FEW_WAITING:
            self._alarms.clear("inspection_behind")
        done = 0
        for image in waiting[:_AT_ONCE]:
            if not self._inspect(image):
                break
            done += 1
        return done

    def _skip(self, images: Sequence[ImageFile], reason: str) -> None:
        self._store.skip([SkippedImage(image.name, image.taken_at, reason) for image in images])
        self._camera.finish([image.name for image in images])
        self._log("images skipped", images=len(images), first=images[0].name, reason=reason)

    def _inspect(self, image: ImageFile) -> bool:
        """Deal with an image; whether it is done with, if only by leaving it out."""
        # A camera whose clock is ahead must not hide that later images don't come.
        self._last_image_at = min(max(image.taken_at, self._last_image_at), self._now())
        self._last_image_s = self._monotonic()
        try:
            picture = self._read_image(image.path)
        except (ImageError, ProfileError) as error:
            if not self._camera.retry(image.name):
                self._skip([image], error.message)
                self._seen_image("unreadable", recognised=False)
            return True
        try:
            found = self._found(image, picture)
            if found is None:
                return False
            learnt = self._learnt(image, found)
        except JournalError:
            raise
        except Exception as error:  # one tile that can't be computed must not end the inspection of all others
            why = error.message if isinstance(error, TilefabError) else f"{type(error).__name__}: {error}"
            if not isinstance(error, TilefabError):
                frames = traceback.extract_tb(error.__traceback__)[-_FRAMES_TOLD:]
                where = [f"{frame.filename}:{frame.lineno} {frame.name}" for frame in frames]
                self._log("defect", image=image.name, error=why, where=where)
            self._skip([image], f"it could not be inspected: {why}")
            self._alarms.raise_alarm("inspection_run", f"{image.name} could not be inspected: {why}", subject=_DEFECT)
            return True
        self._put_down(image, found, learnt)
        self._camera.finish([image.name])
        self._alarms.clear("inspection_run", _DEFECT)
        seen = found.tile.inspection.recognition
        self._seen_image("" if seen.problem is None else seen.problem.value, recognised=seen.face is not None)
        return True

    def _found(self, image: ImageFile, picture: CameraImage) -> _Found | None:
        """Find out which tile it is, and all about it; ``None``: not now, since no job can be opened."""
        first: _Found | None = None
        for run, bench, faces in self._places(image.taken_at):
            if not faces:
                continue
            tile = bench.inspect(picture, faces, partial(self._correction_of, run.run_id, image.taken_at))
            seen = tile.inspection.recognition
            if seen.face is not None:
                record, repeat = self._print_of(run.run_id, seen.face, image.taken_at)
                return _Found(tile, run, bench, record, repeat)
            first = first or _Found(tile)
            if seen.problem not in (None, ImageProblem.WRONG_SIZE):
                # Whatever the job, this image shows no tile.
                return _Found(tile)
        if first is None and self._benches.failures:
            return None
        if first is None:
            raise ImageError("the line has printed nothing that it could show", path=str(image.path))
        return first

    def _places(self, taken_at: datetime) -> Iterator[tuple[RunRecord, Bench, Sequence[int]]]:
        """Where to look for a tile: among faces whose tiles are expected, then in all that the latest runs printed.

        And at last in the whole of these jobs, as far as they are small: a journal that was lost for a while doesn't
        know of everything that was printed.
        """
        expected = self._journal.expected.candidates(taken_at)
        latest = dict.fromkeys([*expected, *sorted(self._journal.runs, reverse=True)])
        benches = [found for run_id in list(latest)[:OPEN_AT_ONCE] if (found := self._bench(run_id)) is not None]
        looked = {run.run_id: expected.get(run.run_id, []) for run, _ in benches}
        for run, bench in benches:
            yield run, bench, looked[run.run_id]
        for run, bench in benches:
            printed = sorted(self._journal.whole_run(run.run_id, self._now()))
            if printed != looked[run.run_id]:
                looked[run.run_id] = printed
                yield run, bench, printed
        for run, bench in benches:
            if looked[run.run_id] and len(looked[run.run_id]) < run.facts.faces <= _MOST_OF_A_JOB:
                yield run, bench, range(run.facts.faces)

    def _bench(self, run_id: int) -> tuple[RunRecord, Bench] | None:
        run = self._journal.runs.get(run_id)
        bench = None if run is None else self._benches.of(run, self._monotonic())
        return None if run is None or bench is None else (run, bench)

    def _correction_of(self, run_id: int, taken_at: datetime, face: int) -> CorrectionRecord | None:
        record, _ = self._print_of(run_id, face, taken_at)
        return None if record is None else self._journal.correction(run_id, record.correction)

    def _print_of(self, run_id: int, face: int, taken_at: datetime) -> tuple[PrintRecord | None, bool]:
        record, seen = self._journal.expected.print_of(run_id, face, taken_at)
        if record is not None and not seen:
            return record, False
        records = self._journal.whole_run(run_id, self._now()).get(face, ())
        known = self._store.seen_arms([one.arm_id for one in records])
        return chosen_print(records, known, taken_at, self._journal.expected.transit)

    # What follows from a tile

    def _learnt(self, image: ImageFile, found: _Found) -> tuple[RunRecord, Bench, Learnt] | None:
        """What the controller makes of an image."""
        now = self._now()
        event: Event | None = None
        if found.run is not None and found.bench is not None:
            run, bench = found.run, found.bench
            if not bench.press or found.repeat or found.record is None:
                return None
            when = WhenPrinted(
                found.record.arm_id,
                control_number(run.run_id, found.record.correction),
                self._loop.seconds(image.taken_at),
                self._loop.seconds(now),
            )
            event = bench.measured(found.tile, self._loop.press(bench, now).control, when)
        else:
            present = self._loop.present_bench(self._monotonic())
            if present is None:
                return None
            run, bench = present
        if event is None:
            event = Rejected(self._loop.seconds(now), found.tile.inspection.recognition.reason)
        return run, bench, self._loop.learnt(bench, [event], now)

    def _put_down(self, image: ImageFile, found: _Found, learnt: tuple[RunRecord, Bench, Learnt] | None) -> None:
        """Put down all that came of an image, in one transaction."""
        inspection, record, run = found.tile.inspection, found.record, found.run
        run_id = None if run is None else run.run_id
        kept, gone = self._kept(image, found)
        with self._store.together("put down a tile"):
            state = None if run_id is None or found.repeat else self._run_state(run_id)
            lot = ""
            if state is not None and run_id is not None:
                state, lot = _with_lot(state, inspection)
                state = replace(state, defects=kept_defects(state.defects, repeating_defects(inspection)))
                self._runs[run_id] = state
                self._store.remember(run_name(run_id), state.text())
                self._watch_defects(run_id, state)
            tile = SeenTile(
                image=image.name,
                taken_at=image.taken_at,
                inspection=inspection,
                run_id=run_id,
                arm_id=None if record is None else record.arm_id,
                correction=None if record is None else record.correction,
                printed_at=None if record is None else record.printed_at,
                repeat=found.repeat,
                shade_lot=lot,
            )
            number = self._store.add_tile(tile, kept)
            self._store.drop_pictures([inspection_id for inspection_id, _ in gone])
            if learnt is not None:
                of_run, bench, told = learnt
                self._loop.keep(bench, of_run.run_id, told, image.taken_at, number)
        self._pictures.remove([pictures for _, pictures in gone])
        if record is not None:
            self._journal.expected.saw(record, image.taken_at)
        self._log_tile(tile)

    def _kept(self, image: ImageFile, found: _Found) -> tuple[Pictures | None, list[tuple[int, Pictures]]]:
        """Keep pictures of a tile if it is among the worst of its run; what is kept, and which aren't any longer."""
        if found.run is None or found.repeat or found.tile.pictures is None:
            return None, []
        run_id, bad = found.run.run_id, badness(found.tile.inspection)
        worth, displaced_tiles = displaced(self._store.worst(run_id), bad)
        if not worth:
            return None, []
        try:
            kept = self._pictures.keep(run_id, image.name, bad, found.tile.pictures)
        except OutputError as error:
            # Pictures are for people; the tile counts without them.
            self._log("picture not kept", image=image.name, why=error.message)
            return None, []
        return kept, [(tile.inspection_id, tile.pictures) for tile in displaced_tiles if tile.pictures is not None]

    def _run_state(self, run_id: int) -> RunState:
        found = self._runs.get(run_id)
        if found is None:
            text = self._store.remembered(run_name(run_id))
            try:
                found = RunState() if text is None else run_state(text)
            except ValueError as error:
                self._log("run forgotten", run=run_id, why=str(error))
                found = RunState()
        return found

    def _log_tile(self, tile: SeenTile) -> None:
        found = tile.inspection
        facts: dict[str, object] = {"image": tile.image, "run": tile.run_id, "face": found.recognition.face}
        if found.recognition.face is None:
            facts["why"] = found.recognition.reason
        else:
            facts |= {"arm": tile.arm_id, "correction": tile.correction, "grade": found.grade.value}
            facts |= {"lot": tile.shade_lot, "defects": [defect.kind.value for defect in found.defects]}
        if found.colour is not None:
            facts["delta_e"] = round(found.colour.delta_e_mean, 2)
        if tile.repeat:
            facts["repeat"] = True
        self._log("tile", **facts)

    # Alarms

    def _about(self, code: str, subject: str, problem: str) -> None:
        """Raise an alarm while there is a problem, and clear it when there is none."""
        if problem:
            self._alarms.raise_alarm(code, problem, subject=subject)
        else:
            self._alarms.clear(code, subject)

    def _seen_image(self, problem: str, *, recognised: bool) -> None:
        self._health.saw(problem, recognised=recognised)
        unusable = self._health.unusable
        if unusable or self._health.usable:
            self._about("inspection_images", "", unusable)
        self._about("inspection_strangers", "", self._health.strange)

    def _watch_defects(self, run_id: int, state: RunState) -> None:
        for found in defect_runs(state.defects):
            self._alarms.raise_alarm("defect_run", found.text, subject=found.subject, run_id=run_id)
        for subject in self._alarms.subjects("defect_run"):
            if is_over(subject, state.defects):
                self._alarms.clear("defect_run", subject)

    def _watch_camera(self, now: datetime, now_s: float) -> None:
        quiet_s = now_s - self._last_image_s
        # Tiles that should have come since the last image, as the line's journal and their usual way have it.
        due = self._journal.expected.leaving(self._last_image_at, now)
        if quiet_s < self._settings.silent.total_seconds():
            self._alarms.clear("camera_silent")
        elif due >= _SILENT_TILES and not self._alarms.is_up("camera_silent"):
            quiet = f"{quiet_s / 60.0:.0f} minutes" if quiet_s >= _LONG_S else f"{quiet_s:.0f} seconds"
            text = f"no image for {quiet}, though {due} tiles should have left the kiln"
            self._alarms.raise_alarm("camera_silent", text)

    def _talk(self) -> None:
        now_s = self._monotonic()
        for answer in self._messages.answers():
            if answer.topic == WARNING:
                self._alarms.told(answer, now_s)
            else:
                self._loop.answered(answer)
        self._loop.send()
        failures = self._benches.failures
        for run_id, why in failures.items():
            text = f"tiles of run {run_id} can't be inspected: {why}"
            self._alarms.raise_alarm("inspection_run", text, subject=str(run_id), run_id=run_id)
        for subject in self._alarms.subjects("inspection_run"):
            if subject.isdigit() and int(subject) not in failures:
                self._alarms.clear("inspection_run", subject)
        self._alarms.tell(now_s)


def _with_lot(state: RunState, inspection: TileInspection) -> tuple[RunState, str]:
    """Give a tile its shade lot, by how far its colour is from that of its own face."""
    colour = inspection.colour
    if colour is None:
        return state, ""
    reference = state.reference_lab or colour.predicted_lab
    fired, predicted = colour.fired_lab, colour.predicted_lab
    offset = fired[0] - predicted[0], fired[1] - predicted[1], fired[2] - predicted[2]
    shade, lot = assign_lot(state.shade, offset, ShadeSettings(reference_lab=reference))
    return replace(state, shade=shade, reference_lab=reference), lot
