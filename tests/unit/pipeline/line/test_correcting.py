"""Corrections in the middle of a run: what is taken, what is refused, and what is kept ready for its arms."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Collection
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, cast

import pytest

from tests.line_workshop import QuickMaps, made_up_drift, write_job, write_slab
from tests.unit.web.line_at_work import LINE
from tilefab.config import load_job, load_line
from tilefab.control.ledger import ArmState
from tilefab.errors import InterlockError, OutputError, ProfileError, TextureMapError
from tilefab.io.drift_file import parse_drift
from tilefab.io.journal import ArmChange
from tilefab.pipeline.line.correcting import Corrector
from tilefab.pipeline.line.jobs import LineJob, line_job
from tilefab.pipeline.line.keeper import JournalKeeper
from tilefab.pipeline.line.present_run import PresentRun
from tilefab.pipeline.line.source import FaceSource
from tilefab.pipeline.line.streaming import Streamer
from tilefab.pipeline.maps import JobMaps, job_maps
from tilefab.pipeline.plan import Plan, plan_job
from tilefab.pipeline.progress import Silent
from tilefab.sampling import TextureMap


@dataclass
class Host:
    """The line, as the present run sees it."""

    streamer: None = None


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, JobMaps]:
    """A small job and its maps."""
    folder = tmp_path_factory.mktemp("job")
    write_slab(folder)
    plan = plan_job(load_job(write_job(folder, count=40)))
    return plan, job_maps(plan, Silent(), 1)


class Maps(QuickMaps):
    """Maps that can be held up, fail, or be damaged."""

    def __init__(self, own: TextureMap) -> None:
        super().__init__(own)
        self.may = asyncio.Event()
        self.may.set()
        self.fails = False
        self.damaged = 0
        self.forgotten = 0
        self.tidied: list[tuple[list[str], float]] = []

    async def make(self, plan: Plan) -> None:
        await self.may.wait()
        if self.fails:
            raise OutputError("the disk is full")
        await super().make(plan)

    def load(self, plan: Plan, texture_hash: str) -> TextureMap:
        if self.damaged:
            self.damaged -= 1
            raise TextureMapError("a bit was flipped")
        return super().load(plan, texture_hash)

    def forget(self, plan: Plan) -> None:
        super().forget(plan)
        self.forgotten += 1

    def tidy(self, plan: Plan, in_use: Collection[str], keep_s: float) -> None:
        super().tidy(plan, in_use, keep_s)
        self.tidied.append((list(in_use), keep_s))


@dataclass
class Bench:
    """A corrector with a journal, and a run that it corrects."""

    plan: Plan
    keeper: JournalKeeper
    work: PresentRun
    maps: Maps
    corrector: Corrector
    told: list[tuple[str, dict[str, Any]]]
    late_min: float = 0.0

    @property
    def run_id(self) -> int:
        assert self.work.book is not None
        return self.work.book.run_id

    @property
    def source(self) -> FaceSource:
        assert self.work.source is not None
        return self.work.source

    async def correct(self, number: int, reason: str = "fired darker") -> int:
        return await self.corrector.correct(self.run_id, made_up_drift(self.plan, number), reason)

    async def fill(self) -> list[int]:
        """Put the next faces down; corrections of all that wait for a tile."""
        assert self.work.book is not None
        await self.work.fill(self.work.book)
        return [intent.correction for intent in self.work.book.pool]

    async def bring(self, state: ArmState, many: int) -> None:
        """Give faces that wait to tiles, and bring them to a state."""
        book = self.work.book
        assert book is not None
        intents = [book.pool.popleft() for _ in range(many)]
        await self.keeper.mark([ArmChange(intent.arm_id, state) for intent in intents], "armed")


@asynccontextmanager
async def bench(
    folder: Path, made: tuple[Plan, JobMaps], settings: str = "", *, probe: Callable[[str], None] = lambda _: None
) -> AsyncIterator[Bench]:
    """A bench whose journal lies in a folder; what an earlier one left there is gone on with."""
    path = folder / "line.toml"
    path.write_text(LINE + f"[inspection]\n{settings}\n")
    line_file = load_line(path)
    line_file.state_directory.mkdir(exist_ok=True)
    plan, maps = made
    job = line_job(plan, line_file)
    keeper = JournalKeeper(line_file.journal_url, line_file.name)
    await keeper.open()
    told: list[tuple[str, dict[str, Any]]] = []

    def opened(_job: LineJob, rows: int) -> FaceSource:
        return FaceSource(plan, maps, rows)

    work = PresentRun(cast(Any, Host()), keeper, [job], opened, 16)
    quick = Maps(maps.press)
    here = Bench(plan, keeper, work, quick, cast(Any, None), told)
    here.corrector = Corrector(
        line_file,
        keeper,
        work,
        quick,
        lambda kind, **facts: told.append((kind, facts)),
        probe,
        now=lambda: datetime.now(UTC) + timedelta(minutes=here.late_min),
    )
    try:
        await work.take()
        yield here
    finally:
        await keeper.close()


Made = tuple[Plan, JobMaps]


def test_faces_that_are_not_put_down_yet_get_the_correction(tmp_path: Path, made: Made) -> None:
    async def scenario() -> None:
        async with bench(tmp_path, made) as here:
            assert await here.fill() == [0] * 12
            assert await here.correct(1) == 1
            await here.bring(ArmState.UNPRINTED, 5)
            assert await here.fill() == [0] * 7 + [1] * 5
            (record,) = await here.keeper.call(lambda journal: journal.corrections(here.run_id))
            assert record == here.work.correction
            assert record.reason == "fired darker"
            state, _ = parse_drift(record.drift.encode(), "record")
            wanted, _ = parse_drift(json.dumps(made_up_drift(here.plan, 1)).encode(), "wanted")
            assert (state.state.mean == wanted.state.mean).all()
            ((kind, facts),) = here.told
            assert (kind, facts["run_id"], facts["number"], facts["reason"]) == (
                "correction",
                here.run_id,
                1,
                "fired darker",
            )
            assert facts["version"]
            assert here.source.checksum(0, 1) != here.source.checksum(0)
            assert here.maps.tidied == [([record.press_key], 180 * 60)]

    asyncio.run(scenario())


def test_what_is_in_use_may_be_asked_for_again(tmp_path: Path, made: Made) -> None:
    async def scenario() -> None:
        async with bench(tmp_path, made) as here:
            assert [await here.correct(1), await here.correct(1, "lost the answer")] == [1, 1]
            assert len(here.maps.made) == 1
            assert len(await here.keeper.call(lambda journal: journal.corrections(here.run_id))) == 1

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("settings", "late_min", "refused"),
    [
        ("correction_interval_min = 10", 9.0, True),
        ("correction_interval_min = 10", 10.1, False),
        (
            "correction_interval_min = 10",
            -60.0,
            False,
        ),  # the clock was put back: there is no telling how long ago it was
        ("correction_interval_min = 0", 0.0, False),
        ("correction_interval_min = 60\nclock_rate = 60", 0.9, True),
        ("correction_interval_min = 60\nclock_rate = 60", 1.1, False),
    ],
)
def test_corrections_keep_their_distance(
    tmp_path: Path, made: Made, settings: str, late_min: float, refused: bool
) -> None:
    async def scenario() -> None:
        async with bench(tmp_path, made, settings) as here:
            await here.correct(1)
            here.late_min = late_min
            if refused:
                with pytest.raises(InterlockError, match="correction 1 was made"):
                    await here.correct(2)
                assert len(here.maps.made) == 1
            else:
                assert await here.correct(2) == 2

    asyncio.run(scenario())


def test_only_the_present_run_is_corrected(tmp_path: Path, made: Made) -> None:
    async def scenario() -> None:
        async with bench(tmp_path, made) as here:
            drift = made_up_drift(here.plan, 1)
            with pytest.raises(InterlockError, match="run 2 isn't the present one, but 1"):
                await here.corrector.correct(2, drift, "why")
            here.work.book = here.work.source = here.work.job = None
            with pytest.raises(InterlockError, match="no job is open"):
                await here.corrector.correct(1, drift, "why")

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"profile_sha256": "0" * 64}, "another profile"),
        ({"ink_names": ["C", "M", "Y", "K"]}, "the correction"),
        ({"mean": [float("nan")] * 41}, "is no JSON"),
        ({"schema_version": 9}, "schema_version 9"),
        ({"covariance": [[1.0]]}, "covariance"),
    ],
)
def test_a_drift_that_is_not_of_this_press_is_refused(
    tmp_path: Path, made: Made, change: dict[str, Any], words: str
) -> None:
    async def scenario() -> None:
        async with bench(tmp_path, made) as here:
            with pytest.raises(ProfileError, match=words):
                await here.corrector.correct(here.run_id, {**made_up_drift(here.plan, 1), **change}, "why")
            assert not here.maps.made
            assert here.work.correction is None
            assert await here.correct(1) == 1

    asyncio.run(scenario())


def test_one_correction_is_made_at_a_time(tmp_path: Path, made: Made) -> None:
    async def scenario() -> None:
        async with bench(tmp_path, made, "correction_interval_min = 0") as here:
            here.maps.may.clear()
            first = asyncio.create_task(here.correct(1))
            await asyncio.sleep(0)
            with pytest.raises(InterlockError, match="another correction is being made"):
                await here.correct(2)
            here.maps.may.set()
            assert await first == 1
            assert await here.correct(2) == 2

    asyncio.run(scenario())


def test_a_run_that_ends_while_a_map_is_made_is_not_corrected(tmp_path: Path, made: Made) -> None:
    async def scenario() -> None:
        async with bench(tmp_path, made) as here:
            run_id = here.run_id
            here.maps.may.clear()
            asked = asyncio.create_task(here.correct(1))
            await asyncio.sleep(0)
            here.work.book = here.work.source = here.work.job = None
            here.maps.may.set()
            with pytest.raises(InterlockError, match="no job is open"):
                await asked
            assert await here.keeper.call(lambda journal: journal.corrections(run_id)) == []

    asyncio.run(scenario())


def test_a_map_that_cannot_be_made_changes_nothing(tmp_path: Path, made: Made) -> None:
    async def scenario() -> None:
        async with bench(tmp_path, made) as here:
            here.maps.fails = True
            with pytest.raises(OutputError, match="the disk is full"):
                await here.correct(1)
            assert await here.fill() == [0] * 12
            here.maps.fails = False
            assert await here.correct(1) == 1

    asyncio.run(scenario())


@pytest.mark.parametrize("times", [1, 2])
def test_a_damaged_map_is_made_anew_once(tmp_path: Path, made: Made, times: int) -> None:
    async def scenario() -> None:
        async with bench(tmp_path, made) as here:
            here.maps.damaged = times
            if times == 1:
                assert await here.correct(1) == 1
            else:
                with pytest.raises(TextureMapError, match="flipped"):
                    await here.correct(1)
                assert here.work.correction is None
            assert len(here.maps.made) == 2
            assert here.maps.forgotten == 1

    asyncio.run(scenario())


def test_a_correction_that_the_journal_has_is_used_though_nobody_waits_for_it_any_more(
    tmp_path: Path, made: Made
) -> None:
    async def scenario() -> None:
        asked: list[asyncio.Task[int]] = []

        def gone(step: str) -> None:
            if step == "correction.committed":
                asked[0].cancel()

        async with bench(tmp_path, made, probe=gone) as here:
            asked.append(asyncio.create_task(here.correct(1)))
            with pytest.raises(asyncio.CancelledError):
                await asked[0]
            await asyncio.sleep(0)
            assert await here.fill() == [1] * 12

    asyncio.run(scenario())


def test_the_next_daemon_opens_the_latest_map_and_those_of_arms_under_way(tmp_path: Path, made: Made) -> None:
    async def begin() -> None:
        async with bench(tmp_path, made, "correction_interval_min = 0") as here:
            # Arms of correction 1 stay open; those of 2 are decided, those of 3 come next.
            for number, state in ((1, ArmState.ARMED), (2, ArmState.UNPRINTED), (3, ArmState.ARMED)):
                await here.correct(number)
                await here.fill()
                await here.bring(state, 12)

    async def go_on() -> None:
        async with bench(tmp_path, made) as here:
            assert here.source.corrections == frozenset()
            await here.corrector.keep_up()
            assert here.source.corrections == {1, 3}
            await here.corrector.keep_up()
            assert len(here.maps.made) == 2
            assert here.work.correction is not None
            assert here.work.correction.number == 3
            assert (await here.fill())[-1] == 3

    asyncio.run(begin())
    asyncio.run(go_on())


def test_a_correction_of_another_version_of_tilefab_is_told_of(tmp_path: Path, made: Made) -> None:
    async def scenario() -> None:
        async with bench(tmp_path, made) as here:
            drift = json.dumps(made_up_drift(here.plan, 1))
            await here.keeper.call(
                lambda journal: journal.correct(here.run_id, press_key="another", drift=drift, reason="")
            )
            with pytest.raises(InterlockError, match="correction 1 of run 1: this version of tilefab"):
                await here.corrector.keep_up()

    asyncio.run(scenario())


def test_maps_are_let_go_once_no_face_wants_them(tmp_path: Path, made: Made) -> None:
    @dataclass
    class Sending:
        corrections: frozenset[int] = frozenset()

    async def scenario() -> None:
        async with bench(tmp_path, made, "correction_interval_min = 0") as here:
            sending = Sending(frozenset({2}))
            streamer = cast(Streamer, sending)
            book = here.work.book
            assert book is not None
            for number in (1, 2, 3, 4):
                await here.correct(number)
                if number in (1, 3):
                    await here.fill()
            assert [intent.correction for intent in book.pool] == [1] * 12
            here.corrector.let_go(streamer)
            assert here.source.corrections == {1, 2, 4}
            sending.corrections = frozenset()
            here.corrector.let_go(streamer)
            assert here.source.corrections == {1, 4}
            book.pool.clear()
            book.coming = 3
            here.corrector.let_go(streamer)
            assert here.source.corrections == {1, 4}, "faces that are being put down may want any"
            book.coming = 0
            here.corrector.let_go(None)
            assert here.source.corrections == {4}

    asyncio.run(scenario())


def test_a_source_renders_each_face_as_corrected(made: Made) -> None:
    plan, maps = made
    source = FaceSource(plan, maps, 16)
    planned = source.prepare(3)
    plain = [strip.pixels.copy() for strip in source.strips(planned)]
    other = maps.press.with_base(maps.press.base ^ 5, maps.press.space, maps.press.channels)
    source.put(1, other)
    begun = source.strips(planned, correction=1)
    first = next(begun).pixels.copy()
    # Taken away in the middle of a face: it is rendered to its end all the same.
    source.keep_only({7})
    rest = [strip.pixels.copy() for strip in begun]
    for mine, theirs in zip([first, *rest], plain, strict=True):
        assert (mine == theirs ^ 5).all()
    assert source.corrections == frozenset()
    with pytest.raises(OutputError, match="correction 1 isn't open"):
        next(source.strips(planned, correction=1))
    for wrong in (maps.press.base[..., :3], maps.press.base.astype("uint16")):
        with pytest.raises(OutputError, match="other inks or another size"):
            source.put(2, maps.press.with_base(wrong, "ink8", maps.press.channels[: wrong.shape[2]]))
