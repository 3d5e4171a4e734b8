"""Gathering what the report shows: from the manifest, the maps and the profile to frozen view models."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from typing import Any

import tilefab
from tilefab.errors import OutputError
from tilefab.io.atomic import atomic_write_bytes
from tilefab.io.manifest import FaceRecord, Manifest
from tilefab.pipeline.colour_facts import colour_facts
from tilefab.pipeline.crops import crop_warnings
from tilefab.pipeline.faces import check_target, face_code, render_face
from tilefab.pipeline.map_view import fit_picture, map_view
from tilefab.pipeline.maps import JobMaps, job_maps, proof_map
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.progress import Progress
from tilefab.pipeline.wall import render_wall
from tilefab.report import (
    ColourView,
    FaceView,
    RunReportView,
    build_run_report,
    contact_faces,
)
from tilefab.sampling import CropMap, TextureMap, TileMap

STAGE = "Drawing the report"
_WALL_PX = 1400
_THUMBNAIL_PX = 360
_WALL_FACES = 12
_OUT_OF_GAMUT_WARNING = 0.10
_LIMITED_WARNING = 0.02
_DELTA_E_WARNING = 3.0


def write_report(
    plan: Plan,
    progress: Progress,
    *,
    created: datetime,
    path: Path | None = None,
    threads: int | None = None,
    maps: JobMaps | None = None,
    colour: ColourView | None = None,
) -> Path:
    """Draw the PDF of a run from what its folder holds.

    Parameters
    ----------
    plan
        The job.
    progress
        Told of the progress.
    created
        Date and time that the report shows.
    path
        The file; by default what the job says.
    threads
        For rendering.
    maps, colour
        The job's maps and the figures of the colour page, if they are at hand.

    Raises
    ------
    OutputError
        If the run has no faces yet, its folder is another job's, or the file can't be written.
    ReportError
        If it can't be drawn.
    """
    manifest = Manifest(plan.output)
    records = [manifest.records[index] for index in sorted(manifest.records)]
    if not records:
        raise OutputError(
            f"{plan.output}: holds no finished faces to report on; run `tilefab run {plan.job_file.path}` first",
            path=str(plan.output),
        )
    if {record.job for record in records} != {plan.job_hash}:
        raise OutputError(
            f"{plan.output}: holds the faces of another job, or of this job with other settings; give its own folder "
            "with --out DIR",
            path=str(plan.output),
        )
    if path is None:
        path = plan.output / (plan.job.report.pdf or "report.pdf")
    elif path.suffix.lower() != ".pdf":
        raise OutputError(f"{path}: a report is a PDF: let its name end in .pdf", path=str(path))
    check_target(plan, path)
    maps = maps or job_maps(plan, progress, threads)
    progress.stage(STAGE, 0.0)
    view = report_view(plan, maps, records, progress, created=created, threads=threads, colour=colour)
    atomic_write_bytes(path, build_run_report(view))
    progress.stage(STAGE, 1.0)
    return path


def report_view(
    plan: Plan,
    maps: JobMaps,
    records: list[FaceRecord],
    progress: Progress,
    *,
    created: datetime,
    threads: int | None = None,
    colour: ColourView | None = None,
) -> RunReportView:
    """Everything the report shows, as frozen figures, texts and pictures."""
    proof = proof_map(plan, maps.press, threads)
    colour = colour or colour_facts(plan, maps, [record.face for record in records])
    progress.stage(STAGE, 0.2)
    shown = set(contact_faces(len(records), plan.job.report.faces))
    faces = []
    for position, record in enumerate(records):
        thumbnail = None
        if position in shown:
            thumbnail = fit_picture(render_face(plan, proof, record.face, threads=threads, bleed=False), _THUMBNAIL_PX)
            progress.stage(STAGE, 0.2 + 0.4 * position / len(records))
        faces.append(
            FaceView(
                index=record.face,
                code=face_code(plan, maps.press, record.face),
                thumbnail=thumbnail,
                file_name=record.file,
                origin=f"row {record.origin[0]}, col {record.origin[1]}",
                sha256=record.sha256,
            )
        )
    rows, cols, first, caption = _wall_shape(plan, records)
    wall = render_wall(
        plan,
        proof,
        rows,
        cols,
        first=first,
        end=max(plan.job.tile.count, records[-1].face + 1),
        largest_side_px=_WALL_PX,
        threads=threads,
        progress=lambda share: progress.stage(STAGE, 0.6 + 0.3 * share),
    )
    return RunReportView(
        title=plan.name,
        job_file=plan.job_file.path.name,
        job_hash=plan.job_hash,
        map_hash=maps.texture.hash,
        profile_hash=plan.press_profile.sha256,
        created=created.strftime("%Y-%m-%d %H:%M"),
        software_version=tilefab.__version__,
        facts=_job_facts(plan, records),
        wall_preview=wall,
        wall_caption=caption,
        faces=tuple(faces),
        colour=colour,
        texture_map=map_view(plan, maps.texture, proof, threads),
        preparation=preparation_log(maps.texture),
        warnings=job_warnings(maps.texture, colour),
        max_contact_faces=plan.job.report.faces,
    )


def job_warnings(texture: TextureMap, colour: ColourView | None = None) -> tuple[str, ...]:
    """What the operator should know before printing."""
    warnings = [str(text) for text in _listed(texture, "warnings")]
    patches = len(texture.patches) if isinstance(texture, TileMap) else 0
    wanted = int(texture.provenance.get("patches_wanted", patches)) if isinstance(texture, TileMap) else 0
    if patches < wanted / 2:
        warnings.append(
            f"Only {patches} of {wanted} interchangeable patches could be cut: the pattern of the tile will recur. "
            "Scan more of the stone, or use a larger map"
        )
    if isinstance(texture, CropMap):
        warnings += crop_warnings(texture)
    if colour is not None:
        if colour.out_of_gamut_share > _OUT_OF_GAMUT_WARNING:
            warnings.append(
                f"{100 * colour.out_of_gamut_share:.0f} % of the stone is more colourful, paler or darker than this "
                f"press can print, by CIEDE2000 {colour.out_of_gamut_mean:.1f} on average and "
                f"{colour.out_of_gamut_p95:.1f} at the 95th percentile; the nearest printable colours are used"
            )
        if colour.share_limited > _LIMITED_WARNING:
            warnings.append(
                f"{100 * colour.share_limited:.1f} % of the stone was reduced to the ink limit of "
                f"{colour.ink_limit_percent:g} %: dark areas may change in colour"
            )
        if colour.delta_e_mean > _DELTA_E_WARNING:
            warnings.append(
                f"The print differs from the stone by a mean CIEDE2000 of {colour.delta_e_mean:.1f}; a relative "
                "intent, or another press profile, may come nearer"
            )
    return tuple(warnings)


def preparation_log(texture: TextureMap) -> tuple[tuple[str, str], ...]:
    """What was done to the slab, as the map tells: (step, sentence)."""
    return tuple((str(step), str(text)) for step, text in _listed(texture, "preparation"))


def _listed(texture: TextureMap, name: str) -> list[Any]:
    listed: list[Any] = json.loads(texture.provenance.get(name, "[]"))
    return listed


def _job_facts(plan: Plan, records: list[FaceRecord]) -> tuple[tuple[str, str], ...]:
    job, tile = plan.job, plan.tile_px
    bleed = f", bleed {job.tile.bleed_mm:g} mm" if job.tile.bleed_mm else ""
    first, last = records[0].face, records[-1].face
    layout = job.tile.layout + (f", {job.tile.columns} columns" if job.tile.columns else "")
    return (
        ("Tile", f"{plan.tile_mm.width:g} x {plan.tile_mm.height:g} mm{bleed}"),
        ("Resolution", f"{job.tile.dpi:g} dpi, {tile.cols} x {tile.rows} pixels, {job.output.bits} bit"),
        ("Faces", f"{len(records)} of {job.tile.count} finished (numbers {first} to {last})"),
        ("Layout", layout),
        ("Stone", ", ".join(scan.path.name for scan in plan.scans)),
        ("Seed", str(plan.seed)),
        ("Press", plan.press_profile.description),
        ("Inks", ", ".join(plan.ink_names)),
        *_table_facts(plan),
    )


def _table_facts(plan: Plan) -> tuple[tuple[str, str], ...]:
    """How the press's tables were made for this job, if they were."""
    colour = plan.job.colour
    if not colour.rebuilds_tables:
        return ()
    style = "least ink" if colour.separation == "least_ink" else "standard"
    prices = ", ".join(f"{ink} {price:g}" for ink, price in (colour.ink_prices or {}).items())
    room = "; gamut fitted to this stone" if colour.gamut == "image" else ""
    facts = [("Separation", style + (f", prices {prices}" if prices else "") + room)]
    if plan.drift is not None:
        facts.append(("Drift", f"{Path(colour.drift or '').name}, {plan.drift.patches} patches"))
    return tuple(facts)


def _wall_shape(plan: Plan, records: list[FaceRecord]) -> tuple[int, int, int, str]:
    """Rows, columns, first face and caption of the wall on the cover."""
    columns = plan.job.tile.columns
    if columns is not None:
        rows, cols = min(3, -(-plan.job.tile.count // columns)), min(columns, 6)
        caption = f"The upper left of the wall, {rows} x {cols} tiles: the pattern runs on across the joints."
        return rows, cols, 0, caption
    # Faces next to each other in number come out of the box together.
    shown = min(len(records), _WALL_FACES)
    cols = next(n for n in (4, 3, 2, 1) if shown >= n)
    rows, first = shown // cols, records[0].face
    return rows, cols, first, f"Faces {first} to {first + rows * cols - 1}, in fired colours."
