"""The measurements that a press profile carries, and the press model fitted to them."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from tilefab.errors import OutputError, ProfileError
from tilefab.io.cgats import Measurements, parse_measurements
from tilefab.io.icc import IccProfile, measurement_text
from tilefab.io.press_model_file import SUFFIX, load_press_model, save_press_model
from tilefab.pipeline.profiling import FittedPress, fit_press

FIT_VERSION = 1
"""Raised whenever the same measurements would be fitted into another model."""

_KEY_DIGITS = 16


def carried_measurements(profile: IccProfile) -> Measurements:
    """The measurements in a press profile.

    Raises
    ------
    ProfileError
        If it carries none, they can't be read, or they are of other inks than it drives.
    """
    name = profile.path
    text = measurement_text(profile)
    if text is None:
        raise ProfileError(
            f"{name}: carries no measurements, so its press can't be modelled: build the profile with tilefab profile "
            "build, or with a tool that embeds them",
            path=name,
        )
    found = parse_measurements(text, f"{name}, measurements in it")
    same_inks(found.ink_names, profile, f"{name}, measurements in it", any_names=True)
    return found


def same_inks(names: tuple[str, ...], profile: IccProfile, source: str, *, any_names: bool = False) -> None:
    """Make sure that something belongs to a profile's inks.

    Parameters
    ----------
    names
        Its inks, in its order.
    profile
        The profile.
    source
        What to call it.
    any_names
        Whether inks may be called otherwise, as long as they don't stand in another order.

    Raises
    ------
    ProfileError
        If number, names or order differ.
    """
    ours, theirs = ([name.strip().casefold() for name in some] for some in (profile.ink_names, names))
    if len(theirs) != len(ours):
        raise ProfileError(
            f"{source}: has {len(theirs)} inks, but {profile.path} drives {len(ours)}: give what belongs to this press",
            path=source,
        )
    if theirs == ours or (any_names and sorted(theirs) != sorted(ours)):
        return
    raise ProfileError(
        f"{source}: is of the inks {', '.join(names)}, but {profile.path} drives {', '.join(profile.ink_names)}, in "
        "this order: give what belongs to this press",
        path=source,
    )


@dataclass(frozen=True)
class _Wanted:
    """A model to fit: the same profile is fitted once in a process."""

    sha256: str
    profile: IccProfile = field(compare=False)
    folder: Path | None = field(compare=False)


def carried_press(profile: IccProfile, folder: Path | None = None) -> tuple[FittedPress, Measurements]:
    """The press model of the measurements that a profile carries, with them.

    Parameters
    ----------
    profile
        The profile.
    folder
        Where the model is kept, so that it need not be fitted again; None: nowhere. Not being able to write there is no
        error.

    Raises
    ------
    ProfileError
        If it carries no measurements, or they can't be believed.
    """
    return _carried_press(_Wanted(profile.sha256, profile, folder))


@lru_cache(maxsize=2)
def _carried_press(wanted: _Wanted) -> tuple[FittedPress, Measurements]:
    profile, folder = wanted.profile, wanted.folder
    measurements = carried_measurements(profile)
    key = hashlib.sha256(f"{FIT_VERSION} {profile.sha256}".encode()).hexdigest()
    path = None if folder is None else folder / f"{key[:_KEY_DIGITS]}{SUFFIX}"
    kept = None if path is None else load_press_model(path, key)
    if kept is not None and kept[0].inks == profile.channels:
        with suppress(KeyError, TypeError, ValueError):
            model, notes = kept
            black = None if notes["black"] is None else int(notes["black"])
            warnings = tuple(str(warning) for warning in notes["warnings"])
            return FittedPress(model, black, int(notes["left_out"]), warnings), measurements
    press = fit_press(measurements, f"{profile.path}, measurements in it")
    if path is not None:
        notes = {"black": press.black, "left_out": press.left_out, "warnings": list(press.warnings)}
        with suppress(OutputError):
            save_press_model(path, press.model, key, notes)
    return press, measurements
