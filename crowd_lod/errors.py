"""The one error family: its message is ready for the user."""


class CrowdError(Exception):
    """Input that Crowd LOD cannot work with.

    The message is one sentence that names what is wrong, where it came from and what to do. Operators report it
    and cancel, commands print it and exit with 1; whoever raises it has changed nothing.
    """
