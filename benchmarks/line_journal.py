"""How fast the line's journal is, how quickly it opens again, and how much it grows.

Usage: python benchmarks/line_journal.py [--arms N] [--commits N] [--folder FOLDER] [--url URL]

The figures are those of the disk that FOLDER is on, or of the server behind URL (its database must be empty).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from figures import Figures
from machine import machine_name
from sqlalchemy import insert

from tilefab.control.ledger import MOST_FACES, OPEN, ArmState, FaceQueue
from tilefab.io.journal import ArmChange, Intent, Journal, RunFacts, sqlite_url
from tilefab.io.journal_schema import arms

T = TypeVar("T")

LINE = "line 1"
AT_ONCE = 8
BATCH = 10_000
FACTS = RunFacts(job_hash="ab" * 32, name="a job", job_file="/jobs/a.toml", faces=MOST_FACES, seed=1, map_hash="cd")
LIFE = (ArmState.ARMED, ArmState.PRINTED, ArmState.PASSED)


def changes(intents: Sequence[Intent], state: ArmState) -> list[ArmChange]:
    """A step of some arms, with the facts that the line puts down at it."""
    known = {"detect_seq": 1 << 20, "printer_boot": 123, "plc_boot": 456} if state is ArmState.ARMED else {}
    known |= {"rows_printed": 8504, "data_crc32": 0xDEADBEEF} if state is ArmState.PRINTED else {}
    return [ArmChange(intent.arm_id, state, tile_seq=intent.arm_id, **known) for intent in intents]


class Stopwatch:
    """Latencies of calls by name, in milliseconds."""

    def __init__(self) -> None:
        self.found: dict[str, list[float]] = {}

    def time(self, name: str, call: Callable[[], T]) -> T:
        """Call, and put down how long it took."""
        begin = time.perf_counter()
        result = call()
        self.found.setdefault(name, []).append(1000 * (time.perf_counter() - begin))
        return result


def commits(figures: Figures, journal: Journal, many: int) -> None:
    """Latencies of durable calls, one after another without a pause."""
    run_id = journal.start_run(FACTS)
    queue = FaceQueue(journal.face_states(run_id))
    watch = Stopwatch()
    begin, count = time.perf_counter(), 0
    while count < many:
        faces = queue.take(AT_ONCE)
        intents = watch.time("intend 8", partial(journal.intend, run_id, faces))
        for intent in intents:
            watch.time("mark 1", partial(journal.mark, changes([intent], ArmState.ARMED)))
        for state in LIFE[1:]:
            watch.time("mark 8", partial(journal.mark, changes(intents, state)))
        watch.time("note", partial(journal.note, "state", state="running"))
        count += 4 + len(intents)
    took = time.perf_counter() - begin
    for name, latencies in watch.found.items():
        shown = " / ".join(f"{np.percentile(latencies, part):.2f}" for part in (50, 99, 100))
        figures.note(f"{name}: p50 / p99 / max of {len(latencies)}, ms", shown)
    figures.note("commits a second", f"{count / took:.0f}")


def fill(journal: Journal, many: int) -> None:
    """Put arms into the tables as a long run leaves them, past the journal's calls; one in a thousand came twice."""
    run_id = journal.start_run(replace(FACTS, job_hash="long run"))
    first = journal.last_arm() + 1
    row = {
        "line_id": 1,
        "run_id": run_id,
        "detect_seq": 1 << 20,
        "tile_seq": 1 << 20,
        "printer_boot": 123,
        "plc_boot": 456,
        "data_crc32": 0xDEADBEEF,
        "reason": "",
        "intended_ms": 1_790_000_000_000,
        "changed_ms": 1_790_000_030_000,
    }
    face = 0
    for begin in range(first, first + many, BATCH):
        rows = []
        for arm_id in range(begin, min(begin + BATCH, first + many)):
            again, comes_again = arm_id % 1000 == 8, arm_id % 1000 == 7
            state = ArmState.UNPRINTED if comes_again else ArmState.PASSED
            told = {"arm_id": arm_id, "face": face, "attempt": 1 + again, "rows_printed": 0 if comes_again else 8504}
            rows.append({**row, **told, "state": state.value})
            face += not comes_again
        with journal._store.transaction("fill") as connection:
            connection.execute(insert(arms), rows)
    journal.skip_arms(first + many - 1)


def reopen(figures: Figures, url: str, many: int) -> None:
    """A full journal opened again, as after a kill, until the line knows where it stands."""
    facts = replace(FACTS, job_hash="long run")
    with Journal.open(url, line=LINE) as journal:
        fill(journal, many)
        run_id = journal.start_run(facts)
        journal.intend(run_id, FaceQueue(journal.face_states(run_id)).take(AT_ONCE))
    watch = Stopwatch()
    for _ in range(5):
        journal = watch.time("open", partial(Journal.open, url, line=LINE))
        with journal:
            run_id = watch.time("go on with the run", partial(journal.start_run, facts))
            watch.time("faces still to come", partial(journal.face_states, run_id))
            found = watch.time("open arms", partial(journal.arms, states=OPEN))
            watch.time("newest 1000 arms", partial(journal.arms, last=1000))
            watch.time("begin a session", journal.begin_session)
            watch.time("count of all states (once)", partial(journal.counts, run_id))
        if len(found) != AT_ONCE:
            raise SystemExit(f"{len(found)} arms are open, not {AT_ONCE}")
    worst = {name: max(latencies) for name, latencies in watch.found.items()}
    for name, latency in worst.items():
        figures.note(f"{name}: worst of 5, ms", f"{latency:.1f}")
    total = sum(worst.values()) / 1000
    figures.row("all of it after a restart, s", [total], [1.0])


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=1_000_000, help="arms in the journal that is opened again")
    parser.add_argument("--commits", type=int, default=20_000, help="commits to time")
    parser.add_argument("--folder", type=Path, help="where the journal is made for the while")
    parser.add_argument("--url", help="of an empty PostgreSQL database, instead of SQLite")
    arguments = parser.parse_args()
    figures = Figures()
    kind = "PostgreSQL" if arguments.url else "SQLite"
    figures.title(f"The journal on {kind}\n{machine_name()}")
    with tempfile.TemporaryDirectory(prefix="tilefab-journal-", dir=arguments.folder) as folder:
        path = None if arguments.url else Path(folder) / "journal.sqlite"
        url = arguments.url or sqlite_url(Path(folder) / "journal.sqlite")
        with Journal.open(url, line=LINE) as journal:
            commits(figures, journal, arguments.commits)
            if path is not None:
                size = path.with_name(path.name + "-wal").stat().st_size
                figures.note("write-ahead log after that, MB", f"{size / 1e6:.1f}")
            faces = journal.last_arm()
        if path is not None:
            figures.note(f"bytes a face, of {faces} faces", f"{path.stat().st_size / faces:.0f}")
        figures.title(f"The same with {arguments.arms:,} arms")
        reopen(figures, url, arguments.arms)
    figures.end()


if __name__ == "__main__":
    main()
