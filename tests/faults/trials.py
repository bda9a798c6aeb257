"""A Blender that runs one command after another, each under a limit on the size of files, and says
how it went.

Reads trials as lines of JSON, {"words": [...], "limit": bytes or null}, and answers each with
{"status": ..., "said": ...}, what came on stderr. The word "operator" stands for the sidebar's
Preview: operator FILE FOLDER.
"""

import json
import os
import resource
import sys
from pathlib import Path

import bpy
import crowd_lod_extension
from crowd_lod_extension.operators.cli import commands

sys.path.append(str(Path(__file__).parents[1]))
from support.small_crowd import save_small  # noqa: E402


def operator(file: str, folder: str) -> int:
    bpy.ops.wm.open_mainfile(filepath=file)
    settings = bpy.context.scene.crowd_lod
    settings.output_folder = folder
    settings.frames = "1,9"
    settings.width = 64
    try:
        bpy.ops.crowd_lod.preview()
    except RuntimeError as error:
        print(str(error).strip(), file=sys.stderr)
        return 1
    return 0


def trial(words: list[str], limit: int | None) -> dict:
    reading, writing = os.pipe()
    kept = [os.dup(1), os.dup(2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(writing, 2)
    os.close(writing)
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (hard if limit is None else limit, hard))
    try:
        status = (
            operator(*words[1:])
            if words[0] == "operator"
            else commands.run_command(words, "crowd-lod")
        )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
        sys.stderr.flush()
        for number, copy in enumerate(kept, start=1):
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)
    with open(reading, "rb") as said:
        return {"status": status, "said": said.read().decode()}


if __name__ == "__main__":
    crowd_lod_extension.register()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # Blender's own lines
    if not Path(sys.argv[1]).exists():
        save_small(sys.argv[1])
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(trial(**json.loads(line))), file=answers, flush=True)
