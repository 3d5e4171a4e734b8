"""Campaigns against a whole line: daemons killed at a step or at any moment, one after the other, and then judged."""

from __future__ import annotations

import contextlib
import random
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.line_workshop import (
    STOPPED,
    PlantProcess,
    QuickMaps,
    Workplace,
    judge,
    kill_at,
    plant_process,
    wait_for,
    wait_or_kill,
    write_job,
    write_line,
    write_slab,
)
from tilefab.control.ledger import ArmState
from tilefab.pipeline.line.probe import CORRECTION_STEPS, STEPS

LAST = "run.finished"
ANY = "any moment"
KILLED = -9
_REPEATED = frozenset(STEPS[STEPS.index("arm.before") : STEPS.index(LAST)])
"""Steps that each tile goes through, so that they come more than once in a daemon's life."""

_AT_REST = frozenset(STEPS[: STEPS.index("arm.before")])
"""Steps before the belt moves: where one isn't met by then, the daemon has nothing to do there."""

_LONGEST_S = 2.5
_LONGEST_AT_REST_S = 0.9
_MORE = 60
_END_S = 120.0
_CORRECTED = "[inspection]\ncorrection_interval_min = 0\n"


@dataclass
class Kills:
    """What came of killing daemons at one step.

    Attributes
    ----------
    step
        The step, or `ANY`.
    kills
        How many were killed there.
    faces
        Faces of the job by what the journal has them as in the end.
    wrong
        What must not be.
    doubled, lost
        Of these: faces that the plant printed twice, and those without an end.
    blank
        Tiles that went to scrap without a face.
    """

    step: str
    kills: int = 0
    faces: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    doubled: int = 0
    lost: int = 0
    blank: int = 0


@contextlib.contextmanager
def workplace(
    folder: Path,
    *,
    rate: float = 20.0,
    rtu: bool = False,
    speed: float = 200.0,
    corrected: bool = False,
    **job: Any,
) -> Iterator[tuple[PlantProcess, Workplace]]:
    """A plant and a line with one job, perhaps corrected all the time by its eager operator."""
    folder.mkdir(exist_ok=True)
    write_slab(folder)
    job_path = write_job(folder, **job)
    with plant_process(folder, rate=rate) as plant:
        more = _CORRECTED if corrected else ""
        place = Workplace.open(job_path, write_line(folder, plant.endpoints, rtu=rtu, speed=speed, more=more))
        if corrected:
            place.maps = QuickMaps(place.source.maps.press)
        yield plant, place


def kill_often(
    plant: PlantProcess, place: Workplace, step: str, kills: int, *, seed: int, check_pixels: int = 8
) -> Kills:
    """Kill daemons at a step until it happened so often, finish the job, and judge.

    The job gets more faces whenever it comes to its end before that.
    """
    found, chance = Kills(step), random.Random(f"{step} {seed}")
    tried = 0
    while found.kills < kills:
        tried += 1
        if tried > 10 * kills + 20:
            found.wrong.append(f"the step {step} came only {found.kills} times in {tried} daemons")
            break
        if step == ANY:
            code = wait_or_kill(place.fork(lambda _: None), chance.uniform(0.0, 1.2))
            found.kills += code == KILLED
        else:
            count = chance.choice((1, 1, 2, 3, 5, 8)) if step in (*_REPEATED, *CORRECTION_STEPS) else 1
            begun, longest = time.monotonic(), _longest_s(step)
            code = wait_or_kill(place.fork(kill_at(step, count)), longest)
            found.kills += code == KILLED and time.monotonic() - begun < longest
        if code == STOPPED or (code == KILLED and step == LAST):
            place = place.more(_MORE if step != LAST else 5)
        elif code != KILLED:
            found.wrong.append(f"a daemon ended with {code}")
            break
    code = wait_or_kill(place.fork(lambda _: None), _END_S)
    if code != STOPPED:
        found.wrong.append(f"the line can't finish its job: {code}")
    judged = judge(plant, place, check_pixels=check_pixels)
    found.wrong += judged.wrong
    found.faces = judged.faces
    found.lost = sum("is lost" in text or "is still" in text for text in judged.wrong)
    summary = plant.do("truth", summary=True)["summary"]
    found.doubled = summary["faces_twice"]
    found.blank = summary["tiles"] - summary["prints"]
    return found


def _longest_s(step: str) -> float:
    if step == LAST:
        return _END_S
    return _LONGEST_AT_REST_S if step in _AT_REST else _LONGEST_S


def kill_block(folder: Path, step: str, kills: int, seed: int, *, rtu: bool = False) -> Kills:
    """`kill_often` on a plant of its own; at steps of corrections, and at any moment, colours are corrected, too."""
    corrected = step in CORRECTION_STEPS or step == ANY
    rate, count = 10.0 if rtu else 20.0, _MORE if step != LAST else 5
    with workplace(folder, rate=rate, rtu=rtu, corrected=corrected, seed=seed, count=count) as here:
        return kill_often(*here, step, kills, seed=seed)


def in_doubt(faces: Counter[str]) -> int:
    """Faces whose state nobody knows."""
    return faces[ArmState.IN_DOUBT.value]


__all__ = ["ANY", "KILLED", "LAST", "Kills", "in_doubt", "kill_block", "kill_often", "wait_for", "workplace"]
