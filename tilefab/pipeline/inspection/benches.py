"""What tiles of a run are inspected with: its job, its faces, its press."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.drift import MOST_TONE_CHANGE, DriftState, drifted, no_drift
from tilefab.colour.drift_evidence import drift_evidence
from tilefab.colour.press_model import PressModel
from tilefab.config import load_job
from tilefab.config.line import LineFile
from tilefab.control.drift_control import expected, start_control
from tilefab.control.drift_control_state import ControlSettings, DriftControl
from tilefab.control.drift_events import Propose, TileMeasured
from tilefab.errors import ConfigError, Problem, ProfileError, TextureMapError, TilefabError
from tilefab.io.drift_file import DriftFile, drift_text, parse_drift
from tilefab.io.journal import CorrectionRecord, RunRecord
from tilefab.pipeline.carried import carried_press
from tilefab.pipeline.corrected import corrected_plan
from tilefab.pipeline.inspection.images import CameraImage
from tilefab.pipeline.inspection.known_faces import KnownFaces
from tilefab.pipeline.inspection.looking import tolerances_of
from tilefab.pipeline.inspection.one_tile import AS_THE_JOB_SAYS, InspectedTile, PrintedWith, TileInspector
from tilefab.pipeline.inspection.predicting import PredictedFaces
from tilefab.pipeline.maps import convert_map, job_maps, load_press_map
from tilefab.pipeline.plan import MAPS_FOLDER, Plan, plan_job
from tilefab.pipeline.progress import Silent
from tilefab.sampling import TextureMap

Float64Array = NDArray[np.float64]

_MAPS_KEPT = 6
OPEN_AT_ONCE = 3
"""Runs whose benches are kept open; a tile is looked for in no more of them."""
_AGAIN_AFTER_S = 60.0


@dataclass(frozen=True)
class WhenPrinted:
    """How and when a tile was printed, for the controller.

    Attributes
    ----------
    arm_id
        The arm: it tells tiles apart.
    correction
        Number over all runs, see `tilefab.pipeline.inspection.correcting.control_number`.
    fired_s, measured_s
        When the tile came out of the kiln, and now, by the controller's clock.
    """

    arm_id: int
    correction: int
    fired_s: float
    measured_s: float


class Bench(Protocol):
    """What tiles of one run are inspected with."""

    @property
    def press(self) -> str:
        """Tells its press from others; empty if its drift can't be followed."""

    @property
    def begun(self) -> Float64Array:
        """State of the press that the job's own conversion was made for."""

    def start(self, now_s: float, settings: ControlSettings) -> DriftControl:
        """A controller that knows of no tile yet."""

    def inspect(
        self, image: CameraImage, faces: Sequence[int], correction_of: Callable[[int], CorrectionRecord | None]
    ) -> InspectedTile:
        """Find out all about a tile that shows one of some faces, or none of them.

        ``correction_of`` says with which correction a face was printed; ``None``: as the job says.
        """

    def measured(self, tile: InspectedTile, control: DriftControl, when: WhenPrinted) -> TileMeasured | None:
        """What a tile says of the press's drift; ``None`` if nothing."""

    def drift(self, proposal: Propose, tiles: int, note: str) -> str:
        """A state of the press as JSON of a drift file."""

    def state(self, correction: CorrectionRecord) -> Float64Array:
        """The state of the press that a correction was made for.

        Raises
        ------
        ProfileError
            If it isn't one of this press.
        """


class RunBench:
    """A `Bench` of the job that a run printed.

    Parameters
    ----------
    run
        The run.
    line_file
        The line: its tolerances.

    Raises
    ------
    TilefabError
        If the job can't be opened, or isn't any more what the run printed.
    """

    def __init__(self, run: RunRecord, line_file: LineFile) -> None:
        plan = plan_job(load_job(Path(run.facts.job_file)))
        if plan.job_hash != run.facts.job_hash:
            message = "has changed since the run began: put it back as it was, so that its tiles can be inspected"
            raise ConfigError([Problem(run.facts.job_file, None, "", message)])
        self._plan = plan
        maps = job_maps(plan, Silent(), threads=1)
        self._texture = maps.texture
        self._faces = PredictedFaces(plan, maps)
        self._known = KnownFaces(self._faces, Silent())
        line = line_file.line
        self._inspector = TileInspector(self._faces, tolerances_of(line.tolerances), line.inspection.region_mm)
        self._maps: OrderedDict[int, PrintedWith] = OrderedDict()
        self._model: PressModel | None = None
        # A profile without measurements prints, but nothing can be learnt for it.
        with suppress(ProfileError):
            self._model = carried_press(plan.press_profile, plan.output / MAPS_FOLDER)[0].model
        inks = plan.press_profile.channels
        self._inks = inks
        self._fresh = no_drift(inks)

    @property
    def press(self) -> str:
        """Hash of its profile; empty if that carries no measurements."""
        return self._plan.press_profile.sha256 if self._model is not None else ""

    @property
    def begun(self) -> Float64Array:
        """That of the job's file, or none."""
        drift = self._plan.drift
        return self._fresh.mean if drift is None else drift.state.mean

    def start(self, now_s: float, settings: ControlSettings) -> DriftControl:
        """See `Bench`."""
        return start_control(self._fresh.covariance, now_s=now_s, mean=self.begun, settings=settings)

    def inspect(
        self, image: CameraImage, faces: Sequence[int], correction_of: Callable[[int], CorrectionRecord | None]
    ) -> InspectedTile:
        """See `Bench`."""
        index = self._known.index(faces)
        return self._inspector.inspect(image, index, lambda face: self._printed_with(correction_of(face)))

    def measured(self, tile: InspectedTile, control: DriftControl, when: WhenPrinted) -> TileMeasured | None:
        """See `Bench`."""
        printed = tile.printed
        if self._model is None or printed is None or not len(printed.fired_lab):
            return None
        state = replace(self._fresh, mean=expected(control, when.correction))
        # What a region fires to is the mean of its pixels' colours, which isn't the colour of its mean ink: grain and
        # edges alone make some ΔE of that. So it is the difference from what was predicted pixel by pixel that counts.
        of_mean = drifted(self._model, replace(self._fresh, mean=self.begun)).lab(printed.ink_frac)
        fired = of_mean + (printed.fired_lab - printed.predicted_lab)
        evidence = drift_evidence(self._model, state, printed.ink_frac, fired, printed.noise_lab, share=printed.share)
        return TileMeasured(
            tile=when.arm_id,
            correction=when.correction,
            fired_at_s=when.fired_s,
            measured_at_s=when.measured_s,
            at=evidence.at,
            information=evidence.information,
            vector=evidence.vector,
            effect=evidence.effect,
            watch=evidence.watch,
            misfit=evidence.misfit,
        )

    def drift(self, proposal: Propose, tiles: int, note: str) -> str:
        """See `Bench`."""
        profile = self._plan.press_profile
        covariance = 0.5 * (proposal.covariance + proposal.covariance.T)
        # Beyond that no state is believed; the controller comes back to it by itself.
        mean = proposal.mean.copy()
        mean[: 2 * self._inks] = np.clip(mean[: 2 * self._inks], -MOST_TONE_CHANGE, MOST_TONE_CHANGE)
        state = DriftState(mean, covariance, self._inks)
        return drift_text(DriftFile(state, profile.ink_names, profile.sha256, tiles, note))

    def state(self, correction: CorrectionRecord) -> Float64Array:
        """See `Bench`."""
        return self._drift_of(correction)[0].state.mean

    def _drift_of(self, correction: CorrectionRecord) -> tuple[DriftFile, str]:
        return parse_drift(correction.drift.encode(), f"correction {correction.number} of run {correction.run_id}")

    def _printed_with(self, correction: CorrectionRecord | None) -> PrintedWith:
        if correction is None:
            return AS_THE_JOB_SAYS
        number = correction.number
        if number not in self._maps:
            drift, sha256 = self._drift_of(correction)
            self._maps[number] = PrintedWith(number, self._press_map(corrected_plan(self._plan, drift, sha256)))
            while len(self._maps) > _MAPS_KEPT:
                self._maps.popitem(last=False)
        self._maps.move_to_end(number)
        return self._maps[number]

    def _press_map(self, corrected: Plan) -> TextureMap:
        """The daemon's own; made again if it was cleared away since."""
        try:
            return load_press_map(corrected, self._texture.hash)
        except TextureMapError:
            return convert_map(corrected, self._texture, Silent(), threads=1)


class Benches:
    """Benches of the latest runs, opened when they are needed.

    Parameters
    ----------
    open_bench
        Opens one; may take a while.
    """

    def __init__(self, open_bench: Callable[[RunRecord], Bench]) -> None:
        self._open = open_bench
        self._benches: OrderedDict[int, Bench] = OrderedDict()
        self._failed: dict[int, tuple[float, str]] = {}

    def of(self, run: RunRecord, now_s: float) -> Bench | None:
        """The bench of a run; ``None`` if it can't be opened, see `failures`. That is tried again each minute.

        ``now_s`` is a clock that is never set.
        """
        found = self._benches.get(run.run_id)
        if found is not None:
            self._benches.move_to_end(run.run_id)
            return found
        failed = self._failed.get(run.run_id)
        if failed is not None and now_s - failed[0] < _AGAIN_AFTER_S:
            return None
        try:
            bench = self._open(run)
        except TilefabError as error:
            self._failed[run.run_id] = now_s, error.message
            return None
        self._failed.pop(run.run_id, None)
        self._benches[run.run_id] = bench
        while len(self._benches) > OPEN_AT_ONCE:
            self._benches.popitem(last=False)
        return bench

    def opened(self, run_id: int) -> Bench | None:
        """The bench of a run if it is open already."""
        return self._benches.get(run_id)

    @property
    def failures(self) -> Mapping[int, str]:
        """Runs whose benches couldn't be opened, and why."""
        return {run_id: why for run_id, (_, why) in self._failed.items()}

    def forget_failures(self, runs: Sequence[int]) -> None:
        """Say nothing more of runs whose tiles aren't looked for."""
        for run_id in runs:
            self._failed.pop(run_id, None)
