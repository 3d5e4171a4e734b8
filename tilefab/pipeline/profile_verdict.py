"""What the figures of a profile check mean, in a line each."""

from __future__ import annotations

from collections.abc import Sequence

from tilefab.report.profile_view import (
    ImageMatchView,
    MatchView,
    ProfileFactsView,
    RoundTripView,
    SmoothnessView,
    VerdictView,
)

# (good up to, fair up to): means and 95th percentiles of CIEDE2000, ink in percent, share of pixels.
_MATCH = ((1.0, 2.5), (2.0, 5.0))
_TRIP = ((0.6, 1.5), (1.5, 3.5))
_BEND_P95 = (2.0, 5.0)
_JUMP = (8.0, 20.0)
_OUTSIDE = (0.01, 0.10)
_GRADES = ("good", "fair", "poor")
_WHITE_OFF = 1.0


def _grade(value: float, limits: tuple[float, float]) -> int:
    return 0 if value <= limits[0] else 1 if value <= limits[1] else 2


def verdicts(
    match: MatchView | None,
    trips: Sequence[RoundTripView],
    smooth: SmoothnessView,
    image: ImageMatchView | None,
) -> tuple[VerdictView, ...]:
    """One line each on colour, separation, smoothness, and on the image where there is one."""
    lines = [_match(match), _trip(trips), _smooth(smooth), _steady(smooth)]
    if image is not None:
        grade = _GRADES[_grade(image.share_outside, _OUTSIDE)]
        text = f"{100.0 * image.share_outside:.1f} % of its pixels lie outside the gamut"
        if image.share_outside:
            text += f", by ΔE {image.outside_mean:.1f} in the mean and {image.outside_p95:.1f} at 95 %"
        lines.append(VerdictView("The image", grade, text))
    return tuple(lines)


def _match(match: MatchView | None) -> VerdictView:
    what = "Inks to colour"
    if match is None:
        return VerdictView(what, "none", "no measurements to compare with; give them with --data")
    grade = max(_grade(match.spread.mean, _MATCH[0]), _grade(match.spread.p95, _MATCH[1]))
    text = f"ΔE {match.spread.mean:.2f} mean, {match.spread.p95:.2f} at 95 %, over {match.spread.count} patches"
    return VerdictView(what, _GRADES[grade], text)


def _trip(trips: Sequence[RoundTripView]) -> VerdictView:
    what = "Colour to inks"
    relative = next((trip for trip in trips if trip.intent == "relative"), None)
    if relative is None:
        return VerdictView(what, "none", "there is no table from colour to inks")
    found = relative.spread
    grade = max(_grade(found.mean, _TRIP[0]), _grade(found.p95, _TRIP[1]))
    text = f"printable colours come back within ΔE {found.mean:.2f} mean, {found.p95:.2f} at 95 %"
    return VerdictView(what, _GRADES[grade], text)


def _smooth(smooth: SmoothnessView) -> VerdictView:
    what = "Smoothness"
    if smooth.ink_bend_percent is None or smooth.jump_percent is None:
        return VerdictView(what, "none", "no line of colours stays inside the gamut")
    grade = max(_grade(smooth.ink_bend_percent.p95, _BEND_P95), _grade(smooth.jump_percent, _JUMP))
    text = (
        f"inks bend by {smooth.ink_bend_percent.p95:.1f} % (95 %) and jump by at most {smooth.jump_percent:.1f} % "
        f"({smooth.jump_ink}) for each step of ΔE 1"
    )
    return VerdictView(what, _GRADES[grade], text)


def _steady(smooth: SmoothnessView) -> VerdictView:
    neutral, inks = smooth.neutral_reversals, sum(smooth.ink_reversals)
    grade = _GRADES[min(2, 2 * (neutral or 0) + (1 if inks else 0))]
    if not neutral and not inks:
        text = "lightness never turns round, neither along neutrals nor along an ink"
        return VerdictView("Ramps", grade, text if neutral is not None else "lightness never turns round along an ink")
    return VerdictView("Ramps", grade, f"lightness turns round {neutral or 0} times along neutrals, {inks} along inks")


def warnings_of(
    facts: ProfileFactsView, smooth: SmoothnessView, match: MatchView | None, *, asked_image: bool
) -> tuple[str, ...]:
    """What a user should know: missing tables, whites that differ, inks whose tone turns round.

    ``asked_image``: an image was given that can't be judged, for want of a table to inks.
    """
    found = [f"the profile is not complete: {what}" for what in facts.missing]
    if match is not None and match.white_delta_e is not None and _WHITE_OFF < match.white_delta_e <= 3.0:
        found.append(f"the profile's white differs from the measured one by ΔE {match.white_delta_e:.1f}")
    for name, turns in zip(facts.ink_names, smooth.ink_reversals, strict=True):
        if turns:
            found.append(f"{name} alone: lightness turns round {turns} time{'s' if turns > 1 else ''} as ink is added")
    if asked_image:
        found.append("the image can't be judged: the profile has no table from colour to inks")
    return tuple(found)
