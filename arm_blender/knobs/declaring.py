"""What a declared knob consists of, and what can be asked of a class of knobs. Imports nothing heavy."""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from ..errors import ArmError


@dataclass(frozen=True)
class Rule:
    """What a value may be.

    Attributes:
        holds: whether it does.
        words: what to do where it does not, after the option's name and the value.
    """

    holds: Callable[[Any], bool]
    words: str


ANY = Rule(lambda _: True, "")


def within(low: float, high: float, words: str = "") -> Rule:
    """From `low` to `high`, both included; NaN is not."""
    return Rule(lambda value: low <= value <= high, words or f"give {low:g} to {high:g}")


def one_of(names: tuple[str, ...], words: str = "unknown; choose one of {}") -> Rule:
    """One of `names`, which go into `words`."""
    return Rule(lambda value: value in names, words.format(", ".join(names)))


@dataclass(frozen=True)
class Shown:
    """How Blender's panel shows a knob.

    Attributes:
        title: its label.
        tip: what is said where the mouse rests on it.
        name: of the property, where that is not the knob's.
        default: where the panel begins, where that is not where the command line begins.
        none: what stands for None in the panel, whose properties know none.
        low, high: ends of a number.
        soft_high: that of its slider.
        items: of a choice: value, title and tip of each.
    """

    title: str
    tip: str
    name: str = ""
    default: Any = None
    none: Any = None
    low: float | None = None
    high: float | None = None
    soft_high: float | None = None
    items: tuple[tuple[str, str, str], ...] = ()


@dataclass(frozen=True)
class Knob:
    """A declared choice.

    Attributes:
        default: None leaves it to something else: the quality, the machine, the views.
        help: of the command line.
        rule: of a value that is not None. Of a `Literal` it is known.
        letter: stands for a value in the help.
        option: of the command line, without the dashes in front; the field's name, if not said otherwise.
        listed: an item of a batch's list may say it for itself.
        kept: with what was made so; what is the machine's is not.
        shown: in Blender's panel; None is not.
        name: of the field.
        kind: makes its value of a word, as argparse takes it: int, float, str, Path, `numbers`; or bool.
    """

    default: Any
    help: str | None
    rule: Rule = ANY
    letter: str | None = None
    option: str = ""
    listed: bool = False
    kept: bool = True
    shown: Shown | None = None
    name: str = ""
    kind: Callable[[str], Any] = str

    @property
    def column(self) -> str:
        """Its name in a batch's list."""
        return self.option.replace("-", "_")


def knob(default: Any, *words: Any, **more: Any) -> Any:
    """A field that is a knob; the arguments are those of `Knob`."""
    return field(default=default, metadata={"knob": Knob(default, *words, **more)})


def numbers(text: str) -> tuple[float, ...]:
    """Numbers of 0 or more, separated by commas."""
    try:
        found = tuple(float(word) for word in text.split(","))
    except ValueError:
        found = ()
    if not found or not all(math.isfinite(number) and number >= 0.0 for number in found):
        raise argparse.ArgumentTypeError(f"{text!r}: give numbers of 0 or more, separated by commas")
    return found


def indices(text: str) -> tuple[int, ...]:
    """Whole numbers, separated by commas."""
    try:
        return tuple(int(word) for word in text.split(","))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: give numbers of views, separated by commas") from error


_KINDS: dict[Any, tuple[Callable[[str], Any], str | None]] = {
    bool: (bool, None),
    int: (int, "N"),
    float: (float, "N"),
    Path: (Path, "DIR"),
    tuple[float, ...]: (numbers, "W,W,..."),
    tuple[int, ...]: (indices, "I,I"),
}
"""What makes a value of a word, and the letter of one; of everything else it is a word."""


def knobs_of(declared: type) -> list[Knob]:
    """The knobs that a class declares or inherits, in their order."""
    return [_whole(one.name, one.type, one.metadata["knob"]) for one in fields(declared) if "knob" in one.metadata]


def _whole(name: str, annotation: Any, one: Knob) -> Knob:
    """A knob with what its field's name and type say of it."""
    parts = (annotation, *get_args(annotation))
    kind, letter = next((_KINDS[part] for part in parts if part in _KINDS), (str, None))
    rule = one_of(get_args(annotation)) if get_origin(annotation) is Literal and one.rule is ANY else one.rule
    option = one.option or name.replace("_", "-")
    return replace(one, name=name, kind=kind, letter=one.letter or letter, rule=rule, option=option)


def values_of(declared: type, holder: object) -> dict[str, Any]:
    """The values of a class's knobs, of what has them as attributes: the command line's words, a request."""
    return {one.name: getattr(holder, one.name) for one in knobs_of(declared)}


def check(chosen: Any) -> None:
    """That every knob of an instance is what it may be.

    Raises:
        ArmError: one is not; the line names its option and the remedy.
    """
    for one in knobs_of(type(chosen)):
        value = getattr(chosen, one.name)
        if value is not None and not one.rule.holds(value):
            said = ",".join(map(str, value)) if isinstance(value, tuple) else value
            raise ArmError(f"--{one.option} {f'{said:g}' if isinstance(said, float) else said}: {one.rule.words}")
