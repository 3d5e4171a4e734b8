"""What a press's profile, or a device link, is used as."""

from __future__ import annotations

from tilefab.colour.grid_layout import MOST_CHANNELS
from tilefab.colour.transform import Intent, PressTransform
from tilefab.errors import ProfileError
from tilefab.io.icc import IccProfile, channels_of, require_press_profile, tag_bytes
from tilefab.io.icc_tables import device_to_pcs, pcs_to_device
from tilefab.io.icc_tags import colorant_names

_USUAL_NAMES = {1: ("Black",), 4: ("Cyan", "Magenta", "Yellow", "Black")}


def press_transform(profile: IccProfile, intent: Intent) -> PressTransform:
    """A press's conversions, of its profile.

    Parameters
    ----------
    profile
        An output profile of 1 to 8 inks.
    intent
        "perceptual", "relative", "saturation" or "absolute".

    Raises
    ------
    ProfileError
        If it is no press profile, has more inks, its tables are damaged, or its white is no colour.
    ValueError
        If the intent has no such name.
    """
    require_inks(require_press_profile(profile))
    return PressTransform(pcs_to_device(profile, intent), device_to_pcs(profile, "relative"), profile.white_xyz, intent)


def require_inks(profile: IccProfile) -> IccProfile:
    """The same profile, if it has no more inks than faces are printed with.

    Raises
    ------
    ProfileError
        If it has more than 8.
    """
    if profile.channels > MOST_CHANNELS:
        raise ProfileError(
            f"{profile.path}: a profile for {profile.channels} inks, but tilefab prints with 1 to {MOST_CHANNELS}: "
            "choose another",
            path=profile.path,
        )
    return profile


def link_ink_names(link: IccProfile) -> tuple[str, ...]:
    """Names of the inks that a device link ends in: its own, else the usual ones for their number.

    Raises
    ------
    ProfileError
        If its table of names is damaged.
    """
    inks = channels_of(link.pcs)
    body = tag_bytes(link, "clot")
    names = () if body is None else colorant_names(body, "clot", link.path)
    if len(names) == inks and all(names):
        return names
    return _USUAL_NAMES.get(inks) or tuple(f"Ink {ink}" for ink in range(1, inks + 1))
