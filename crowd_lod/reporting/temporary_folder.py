"""A command's own folder for temporary files, Blender's too: nothing of it is left, not after
Ctrl-C either.
"""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial

from . import interrupt

PREFIX = "crowd-lod-"
VARIABLES = ("TMPDIR", "TEMP", "TMP")  # where programs look for the place of temporary files


@contextmanager
def own_temporary_folder() -> Iterator[None]:
    """Let all temporary files inside the block, of this process and those that it starts, lie in
    one folder.

    It is removed at the end. Where no folder can be made the files lie where they would.
    """
    place = tempfile.tempdir
    variables = {name: os.environ[name] for name in VARIABLES if name in os.environ}
    with ExitStack() as stack:
        with suppress(OSError), interrupt.hold():
            folder = tempfile.mkdtemp(prefix=PREFIX)
            stack.enter_context(
                interrupt.unfinished(partial(shutil.rmtree, folder, ignore_errors=True))
            )
            tempfile.tempdir = folder
            os.environ.update(dict.fromkeys(VARIABLES, folder))
        try:
            yield
        finally:
            tempfile.tempdir = place
            for name in VARIABLES:
                os.environ.pop(name, None)
            os.environ.update(variables)
