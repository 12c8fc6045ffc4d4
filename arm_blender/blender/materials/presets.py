"""The finishes that have a name, as the panel calls them."""

from ...knobs.finishes import PRESETS, Finish, name_of


def items() -> list[tuple[str, str, str]]:
    """The presets as an enumeration's items."""
    return [(name, _title(name), _tip(finish)) for name, finish in PRESETS.items()]


def title_of(finish: Finish | None) -> str:
    """What a region is set to."""
    if finish is None:
        return "Predicted"
    name = name_of(finish)
    return _title(name) if name in PRESETS else "Custom"


def _title(name: str) -> str:
    return name.replace("-", " ").title()


def _tip(finish: Finish) -> str:
    color = "no metal; the color stays" if finish.f0 is None else "metal, in a color of its own"
    return f"Roughness {finish.roughness:g}, {color}"
