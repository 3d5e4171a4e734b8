"""A line for the inspector's tests: a real journal, store and folder, with tiles, press, daemon and clock made up."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilefab.control.drift_control import expected, start_control
from tilefab.control.drift_control_state import ControlSettings, DriftControl
from tilefab.control.drift_events import Propose, TileMeasured
from tilefab.control.ledger import ArmState
from tilefab.errors import DeviceRefused, ImageError, TilefabError
from tilefab.inspection.records import (
    ColourFigures,
    Defect,
    Grade,
    ImageProblem,
    Recognition,
    TileInspection,
)
from tilefab.io.inspection_store import InspectionStore
from tilefab.io.journal import ArmChange, CorrectionRecord, Journal, RunFacts, RunRecord, sqlite_url
from tilefab.pipeline.inspection.alarm_desk import AlarmDesk
from tilefab.pipeline.inspection.benches import Bench, Benches, WhenPrinted
from tilefab.pipeline.inspection.expected import ExpectedTiles
from tilefab.pipeline.inspection.images import CameraImage
from tilefab.pipeline.inspection.inspector import Inspector, InspectorSettings
from tilefab.pipeline.inspection.kept import KeptPictures
from tilefab.pipeline.inspection.line_journal import LineJournal
from tilefab.pipeline.inspection.loop import ColourLoop, LoopSettings
from tilefab.pipeline.inspection.messages import Messages
from tilefab.pipeline.inspection.one_tile import InspectedTile, TilePictures
from tilefab.pipeline.inspection.watching import CameraFolder

LINE = "line 1"
BEGIN = datetime(2026, 11, 24, 8, 0, tzinfo=UTC)
TRANSIT = timedelta(minutes=50)
NOISE = 0.1

Lab = tuple[float, float, float]
_PICTURE = np.zeros((4, 4, 3), dtype=np.uint8)


@dataclass
class Clock:
    """Time, that only passes when it is told to."""

    at: datetime = BEGIN
    s: float = 1000.0

    def now(self) -> datetime:
        return self.at

    def monotonic(self) -> float:
        return self.s

    def pass_(self, seconds: float) -> None:
        self.at += timedelta(seconds=seconds)
        self.s += seconds


@dataclass(frozen=True)
class Shown:
    """What an image shows."""

    face: int | None = None
    problem: ImageProblem | None = None
    offset: Lab = (0.0, 0.0, 0.0)
    defects: tuple[Defect, ...] = ()
    grade: Grade = Grade.FIRST
    fails: Exception | None = None


class MadeUpBench:
    """Knows what images show, since it was told. Corrections and tiles are in L*, a*, b* themselves."""

    press = "press a"
    begun: NDArray[np.float64] = np.zeros(3)

    def __init__(self, shown: Mapping[str, Shown]) -> None:
        self._shown = shown
        self.asked: list[tuple[str, tuple[int, ...]]] = []
        self.corrections: list[int] = []

    def start(self, now_s: float, settings: ControlSettings) -> DriftControl:
        return start_control(np.eye(3), now_s=now_s, settings=settings)

    def inspect(
        self, image: CameraImage, faces: Sequence[int], correction_of: Callable[[int], CorrectionRecord | None]
    ) -> InspectedTile:
        self.asked.append((image.name, tuple(faces)))
        shown = self._shown[image.name]
        if shown.fails is not None:
            raise shown.fails
        face = shown.face if shown.face in faces else None
        reason = "" if face is not None else "none of these" if shown.problem is None else "no tile"
        seen = Recognition(face, 0, (), 0.99, 0.9, 0.1, 1.0, shown.problem, reason)
        if face is None:
            return InspectedTile(TileInspection(seen, None, None, (), Grade.SCRAP, (reason,)))
        correction = correction_of(face)
        self.corrections.append(0 if correction is None else correction.number)
        mean = float(np.linalg.norm(shown.offset))
        fired = (60.0 + shown.offset[0], 1.0 + shown.offset[1], 5.0 + shown.offset[2])
        figures = (mean, 2 * mean, 3 * mean, (10.0, 10.0), mean, 2 * mean, shown.offset[0], 0.0, 0.0)
        colour = ColourFigures(*figures, fired_lab=fired, predicted_lab=(60.0, 1.0, 5.0))
        inspection = TileInspection(seen, colour, None, shown.defects, shown.grade, ())
        return InspectedTile(inspection, pictures=TilePictures(_PICTURE, _PICTURE))

    def measured(self, tile: InspectedTile, control: DriftControl, when: WhenPrinted) -> TileMeasured | None:
        colour = tile.inspection.colour
        assert colour is not None
        applied = dict(control.corrections).get(when.correction, np.zeros(3))
        # A tile printed for a state of the press is off by what the press is off that state.
        state = np.subtract(colour.fired_lab, colour.predicted_lab) + applied
        at = expected(control, when.correction)
        information = np.eye(3) / NOISE**2
        return TileMeasured(
            tile=when.arm_id,
            correction=when.correction,
            fired_at_s=when.fired_s,
            measured_at_s=when.measured_s,
            at=at,
            information=information,
            vector=information @ (state - at),
            effect=np.eye(3),
            watch=np.eye(3),
        )

    def drift(self, proposal: Propose, tiles: int, note: str) -> str:
        return json.dumps({"mean": proposal.mean.tolist(), "tiles": tiles, "note": note})

    def state(self, correction: CorrectionRecord) -> NDArray[np.float64]:
        return np.array(json.loads(correction.drift)["mean"])


class MadeUpDaemon:
    """Takes corrections and warnings, unless it is told to refuse or to be away."""

    def __init__(self) -> None:
        self.corrections: list[tuple[int, Mapping[str, Any], str]] = []
        self.warnings: list[tuple[str, str]] = []
        self.refuses = ""
        self.away = False

    def correct(self, run_id: int, drift: Mapping[str, Any], reason: str) -> int:
        self._there()
        if self.refuses:
            raise DeviceRefused(self.refuses)
        self.corrections.append((run_id, drift, reason))
        return len(self.corrections)

    def warn(self, code: str, text: str) -> None:
        self._there()
        self.warnings.append((code, text))

    def _there(self) -> None:
        if self.away:
            raise DeviceRefused("no daemon runs on this line")


class AtOnce(Messages):
    """Sends messages before anything else goes on."""

    def send(self, topic: str, number: int, work: Callable[[], int | None]) -> None:
        self._under_way.add(topic)
        self._run(topic, number, work)


@dataclass
class World:
    """All of it. Close it by its ``stack``."""

    folder: Path
    settings: LoopSettings = field(
        default_factory=lambda: LoopSettings(ControlSettings(least_interval_s=300.0, fewest_tiles=3))
    )
    clock: Clock = field(default_factory=Clock)
    daemon: MadeUpDaemon = field(default_factory=MadeUpDaemon)
    shown: dict[str, Shown] = field(default_factory=dict)
    log: list[tuple[str, dict[str, object]]] = field(default_factory=list)
    unreadable: set[str] = field(default_factory=set)
    closed_jobs: set[int] = field(default_factory=set)
    stack: ExitStack = field(default_factory=ExitStack)

    def __post_init__(self) -> None:
        self.journal_url = sqlite_url(self.folder / "journal.db")
        self.camera = self.folder / "camera"
        self.camera.mkdir(exist_ok=True)
        self.bench = MadeUpBench(self.shown)
        self._journal: Journal | None = None

    @property
    def journal(self) -> Journal:
        """The daemon's."""
        if self._journal is None:
            self._journal = self.stack.enter_context(Journal.open(self.journal_url, line=LINE, now=self.clock.now))
        return self._journal

    def run(self, faces: int = 1000, name: str = "a job") -> int:
        facts = RunFacts(job_hash=name, name=name, job_file=f"/{name}.toml", faces=faces, seed=1, map_hash="ab")
        return self.journal.start_run(facts)

    def print_(self, run_id: int, *faces: int, correction: int = 0) -> list[int]:
        """Print faces now; their arms."""
        attempts = []
        for face in faces:
            last = self.journal.arm_of(run_id, face)
            if last is not None:
                self.journal.order_reprint(run_id, face)
            attempts.append((face, 1 if last is None else last.attempt + 1))
        arms = [intent.arm_id for intent in self.journal.intend(run_id, attempts, correction=correction)]
        for state in (ArmState.ARMED, ArmState.PRINTED, ArmState.PASSED):
            self.journal.mark([ArmChange(arm_id, state) for arm_id in arms])
        return arms

    def photograph(self, shown: Shown, at: datetime | None = None, name: str = "") -> str:
        """Put an image into the camera's folder; its name."""
        taken = self.clock.at if at is None else at
        name = name or f"{taken:%Y%m%dT%H%M%S}.{taken.microsecond // 1000:03}Z_{len(self.shown)}.png"
        self.shown[name] = shown
        (self.camera / name).write_bytes(b"an image")
        return name

    def inspector(self, stack: ExitStack | None = None, *, silent: timedelta = timedelta(minutes=10)) -> Inspector:
        """An inspector, as when it is started; ended with ``stack``, or with the world."""
        stack = self.stack if stack is None else stack
        store = stack.enter_context(InspectionStore.open(self.store_url, line=LINE, now=self.clock.now))
        messages = AtOnce()
        alarms = AlarmDesk(store, self.daemon, messages, self._log)
        journal = LineJournal(lambda: Journal.look(self.journal_url, line=LINE), ExpectedTiles(timedelta(minutes=180)))
        stack.callback(journal.close)
        benches = Benches(self._open)
        return Inspector(
            InspectorSettings(silent),
            store=store,
            camera=CameraFolder(self.camera, store.done_images),
            read_image=self._read,
            journal=journal,
            benches=benches,
            loop=ColourLoop(self.settings, store, journal, benches, self.daemon, messages, alarms, self._log),
            alarms=alarms,
            messages=messages,
            pictures=KeptPictures(self.pictures),
            log=self._log,
            now=self.clock.now,
            monotonic=self.clock.monotonic,
        )

    @property
    def store_url(self) -> str:
        return sqlite_url(self.folder / "inspection.db")

    @property
    def pictures(self) -> Path:
        return self.folder / "pictures"

    def look(self) -> InspectionStore:
        """The store, for looking on."""
        return self.stack.enter_context(InspectionStore.look(self.store_url, line=LINE))

    def told(self, kind: str) -> list[dict[str, object]]:
        return [facts for found, facts in self.log if found == kind]

    def _log(self, kind: str, **facts: object) -> None:
        self.log.append((kind, facts))

    def _read(self, path: Path) -> CameraImage:
        if path.name in self.unreadable:
            raise ImageError(f"{path}: can't be read")
        return CameraImage(path.name, np.zeros((1, 1, 3), dtype=np.float32))

    def _open(self, run: RunRecord) -> Bench:
        if run.run_id in self.closed_jobs:
            raise TilefabError(f"{run.facts.job_file}: there is no such file")
        return self.bench
