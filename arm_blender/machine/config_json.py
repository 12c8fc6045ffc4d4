"""Frozen dataclasses as JSON: what stands in a checkpoint's header, read back or refused."""

import dataclasses
import sys
import types
import typing
from typing import Any, ClassVar, Protocol, TypeVar

from ..errors import CheckpointError


class Dataclass(Protocol):
    """An instance of any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


Config = TypeVar("Config", bound=Dataclass)


class UnfitConfig(CheckpointError, ValueError):
    """What a file holds is no configuration of the class that is expected; whoever knows the file adds its name."""


def config_from_dict(expected: type[Config], values: dict[str, Any]) -> Config:
    """A (nested) dataclass from what JSON kept of it. A field that is absent takes its default.

    A class may name fields in `RETIRED` that it had, each with the only value that it still stands for.

    Raises:
        UnfitConfig: a key is unknown, or a value does not fit its field.
        TypeError: a field without a default is absent.
    """
    hints = typing.get_type_hints(expected)
    known = {field.name for field in dataclasses.fields(expected) if field.init}
    if not isinstance(values, dict):
        raise UnfitConfig(f"unknown config key {values} for {expected.__name__}")
    retired = getattr(expected, "RETIRED", {})
    values = {key: value for key, value in values.items() if key not in retired or value != retired[key]}
    if values.keys() - known:
        raise UnfitConfig(f"unknown config key {sorted(values.keys() - known)} for {expected.__name__}")
    return expected(**{key: _typed(hints[key], value, key) for key, value in values.items()})


def _typed(hint: Any, value: Any, key: str) -> Any:
    """`value` from JSON as the type that `hint` states: JSON knows neither tuples nor dataclasses."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return config_from_dict(hint, value)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        return _typed(next(a for a in arguments if a is not type(None)), value, key)
    if origin is tuple and isinstance(value, list):
        kinds = arguments[:1] * len(value) if arguments[-1] is Ellipsis else arguments
        if len(kinds) == len(value):
            return tuple(_typed(kind, item, key) for kind, item in zip(kinds, value, strict=True))
    if origin is typing.Literal and value in arguments:
        return value
    if hint is float and type(value) is int and abs(value) <= sys.float_info.max:
        return float(value)
    if isinstance(hint, type) and type(value) is hint:
        return value
    raise UnfitConfig(f"config key {key}={repr(value)[:80]} is not {hint}")
