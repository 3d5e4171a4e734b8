"""Which faces of a job were printed, when, and with which correction: from the journal of the line that printed it."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

from tilefab.config.line import LineFile
from tilefab.control.ledger import ArmState
from tilefab.errors import JournalError
from tilefab.io.drift_file import parse_drift
from tilefab.io.journal import CorrectionRecord, Journal, PrintRecord
from tilefab.pipeline.corrected import corrected_plan
from tilefab.pipeline.inspection.one_tile import AS_THE_JOB_SAYS, PrintedWith
from tilefab.pipeline.maps import job_maps
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.progress import Progress
from tilefab.sampling import TextureMap

_MAPS_KEPT = 4


class JobPrints:
    """Prints of a job on a line, of all its runs.

    Parameters
    ----------
    plan
        The job.
    line_file
        The line that printed it.
    progress
        Who watches maps of corrections being made, where they are gone.

    Raises
    ------
    JournalError
        If the journal can't be read, or has no run of this job.
    """

    def __init__(self, plan: Plan, line_file: LineFile, progress: Progress) -> None:
        self._plan, self._progress = plan, progress
        self._prints: dict[int, list[PrintRecord]] = {}
        self._corrections: dict[tuple[int, int], CorrectionRecord] = {}
        self._maps: OrderedDict[tuple[int, int], TextureMap] = OrderedDict()
        with Journal.look(line_file.journal_url, line=line_file.name) as journal:
            runs = [run for run in journal.runs(last=1000) if run.facts.job_hash == plan.job_hash]
            if not runs:
                raise JournalError(
                    f"{line_file.journal_url}: line {line_file.name!r} has printed nothing of {plan.name}, as its file "
                    "says now: give the job file that it was printed from",
                    path=line_file.journal_url,
                )
            for run in runs:
                for made in journal.corrections(run.run_id):
                    self._corrections[run.run_id, made.number] = made
                for print_ in sorted(journal.prints(run.run_id), key=lambda print_: print_.arm_id):
                    if print_.state is not ArmState.DIVERTED:  # such a tile went to scrap before the kiln
                        self._prints.setdefault(print_.face, []).append(print_)

    @property
    def faces(self) -> Sequence[int]:
        """Faces that were printed, rising."""
        return sorted(self._prints)

    def newest(self, face: int) -> PrintRecord | None:
        """The last print of a face; ``None`` if it never was."""
        prints = self._prints.get(face)
        return prints[-1] if prints else None

    def prints(self, face: int) -> Sequence[PrintRecord]:
        """All prints of a face whose tiles may have been fired, oldest first."""
        return self._prints.get(face, ())

    def correction(self, print_: PrintRecord) -> CorrectionRecord | None:
        """The correction that a print was made with; ``None`` if with none."""
        return self._corrections.get((print_.run_id, print_.correction))

    def printed_with(self, face: int) -> PrintedWith:
        """How a face was printed last."""
        print_ = self.newest(face)
        if print_ is None or print_.correction == 0:
            return AS_THE_JOB_SAYS
        return PrintedWith(print_.correction, self.press(print_))

    def press(self, print_: PrintRecord) -> TextureMap:
        """The map in inks that a print was made from.

        Raises
        ------
        ProfileError
            If its correction can't be made again.
        """
        key = print_.run_id, print_.correction
        if key not in self._maps:
            self._maps[key] = job_maps(self.plan_of(print_), self._progress).press
            while len(self._maps) > _MAPS_KEPT:
                self._maps.popitem(last=False)
        self._maps.move_to_end(key)
        return self._maps[key]

    def plan_of(self, print_: PrintRecord) -> Plan:
        """The job as a print was made: with its correction.

        Raises
        ------
        JournalError
            If the journal doesn't tell the correction any more.
        """
        if print_.correction == 0:
            return self._plan
        made = self.correction(print_)
        if made is None:
            raise JournalError(f"run {print_.run_id}: correction {print_.correction} isn't in the journal any more")
        drift, sha256 = parse_drift(made.drift.encode(), f"correction {made.number} of run {print_.run_id}")
        return corrected_plan(self._plan, drift, sha256)
