"""Finishes that an artist may give a region by hand: presets by name, or plain numbers, and the words for them.

Imports nothing heavy.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from ..errors import ArmError

MOST_REGIONS = 8
"""Regions of an object at most."""

EXAMPLE = "2=chrome,3=0.3/1"


@dataclass(frozen=True)
class Finish:
    """What a surface is like, beside its colour.

    Attributes:
        roughness: in [0, 1], perceptual (alpha = roughness**2).
        metallic: in [0, 1].
        f0: linear Rec.709 in [0, 1], reflectance straight on: the base colour of a metal of that name; None leaves the
            colour to what the views say.
    """

    roughness: float
    metallic: float
    f0: tuple[float, float, float] | None = None


PRESETS: dict[str, Finish] = {
    "matt-paint": Finish(0.9, 0.0),
    "gloss-plastic": Finish(0.15, 0.0),
    "rubber": Finish(0.8, 0.0),
    "fabric": Finish(1.0, 0.0),
    "wood": Finish(0.6, 0.0),
    "skin": Finish(0.5, 0.0),
    "brushed-steel": Finish(0.35, 1.0, (0.562, 0.565, 0.578)),
    "chrome": Finish(0.05, 1.0, (0.549, 0.556, 0.554)),
    "gold": Finish(0.15, 1.0, (1.0, 0.782, 0.344)),
}
"""By name. F0 of iron (which steel mostly is), chromium and gold: Hoffman, "Physics and math of shading", SIGGRAPH 2015
course, the table of metals; gold's red, 1.022, is beyond Rec.709 and clamped. Roughness is what such surfaces usually
have; none of them is measured here."""


def finishes_of(text: str) -> dict[int, Finish]:
    """The finishes in words such as `2=chrome,3=0.3/1`: a region's number, then a preset or roughness/metallic.

    Raises:
        ArmError: a word is none of these; the line says what would be.
    """
    found: dict[int, Finish] = {}
    for word in filter(None, (part.strip() for part in text.split(","))):
        number, equals, finish = (part.strip() for part in word.partition("="))
        if not equals or not number.isascii() or not number.isdigit() or not 1 <= int(number) <= MOST_REGIONS:
            raise ArmError(f"{word}: is no finish of a region; give its number, 1 to {MOST_REGIONS}, as in {EXAMPLE}")
        if int(number) in found:
            raise ArmError(f"{word}: region {int(number)} has a finish already; give each region one")
        found[int(number)] = finish_of(finish)
    if not found:
        raise ArmError(f"{text!r}: names no region; give its number and a finish, as in {EXAMPLE}")
    return found


def finish_of(word: str) -> Finish:
    """A preset by its name, roughness and metallic, as in 0.3/1, or a preset with its own: gold/0.3, gold/0.3/0.9.

    Raises:
        ArmError: it is none of these.
    """
    first, *rest = word.split("/")
    preset = PRESETS.get(first)
    try:
        numbers = [float(part) for part in (rest if preset is not None else [first, *rest])]
    except ValueError:
        numbers = [-1.0]
    few = len(numbers) <= 2 if preset is not None else len(numbers) == 2
    if not few or not all(0.0 <= number <= 1.0 for number in numbers):
        raise ArmError(
            f"{word!r}: is no finish; give one of {', '.join(PRESETS)}, or roughness/metallic from 0 to 1, as in 0.3/1"
        )
    if preset is None:
        return Finish(numbers[0], numbers[1])
    roughness, metallic = (*numbers, *(preset.roughness, preset.metallic)[len(numbers) :])
    return Finish(roughness, metallic, preset.f0)


def name_of(finish: Finish) -> str:
    """The word for a finish, as `finish_of` takes it; a preset's name where it is one, or has the color of one."""
    numbers = f"{finish.roughness:g}/{finish.metallic:g}"
    named = next((name for name, preset in PRESETS.items() if preset == finish), None)
    of_its_color = next((name for name, preset in PRESETS.items() if finish.f0 and preset.f0 == finish.f0), None)
    return named or (f"{of_its_color}/{numbers}" if of_its_color else numbers)


def words_of(finishes: Mapping[int, Finish]) -> str:
    """The finishes as `finishes_of` takes them, in the order of the regions; empty where there are none."""
    return ",".join(f"{number}={name_of(finishes[number])}" for number in sorted(finishes))


def are_finishes(text: str) -> bool:
    """Whether `finishes_of` takes the words."""
    try:
        finishes_of(text)
    except ArmError:
        return False
    return True
