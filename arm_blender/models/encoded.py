"""What every shape or material network leaves of the views."""

from dataclasses import dataclass, fields, replace
from typing import Self

from torch import Tensor


@dataclass(frozen=True)
class Encoded:
    """What points are decoded from: the tensors among its fields, and what else is known of the views."""

    def _tensors(self) -> dict[str, Tensor]:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, Tensor)}

    @property
    def is_finite(self) -> bool:
        """Whether all of it are numbers."""
        return all(bool(x.isfinite().all()) for x in self._tensors().values())

    def float(self) -> Self:
        """The same in float32: what an encoding under autocast is decoded from."""
        return replace(self, **{name: x.float() for name, x in self._tensors().items()})
