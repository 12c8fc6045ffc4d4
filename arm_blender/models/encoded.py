"""What every shape or material network leaves of the views, as far as the pipeline looks at it."""

from typing import Protocol, Self


class Encoded(Protocol):
    """What points are decoded from."""

    @property
    def is_finite(self) -> bool:
        """Whether all of it are numbers."""
        ...

    def float(self) -> Self:
        """The same in float32: what an encoding under autocast is decoded from."""
        ...
