"""What is known of the tile in an image: its face, when and how that was printed and fired; and the face again."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from tilefab.config.line import LineFile
from tilefab.errors import OutputError
from tilefab.inspection.records import Grade, Recognition
from tilefab.io.faces import write_print_tiff
from tilefab.io.inspection_records import InspectionRecord
from tilefab.io.inspection_store import InspectionStore
from tilefab.io.journal import Journal, PrintRecord
from tilefab.io.manifest import Manifest
from tilefab.pipeline.faces import check_face_record, face_code, print_tags, render_face
from tilefab.pipeline.inspection.job_prints import JobPrints
from tilefab.pipeline.inspection.places import store_url
from tilefab.pipeline.maps import JobMaps
from tilefab.pipeline.plan import Plan
from tilefab.types import Array


@dataclass(frozen=True)
class TracedTile:
    """What is known of a tile.

    Attributes
    ----------
    recognition
        Which face it shows, if any.
    code
        All that re-creates that face, in a line; empty if it isn't ours.
    run_id, arm_id
        Its print in the line's journal; ``None`` where it wasn't printed on a line, or no line was asked.
    printed_at, passed_at
        When it was printed and passed to the kiln.
    fired_at, image, grade
        When it was photographed behind the kiln, in which image, and what it was sold as; from the inspections.
    correction, reason, corrected_at
        Correction of the colours that it was printed with (0: none), why it was made, and when.
    profile, profile_sha256
        Of the press.
    file
        Its print file in the job's folder; empty if it has none.
    prints
        How often its face was printed on the line, scrapped ones left out; the last of these is told of.
    """

    recognition: Recognition
    code: str = ""
    run_id: int | None = None
    arm_id: int | None = None
    printed_at: datetime | None = None
    passed_at: datetime | None = None
    fired_at: datetime | None = None
    image: str = ""
    grade: Grade | None = None
    correction: int = 0
    reason: str = ""
    corrected_at: datetime | None = None
    profile: str = ""
    profile_sha256: str = ""
    file: str = ""
    prints: int = 0


def trace_tile(
    plan: Plan, maps: JobMaps, recognition: Recognition, prints: JobPrints | None, line_file: LineFile | None
) -> TracedTile:
    """Find out what is known of a recognised tile.

    Parameters
    ----------
    plan, maps
        The job.
    recognition
        Which face it shows.
    prints, line_file
        Where it was printed; ``None``: not asked.

    Raises
    ------
    JournalError
        If the inspections can't be read.
    OutputError
        If the job's manifest can't be read.
    """
    face = recognition.face
    if face is None:
        return TracedTile(recognition)
    record = Manifest(plan.output).records.get(face)
    file = str(plan.output / record.file) if record is not None and record.job == plan.job_hash else ""
    print_ = prints.newest(face) if prints is not None else None
    made = prints.correction(print_) if prints is not None and print_ is not None else None
    seen = _seen(line_file, print_) if line_file is not None and print_ is not None else None
    return TracedTile(
        recognition=recognition,
        code=face_code(plan, maps.press, face),
        run_id=print_.run_id if print_ is not None else None,
        arm_id=print_.arm_id if print_ is not None else None,
        printed_at=print_.printed_at if print_ is not None else None,
        passed_at=print_.passed_at if print_ is not None else None,
        fired_at=seen.taken_at if seen is not None else None,
        image=seen.image if seen is not None else "",
        grade=seen.grade if seen is not None else None,
        correction=print_.correction if print_ is not None else 0,
        reason=made.reason if made is not None else "",
        corrected_at=made.made_at if made is not None else None,
        profile=plan.press_profile.description,
        profile_sha256=plan.press_profile.sha256,
        file=file,
        prints=len(prints.prints(face)) if prints is not None else 0,
    )


def _seen(line_file: LineFile, print_: PrintRecord) -> InspectionRecord | None:
    """The inspection of a print."""
    url = store_url(line_file)
    if not InspectionStore.exists(url, line=line_file.name):
        return None
    with InspectionStore.look(url, line=line_file.name) as store:
        found = [tile for tile in store.tiles(run_id=print_.run_id, face=print_.face) if tile.arm_id == print_.arm_id]
    return found[0] if found else None


def reprint_tile(
    plan: Plan,
    maps: JobMaps,
    face: int,
    path: Path,
    *,
    prints: JobPrints | None = None,
    line_file: LineFile | None = None,
    threads: int | None = None,
) -> bool:
    """Write the print data of a face as it was printed last, its correction included.

    Parameters
    ----------
    plan, maps
        The job.
    face
        Its index.
    path
        A .tif file.
    prints, line_file
        Where it was printed; ``None``: as the job says.
    threads
        For rendering.

    Returns
    -------
    bool
        Whether they were compared with what the printer received then.

    Raises
    ------
    OutputError
        If they aren't what was printed, or can't be written.
    """
    print_ = prints.newest(face) if prints is not None else None
    press = maps.press
    if prints is not None and print_ is not None and print_.correction:
        press = prints.press(print_)
    pixels = render_face(plan, press, face, threads=threads)
    compared = False
    if line_file is not None and print_ is not None:
        compared = _is_what_was_received(line_file, print_, pixels)
    else:
        check_face_record(plan, face, pixels)
    write_print_tiff(path, pixels, print_tags(plan, press, face))
    return compared


def _is_what_was_received(line_file: LineFile, print_: PrintRecord, pixels: Array) -> bool:
    """Whether print data are what the printer received; False if the journal doesn't know."""
    with Journal.look(line_file.journal_url, line=line_file.name) as journal:
        arm = journal.arm_of(print_.run_id, print_.face)
    if arm is None or arm.arm_id != print_.arm_id or arm.data_crc32 is None:
        return False
    crc = zlib.crc32(pixels.data)
    if crc != arm.data_crc32:
        raise OutputError(
            f"face {print_.face}: its print data have the checksum {crc:08x} now, but the printer received "
            f"{arm.data_crc32:08x}: bring back the job's folder that it was printed from, with its maps"
        )
    return True
