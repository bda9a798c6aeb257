"""Work in processes of their own: what starts one, and what answers in it."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from crowd_lod_extension.operators.blender import console


def job(limit: float, script: str = "ways.py", **inputs) -> dict:
    """What a process of `script` prints as JSON, or {"ended": why}."""
    command = [sys.executable, str(Path(__file__).with_name(script)), json.dumps(inputs)]
    try:
        process = subprocess.run(command, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return {"ended": f"not done in {limit:g} s"}
    lines = process.stdout.strip().splitlines()
    if not lines or not lines[-1].startswith("{"):
        last = process.stderr.strip().rpartition("\n")[2]
        return {
            "ended": f"exit status {process.returncode}: {last or 'no message; out of memory?'}"
        }
    return json.loads(lines[-1])


def answer(*works: Callable[..., dict]) -> None:
    """Do the work, of several, that `job` asks this process for by name; print its result."""
    inputs = json.loads(sys.argv[1])
    asked = inputs.pop("job")
    work = next(work for work in works if work.__name__ == asked)
    with console.quiet():
        result = work(**inputs)
    print(json.dumps(result), flush=True)
