"""Where results go."""

import os
from pathlib import Path

from .errors import CrowdError

LONGEST_NAME, LONGEST_PATH = 240, 900  # bytes; files are written beside and below it, and Blender's paths end at 1,023


def output(path: Path) -> Path:
    """The path of a file or folder to be written, absolute; CrowdError if it cannot be, before any work is done for it."""
    try:
        path = path.absolute()
    except OSError:
        raise CrowdError("The current folder is gone: change to another, or give the whole path of one with --out.") from None
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise CrowdError(f"The output's path {path} holds bytes that are no text: rename that folder, or choose another.") from None
    for part, length, most in (("name", len(os.fsencode(path.name)), LONGEST_NAME), ("path", len(os.fsencode(path)), LONGEST_PATH)):
        if length > most:
            raise CrowdError(f"The {part} of the output {path} is {length:,} bytes long: choose one of at most {most} bytes.")
    return path
