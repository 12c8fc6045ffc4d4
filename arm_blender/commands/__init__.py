"""The commands of the command line. Importing them imports nothing heavy; each does so when it runs."""

from ..errors import ArmError


class UsageError(ArmError):
    """The words on the command line do not make sense: status 2."""
