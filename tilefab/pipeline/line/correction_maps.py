"""Maps in inks of a job's corrections: made by a process of their own, kept in the run's folder, let go in time."""

from __future__ import annotations

import asyncio
import os
import pickle
import sys
import time
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Protocol

from tilefab.errors import OutputError, TilefabError
from tilefab.io.atomic import output_error
from tilefab.pipeline.maps import job_maps, kept_press_maps, load_press_map, press_map_path
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.progress import Silent
from tilefab.sampling import TextureMap

_NICE = 10
_MAKER = "from tilefab.pipeline.line.correction_maps import make_given; make_given()"
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class CorrectionMaps(Protocol):
    """Where the maps of corrections come from."""

    async def make(self, plan: Plan) -> None:
        """See that the map of a corrected plan is kept, however long that takes, without holding up the line.

        Raises
        ------
        TilefabError
            If it can't be made or kept.
        """

    def load(self, plan: Plan, texture_hash: str) -> TextureMap:
        """The kept map of a corrected plan; blocking.

        Raises
        ------
        TextureMapError
            If it isn't there any more, is damaged, or was made from another texture map than that of this hash.
        """

    def forget(self, plan: Plan) -> None:
        """Remove the map of a corrected plan; blocking. It can be made again."""

    def tidy(self, plan: Plan, in_use: Collection[str], keep_s: float) -> None:
        """Remove maps of corrections that were followed by others a while ago; blocking.

        Parameters
        ----------
        plan
            The job.
        in_use
            ``press_key`` of maps that stay.
        keep_s
            For how long the others stay after the next one was made: tiles printed from them are still to be inspected.
        """


class KeptMaps:
    """Maps in the run's own folder, made with what the line leaves of the processors."""

    async def make(self, plan: Plan) -> None:
        """See `CorrectionMaps.make`; being cancelled ends the process that makes it."""
        if await asyncio.to_thread(_take_up, press_map_path(plan)):
            return
        # The whole plan is handed over: the job's file may have been edited since it was taken up.
        given = await asyncio.to_thread(pickle.dumps, plan)
        try:
            maker = await asyncio.create_subprocess_exec(
                sys.executable,
                "-c",
                _MAKER,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.DEVNULL,
                stderr=asyncio.subprocess.PIPE,
                env={**os.environ, **dict.fromkeys(_ONE_THREAD, "1")},
            )
        except OSError as error:
            raise OutputError(f"{plan.name}: its corrected map can't be made: {error.strerror}") from error
        try:
            _, told = await maker.communicate(given)
        except asyncio.CancelledError:
            maker.kill()
            await maker.wait()
            raise
        if maker.returncode:
            last = told.decode(errors="replace").strip().splitlines()[-1:] or [f"it ended with {maker.returncode}"]
            raise OutputError(f"{plan.name}: its corrected map can't be made: {last[0]}", path=str(plan.output))

    def load(self, plan: Plan, texture_hash: str) -> TextureMap:
        """See `CorrectionMaps.load`."""
        return load_press_map(plan, texture_hash)

    def forget(self, plan: Plan) -> None:
        """See `CorrectionMaps.forget`."""
        _remove(press_map_path(plan))

    def tidy(self, plan: Plan, in_use: Collection[str], keep_s: float) -> None:
        """See `CorrectionMaps.tidy`."""
        held = {press_map_path(replace(plan, press_key=key)) for key in (plan.press_key, *in_use)}
        begun = sorted((_begun_s(path), path) for path in kept_press_maps(plan))
        for (_, path), (followed_s, _) in pairwise(begun):
            if path not in held and time.time() - followed_s > keep_s:
                _remove(path)


def _take_up(path: Path) -> bool:
    """Whether a map is there; if so it counts as made now."""
    try:
        os.utime(path)
    except FileNotFoundError:
        return False
    except OSError as error:
        raise output_error("take up", path, error) from error
    return True


def _begun_s(path: Path) -> float:
    """When a map was made, or last taken up again."""
    try:
        return path.stat().st_mtime
    except OSError:
        return time.time()


def _remove(path: Path) -> None:
    # What can't be removed stays: a full disk is told of by whoever writes to it next.
    with suppress(OSError):
        path.unlink(missing_ok=True)


def make_given() -> None:
    """Make the map of the plan on standard input: the work of a process of its own."""
    os.nice(_NICE)
    plan: Plan = pickle.load(sys.stdin.buffer)
    try:
        job_maps(plan, Silent(), 1, must_keep=True)
    except TilefabError as error:
        sys.exit(error.message)
