"""What is said to the person with the scanner: why there is no result, and what to know before using one."""

import numpy as np
from jaxtyping import Bool, Float, Int

from cablejax.geometry.principal import principal_axes
from cablejax.measure.errors import MeasureError, NoCableError
from cablejax.measure.find.cables import Find, share
from cablejax.measure.shape.stretches import ONE

MIN_POINTS = 50
SMALLEST_MM, LARGEST_MM = 1.0, 250.0  # no power cable is thinner or thicker, sheath included
LONGEST_MM = 1e6
SHIFTED = (
    "The scan is of several sweeps, whose shifts are fitted: an oval section passes for shifts in part, so the ovality is at "
    "least what is given, and its own interval does not cover that."
)
STRAYED = 4.0  # times the radius that the search found: a wall fits a short noisy arc as well
UNLIKE = 2.0  # ratio of the scatter found to the one that a known scanner leaves
FLAT_ARC_DEG = 120.0  # of circumference, from which the noise put on anew tells better what it does
LEAST_HEIGHT = 2.5  # standard deviations of the noise that an arc must stand out; below, fits end on anything


def check_cloud(xyz: Float[np.ndarray, "n 3"], given: int) -> None:
    """Refuse clouds on which nothing can be sought.

    Raises:
        MeasureError: For too few points, or points that all coincide or lie on one line.
    """
    if len(xyz) < MIN_POINTS:
        lost = "" if given == len(xyz) else f" ({given - len(xyz)} of {given} rows hold no valid coordinates)"
        raise MeasureError(f"Too few points: {len(xyz)} where at least {MIN_POINTS} are needed{lost}.")
    extent = np.ptp(xyz, axis=0)
    if extent.max() == 0:
        raise MeasureError(f"All {len(xyz)} points are equal: there is no surface to measure.")
    spread = principal_axes(xyz).std
    if spread[1] < 1e-9 * spread[0]:
        raise MeasureError("All points lie on one line: there is no surface to measure.")


def check_labels(valid: Bool[np.ndarray, " n"], on_cable: Bool[np.ndarray, " n"]) -> None:
    """Refuse labels that leave too few points.

    Raises:
        MeasureError: With their number.
    """
    left, points = int((valid & on_cable).sum()), int(valid.sum())
    if left < MIN_POINTS <= points:
        raise NoCableError(
            f"No cable found: of {points:,} points {left} are labelled as the cable's, where at least {MIN_POINTS} are needed."
        )


def check_box(valid: Bool[np.ndarray, " n"], within: Bool[np.ndarray, " n"]) -> None:
    """Refuse a box that holds too few points.

    Raises:
        MeasureError: With their number.
    """
    if within.sum() < MIN_POINTS <= valid.sum():
        raise NoCableError(
            f"No cable found: of {valid.sum():,} points {within.sum()} lie in the box, where at least {MIN_POINTS} are needed."
        )


def not_found_again(why: str, *, known: bool) -> MeasureError:
    """The error where a simulated scan of the cable that was found shows none: by the scanner's numbers, or the noise found."""
    made, doubt = (
        ("made with the scanner's numbers", "Are the numbers right? ") if known else ("with as much noise", "")
    )
    return MeasureError(
        f"The diameter cannot be told: a scan of the cable that was found, {made}, does not show it "
        f"({why.rstrip('.')}). {doubt}Scan the cable with less noise or from more sides."
    )


def about_instrument(excess: float | None, *, given: bool) -> list[str]:
    """A sentence where the scanner's numbers were of no use, or the points scatter unlike them.

    Args:
        excess: Scatter that was found over the one that they tell; None where they were not used.
        given: Whether there were any.
    """
    if given and excess is None:
        return [
            "The scanner's numbers were not used: the rows of the file do not show in which direction its beams ran."
        ]
    if excess is None or 1 / UNLIKE <= excess <= UNLIKE:
        return []
    why = (
        "was it filtered before, or is it another scanner's?"
        if excess < 1
        else "is the scanner right, and its distance?"
    )
    return [f"The points scatter {excess:.2g} times as much about the surface as the scanner's numbers tell: {why}"]


def nothing_found(find: Find) -> MeasureError:
    """The error for a scan without a cable: a plane instead, or nothing round, or nothing within the limits."""
    if (limits := find.limits.in_words()) and not find.tracks:
        return NoCableError(f"No cable found with {limits}: widen the limits, or cut the scan closer to the cable.")
    if find.planes and find.flat_share > 0.5:
        return NoCableError(
            f"No cable found: {100 * find.flat_share:.0f} % of the points lie on "
            f"{'a plane' if len(find.planes) == 1 else f'{len(find.planes)} planes'}, and the rest is not round. "
            "Scan the cable itself, or cut the scan closer to it."
        )
    return NoCableError(
        "No cable found: nothing in the scan is round and at least as long as its own radius. "
        "Cut the scan closer to the cable, or scan it with more points."
    )


def arc_too_small(arc_deg: float, least_deg: float, find: Find) -> MeasureError:
    """The error for a scan that shows too little of the circumference."""
    flat = " The points may as well lie on a plane." if arc_deg < 20 or find.planes else ""
    return MeasureError(
        f"The scan shows {arc_deg:.0f} degrees of the circumference, and at least {least_deg:.0f} are needed for a "
        f"diameter.{flat} Scan the cable from a second side."
    )


def arc_too_small_for_errors(arc_deg: float, least_deg: float, shared_mm: float) -> MeasureError:
    """The error for a short arc seen by a scanner whose errors are correlated."""
    return MeasureError(
        f"The diameter cannot be told: neighbouring points share errors of {shared_mm:.2g} mm, as on glossy surfaces or behind a "
        f"filter, and over {arc_deg:.0f} degrees of the circumference these look like another diameter; at least {least_deg:.0f} "
        "are needed, or the scanner's own numbers. Scan the cable from a second side."
    )


def too_rough(noise_mm: float, radius_mm: float) -> MeasureError:
    """The error for points that lie about a fit rather than on it."""
    return NoCableError(
        f"No cable found: what is roundest has a radius of {radius_mm:.3g} mm, and the points scatter by {noise_mm:.3g} mm "
        "about it. Cut the scan closer to the cable, or scan it with less noise."
    )


def not_round(faces: int, diameter_mm: float) -> MeasureError:
    """The error for a section of flat faces: a box, its edge, a bar."""
    return NoCableError(
        f"No cable found: what is roundest, some {diameter_mm:.3g} mm across, is better explained by {faces} flat faces than "
        "by a circle. Cut the scan closer to the cable."
    )


def no_surface(diameter_mm: float) -> MeasureError:
    """The error for points that lie about a fit as densely as on it."""
    return NoCableError(
        f"No cable found: what is roundest, some {diameter_mm:.3g} mm across, stands out of nothing: points lie about it as "
        "densely as on it, and fill a solid. Cut the scan closer to the cable."
    )


def made_of_smaller(diameter_mm: float) -> MeasureError:
    """The error for points near a cylinder whose normals are not the cylinder's."""
    return NoCableError(
        f"No cable found: what is roundest, some {diameter_mm:.3g} mm across, is made of smaller things: its points face "
        "elsewhere than those of a cylinder. Cut the scan closer to one cable, or say how thick it is."
    )


def not_sought(diameter_mm: float, limits_mm: tuple[float, float]) -> MeasureError:
    """The error for a thing that is thinner or thicker than what is sought."""
    return NoCableError(
        "No cable found with diameters of {:g} to {:g} mm: ".format(*limits_mm)
        + f"what is roundest has {diameter_mm:.4g} mm."
    )


def not_one_surface(shared_mm: float, radius_mm: float) -> MeasureError:
    """The error for points that leave the circle together: a thing of another shape, or several."""
    return NoCableError(
        f"No cable found: what is roundest has a radius of {radius_mm:.3g} mm, and neighbouring points leave it together by "
        f"{shared_mm:.3g} mm: it is of another shape, or several things. Cut the scan closer to the cable."
    )


def strayed(found_mm: float, fitted_mm: float) -> MeasureError | None:
    """The error for a fit that has left what the search found for something much flatter; None if it has not."""
    if fitted_mm < STRAYED * found_mm:
        return None
    return MeasureError(
        f"The diameter cannot be told: what looks like a radius of {found_mm:.3g} mm in the thinned scan is one of "
        f"{fitted_mm:.3g} mm by all of its points. Scan the cable with less noise or from more sides."
    )


def unknown_diameter(diameter_mm: float, std_mm: float, arc_deg: float) -> MeasureError:
    """The error for a fit that leaves the diameter open."""
    return MeasureError(
        f"The diameter cannot be told: {diameter_mm:.4g} mm with a standard uncertainty of {std_mm:.4g} mm, from "
        f"{arc_deg:.0f} degrees of the circumference. Scan the cable with less noise or from more sides."
    )


def too_few_pixels(diameter_mm: float, pitch_mm: float) -> MeasureError:
    """The error for a thing that a depth image shows on few pixels."""
    return MeasureError(
        f"The diameter cannot be told: {diameter_mm:.3g} mm are {diameter_mm / pitch_mm:.0f} pixels of the depth image, whose "
        "blur leaves nothing round of it. Scan the cable from nearer."
    )


def too_flat(arc_deg: float, noise_mm: float, radius_mm: float) -> MeasureError | None:
    """The error for an arc that stands out of its own noise too little to have a radius; None if it does not."""
    if arc_deg >= FLAT_ARC_DEG:
        return None
    height = radius_mm * (1 - np.cos(np.radians(min(arc_deg, 180.0) / 2)))
    if height >= LEAST_HEIGHT * noise_mm:
        return None
    return MeasureError(
        f"The diameter cannot be told: over the {arc_deg:.0f} degrees that were seen the surface curves by {height:.3g} mm, "
        f"and the points scatter by {noise_mm:.3g} mm. Scan the cable with less noise or from more sides."
    )


def about_number(found: int, missed: int, expected: int | None) -> tuple[str, ...]:
    """A sentence where another number of cables was found than there should be."""
    if expected is None or expected == found:
        return ()
    seen = f", and {missed} round things that could not be measured" if missed else ""
    return (f"{found} {'cable was' if found == 1 else 'cables were'} measured where {expected} were expected{seen}.",)


def found_once(diameter_mm: float) -> MeasureError:
    """The error for a thing in clutter that one search of three found."""
    return NoCableError(
        f"No cable found for certain: one search saw something of {diameter_mm:.3g} mm, and two with other random samples did "
        "not. Cut the scan closer to the cable, or say where it is or how thick."
    )


def about_one_find(diameter_mm: float) -> str:
    """A sentence where the other searches found things that could not be measured."""
    return (
        f"One search of three measured this, {diameter_mm:.4g} mm; the others found round things that they could not measure: "
        "cut the scan closer to the cable."
    )


def about_other_find(diameter_mm: float, other_mm: float) -> str:
    """A sentence where two searches found different things."""
    return (
        f"Two searches with different random samples found different things, of {diameter_mm:.4g} and {other_mm:.4g} mm: cut "
        "the scan closer to the cable, say where it is or how thick, or measure every one."
    )


def about_other_candidate(told_mm: float, other_mm: float, on_cable: float, *, taken: str) -> str:
    """A sentence that names both candidates where search and labels disagree.

    Args:
        told_mm: Diameter of the one that is told.
        other_mm: Of the other.
        on_cable: Share of the points of the search's candidate that are labelled as a cable's.
        taken: "search" or "labels", whose candidate is told.
    """
    search, labels = (other_mm, told_mm) if taken == "labels" else (told_mm, other_mm)
    return (
        f"Two candidates: the search in all points finds {search:.4g} mm, in the points that a network labels as a cable's "
        f"{labels:.4g} mm. The {'latter' if taken == 'labels' else 'former'} is told, for of the former's points "
        f"{100 * on_cable:.0f} % are labelled as a cable's; look at both, or cut the scan closer to the cable."
    )


def about_accessory(share: float) -> str:
    """A sentence where what was measured is labelled as an accessory."""
    return (
        f"Of the points that the diameter rests on, {100 * share:.0f} % are labelled as a joint's, stress cone's or "
        "termination's: it may not be the cable's own diameter."
    )


def about_walls(diameter_mm: float, other_mm: float | None) -> list[str]:
    """A sentence where two surfaces lie about one axis."""
    if other_mm is None:
        return []
    where = "within" if other_mm < diameter_mm else "about"
    sentence = (
        f"A second surface lies {where} this one, {other_mm:.4g} mm across: the other side of a wall, or sweeps that are not "
        "registered. Its points were left out; limits of the diameter say which of the two is meant."
    )
    return [sentence]


def about_form(form: str) -> list[str]:
    """A sentence where the thing has no one diameter along its length."""
    if form == ONE:
        return []
    subject = "Along its length it is" if form.startswith("not") else "It"
    return [f"{subject} {form}: the diameter is a mean over the length, and its interval holds what varies."]


def about_shifts(sweep: Int[np.ndarray, " n"] | None, *, oval_known: bool) -> list[str]:
    """A sentence where shifts of sweeps were fitted that an oval section passes for."""
    return [SHIFTED] if oval_known and sweep is not None and sweep.max() > 0 else []


def _about_unit(diameter_mm: float, length_mm: float) -> list[str]:
    size = f"The diameter comes out at {diameter_mm:.4g} mm"
    if diameter_mm < SMALLEST_MM:
        return [f"{size}, thinner than any power cable: is the file in metres rather than millimetres?"]
    if diameter_mm > 1000 * SMALLEST_MM and length_mm > 1e4:
        return [f"{size}, thicker than any cable: was a file in millimetres read as metres?"]
    if diameter_mm > LARGEST_MM:
        return [f"{size}, thicker than any power cable: this is a pole, a pipe or a stem, or the unit is wrong."]
    if length_mm > LONGEST_MM:
        return [f"The length comes out at {length_mm / 1000:.4g} m: is the unit of the file right?"]
    return []


def warnings_about(
    diameter_mm: float, length_mm: float, arc_deg: float, find: Find, *, oval_arc_deg: float
) -> list[str]:
    """Sentences that belong beside a result."""
    out = _about_unit(diameter_mm, length_mm)
    if arc_deg < oval_arc_deg:
        out.append(
            f"Only {arc_deg:.0f} degrees of the circumference were seen: the section is taken to be round, "
            "and an oval one would not show."
        )
    for number, second in enumerate(find.tracks[1:], 1):
        first, *between = find.tracks[:number]
        alike = 0.5 < 2 * second.radius_mm / diameter_mm < 2 and second.length_mm > 0.3 * first.length_mm
        if alike and share(second, first) < 0.1 and all(share(second, better) < 0.3 for better in between):
            out.append(
                f"A second cable was found, of about {2 * second.radius_mm:.3g} mm over {second.length_mm:.0f} mm: the "
                "longer and better one was measured; `measure_cables` and `cablejax measure --all` measure every one."
            )
    if length_mm < 2 * diameter_mm:
        out.append("The piece is shorter than two diameters: a short round thing may be no cable at all.")
    return out
