"""What a report tells of a line's job besides its tiles: inks, variation of its faces, what corrections were for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import delta_e_2000, lab_from_xyz
from tilefab.colour.drift import DriftState, drifted
from tilefab.colour.encoding import decode_lab16
from tilefab.config import load_job
from tilefab.errors import TilefabError
from tilefab.inspection.records import ColourFigures
from tilefab.inspection.variation import AID, is_plain, plain_cmc, variation
from tilefab.io.press_profile import press_transform
from tilefab.pipeline.carried import carried_press
from tilefab.pipeline.inspection.pictures import picture_of
from tilefab.pipeline.inspection.predicting import PredictedFaces
from tilefab.pipeline.maps import JobMaps, job_maps
from tilefab.pipeline.plan import MAPS_FOLDER, Plan, plan_job
from tilefab.pipeline.progress import Progress
from tilefab.report.line_view import InkUseView, VariationView
from tilefab.report.view_model import RgbImage

Float64Array = NDArray[np.float64]

_SAMPLED_FACES = 24
_SAMPLED_PX = 20_000
_PICTURE_PX = 480
_FACE_PX_PER_MM = 0.5


@dataclass(frozen=True, eq=False)
class JobFacts:
    """A job as it is needed for reports.

    Attributes
    ----------
    plan, maps
        The job.
    faces
        What its faces should look like.
    """

    plan: Plan
    maps: JobMaps
    faces: PredictedFaces

    def drift_delta_e(self, state: DriftState) -> float:
        """Mean CIEDE2000 by which the job's colours would be off, were they printed on a drifted press as before."""
        folder = self.plan.output / MAPS_FOLDER
        model = carried_press(self.plan.press_profile, folder if folder.is_dir() else None)[0].model
        inks = self._sampled_inks()
        return float(np.asarray(delta_e_2000(drifted(model, state).lab(inks), model.lab(inks))).mean())

    def _sampled_inks(self, count: int = 500) -> Float64Array:
        base = self.maps.press.base
        flat = base.reshape(-1, base.shape[2])
        chosen = flat[:: max(1, len(flat) // count)][:count]
        return np.asarray(chosen / float(np.iinfo(base.dtype).max), dtype=np.float64)

    def inks(self, tiles: int) -> tuple[InkUseView, ...]:
        """Ink that so many tiles took, in square metres of full cover, and what that saves.

        Saved is against the profile's own separation of the same colours, which is what a job gets that asks for
        nothing else. Both are means over the texture map, which every face shows about evenly.
        """
        plan, press = self.plan, self.maps.press
        size = plan.tile_mm
        area_m2 = tiles * (size.width + 2 * plan.job.tile.bleed_mm) * (size.height + 2 * plan.job.tile.bleed_mm) / 1e6
        used = press.base.reshape(-1, press.base.shape[2]).mean(axis=0, dtype=np.float64)
        used = used / float(np.iinfo(press.base.dtype).max)
        saved: list[float | None] = [None] * len(used)
        if plan.job.colour.separation == "least_ink":
            flat = self.maps.texture.base.reshape(-1, 3)
            places = np.arange(0, len(flat), max(1, len(flat) // _SAMPLED_PX))
            lab = decode_lab16(np.ascontiguousarray(flat[places]))
            usual = press_transform(plan.press_profile, plan.job.colour.intent).inks_from_lab(lab[np.newaxis])[0]
            ours = press.base.reshape(-1, press.base.shape[2])[places] / float(np.iinfo(press.base.dtype).max)
            saved = [float(value) for value in (usual.mean(axis=0) - ours.mean(axis=0)) * area_m2]
        return tuple(
            InkUseView(name, float(mean * area_m2), less)
            for name, mean, less in zip(plan.ink_names, used, saved, strict=True)
        )

    def variation(self, some: list[int], measured: Sequence[ColourFigures]) -> VariationView | None:
        """How much faces differ by design; ``None`` of fewer than two. Of plain tile also how far it is off its colour.

        ``measured`` are figures of fired tiles.
        """
        chosen = some[:: max(1, len(some) // _SAMPLED_FACES)][:_SAMPLED_FACES]
        if len(chosen) < 2:
            return None
        factor = self.faces.factor(_FACE_PX_PER_MM)
        shown = [lab_from_xyz(self.faces.xyz(face, factor)) for face in chosen]
        found = variation(shown)
        plain = all(is_plain(face) for face in shown)
        standard = "plain, so ISO 10545-16 applies" if plain else "patterned: ISO 10545-16 is for plain tile"
        return VariationView(
            look=found.look,
            index=found.index,
            between_delta_e=found.between_delta_e,
            within_delta_e=found.within_delta_e,
            plain=plain,
            cmc_plain=_plain_cmc(measured) if plain and measured else None,
            note=f"Of {found.faces} predicted faces. {AID} The tile is {standard}.",
        )

    def picture(self, face: int) -> RgbImage:
        """A face as it should look, for a page."""
        long_mm = max(self.plan.tile_mm.width, self.plan.tile_mm.height)
        return picture_of(self.faces.xyz(face, self.faces.factor(_PICTURE_PX / long_mm)), _PICTURE_PX)


def _plain_cmc(measured: Sequence[ColourFigures]) -> float:
    return plain_cmc([colour.predicted_lab for colour in measured], [colour.fired_lab for colour in measured])


def job_facts(job_file: Path, job_hash: str, progress: Progress) -> JobFacts | str:
    """Open the job of a run; or say why that can't be done.

    A report is made without it, rather than not at all: job files move, and change.
    """
    try:
        plan = plan_job(load_job(job_file))
        if plan.job_hash != job_hash:
            return f"{job_file} has changed since the run: inks, variation and predicted faces are left out"
        maps = job_maps(plan, progress)
    except TilefabError as error:
        return f"{error.message}: inks, variation and predicted faces are left out"
    return JobFacts(plan, maps, PredictedFaces(plan, maps))
