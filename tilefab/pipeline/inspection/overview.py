"""How the fired tiles of a line's newest run look so far: for whoever stands beside it."""

from __future__ import annotations

from dataclasses import dataclass

from tilefab.config.line import LineFile
from tilefab.errors import JournalError
from tilefab.inspection.records import Grade
from tilefab.io.inspection_records import InspectionRecord
from tilefab.io.inspection_store import InspectionStore
from tilefab.io.journal import Journal
from tilefab.pipeline.inspection.places import store_url


@dataclass(frozen=True)
class RunOverview:
    """A run so far.

    Attributes
    ----------
    run_id, name
        The run and its job.
    planned, printed, inspected
        Faces of the job, faces printed whole, and tiles recognised behind the kiln.
    grades
        Tiles recognised, by grade.
    corrections
        Corrections of the colours so far.
    latest
        The newest tiles, oldest first.
    delta_e_mean
        Mean CIEDE2000 of these from their own faces; ``None`` without any.
    alarms
        Alarms of the inspector that are up.
    """

    run_id: int
    name: str
    planned: int
    printed: int
    inspected: int
    grades: dict[Grade, int]
    corrections: int
    latest: tuple[InspectionRecord, ...]
    delta_e_mean: float | None
    alarms: tuple[str, ...]


def run_overview(line_file: LineFile, last: int) -> RunOverview:
    """Look at the newest run of a line.

    Parameters
    ----------
    line_file
        The line.
    last
        How many of the newest tiles to tell of.

    Raises
    ------
    JournalError
        If journal or inspections can't be read, or the line has printed nothing yet.
    """
    with Journal.look(line_file.journal_url, line=line_file.name) as journal:
        runs = journal.runs(last=1)
        if not runs:
            raise JournalError(
                f"{line_file.journal_url}: line {line_file.name!r} has printed nothing yet", path=line_file.journal_url
            )
        run = runs[0]
        printed, corrections = len(journal.prints(run.run_id)), len(journal.corrections(run.run_id))
    latest: list[InspectionRecord] = []
    grades = dict.fromkeys(Grade, 0)
    alarms: tuple[str, ...] = ()
    if InspectionStore.exists(store_url(line_file), line=line_file.name):
        with InspectionStore.look(store_url(line_file), line=line_file.name) as store:
            latest = store.tiles(run.run_id, last=last)
            grades = store.grades(run.run_id)
            alarms = tuple(alarm.text for alarm in store.alarms(up=True))
    differences = [tile.colour.delta_e_mean for tile in latest if tile.colour is not None]
    return RunOverview(
        run_id=run.run_id,
        name=run.facts.name,
        planned=run.facts.faces,
        printed=printed,
        inspected=sum(grades.values()),
        grades=grades,
        corrections=corrections,
        latest=tuple(latest),
        delta_e_mean=sum(differences) / len(differences) if differences else None,
        alarms=alarms,
    )
