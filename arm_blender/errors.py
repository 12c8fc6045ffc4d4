"""The errors that a user can meet: one readable line that names what is wrong, where, and the remedy.

Programs catch `ArmError` only. Anything else is a bug and keeps its traceback.
"""


class ArmError(Exception):
    """Base of every error that a user can do something about."""

    def __str__(self) -> str:
        """One line that any stream takes, whatever a file's name or another program's message brought into it."""
        return " ".join(super().__str__().splitlines()).encode("utf-8", "backslashreplace").decode()


class InputImageError(ArmError):
    """An image is missing, unreadable, empty, or does not fit the others."""


class CameraError(ArmError):
    """A camera file is malformed, or a camera cannot see the object."""


class CheckpointError(ArmError):
    """Weights are missing, damaged, or made for another model."""


class DownloadError(ArmError):
    """A published file cannot be had, or is not what was published."""


class EmptyMeshError(ArmError):
    """The density has no surface inside the box."""


class UnwrapError(ArmError):
    """No valid UV atlas could be made."""


class OutputError(ArmError):
    """A result cannot be written."""


class OutOfMemory(ArmError):
    """The memory of the machine or of its device does not suffice."""


class Cancelled(ArmError):
    """The user stopped the run; nothing was written."""
