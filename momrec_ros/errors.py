"""What can be wrong with messages and bags; every message says what was expected and what came."""

from momrec_core.errors import MomrecError

__all__ = ["BagError", "CdrError", "MessageError"]


class CdrError(MomrecError):
    """Bytes that are no message of the expected type, or values that no message can hold."""


class MessageError(MomrecError):
    """A well-formed message that is no view by the rules of the inputs.

    Attributes
    ----------
    kind : str
        One word that names the rule, for counting: ``"pose"``, ``"frame"``, ``"points"``, ...
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class BagError(MomrecError):
    """A bag that cannot be read at all, or an output that must not be written."""
