"""The one error family: its message is ready for the user."""

BEGIN, END = 400, 200  # characters that are kept of a message that is longer than both


class CrowdError(Exception):
    """Input that Crowd LOD cannot work with.

    The message is one sentence that names what is wrong, where it came from and what to do. Operators report it
    and cancel, commands print it and exit with 1; whoever raises it has changed nothing. Values and names in it may be of
    any length and hold anything: it is cut in the middle, and what cannot be printed is escaped.
    """

    def __init__(self, message: str) -> None:
        if len(message) > BEGIN + END:
            message = f"{message[:BEGIN]} ... {message[-END:]}"
        super().__init__("".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in message))


FAULTS = (CrowdError, OSError, MemoryError)  # what ordinary faults of files and machines raise, anywhere


def sentence(fault: CrowdError | OSError | MemoryError) -> str:
    """What to tell the user of one of FAULTS."""
    if isinstance(fault, CrowdError):
        return str(fault)
    if isinstance(fault, MemoryError):
        return "There is not enough memory: close other programs, or take fewer agents, frames or characters."
    where = f"{fault.filename}: " if fault.filename else ""
    return str(CrowdError(f"{where}{fault.strerror or fault}: mend that, or choose another place."))
