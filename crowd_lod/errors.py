"""The errors that users see, with messages that are ready to show."""

# characters that are kept of a message that is longer than both
BEGIN = 400
END = 200


class CrowdError(Exception):
    """Input that Crowd LOD cannot work with.

    The message is one sentence. It names what is wrong, where it came from and what to do.
    Operators report it and cancel; commands print it and exit with 1. Code that raises it has
    changed nothing.
    Values and names in the message may have any length and content. A message longer than BEGIN +
    END characters is cut in the middle; characters that cannot be printed are escaped.
    """

    def __init__(self, message: str) -> None:
        if len(message) > BEGIN + END:
            message = f"{message[:BEGIN]} ... {message[-END:]}"
        super().__init__(
            "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in message)
        )


# what ordinary faults of files and machines raise, anywhere
FAULTS = (CrowdError, OSError, MemoryError)


def sentence(fault: CrowdError | OSError | MemoryError) -> str:
    """Return the message for the user about `fault`, one of FAULTS."""
    if isinstance(fault, CrowdError):
        return str(fault)
    if isinstance(fault, MemoryError):
        return (
            "There is not enough memory: close other programs, or take fewer agents, frames or "
            "characters."
        )
    where = f"{fault.filename}: " if fault.filename else ""
    return str(CrowdError(f"{where}{fault.strerror or fault}: mend that, or choose another place."))
