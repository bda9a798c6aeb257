"""What a run leaves, without what differs from run to run."""

import csv
import json

from crowd_lod_extension.operators.blender import image_data

TIMES = ("ms", "seconds", "why", "command")


def contents(folder):
    """All that a run leaves, without times: tables, JSON, and the pixels of pictures."""
    found = {}
    for path in sorted(folder.iterdir()):
        if path.suffix == ".csv":
            rows = list(csv.DictReader(path.open()))
            found[path.name] = [
                {name: value for name, value in row.items() if not name.endswith("_ms")}
                for row in rows
            ]
        elif path.suffix == ".json":
            found[path.name] = timeless(json.loads(path.read_text()))
        else:
            found[path.name] = (
                image_data.load_pixels(path).tobytes() if path.suffix == ".png" else None
            )
    return found


def timeless(told):
    if isinstance(told, dict):
        return {
            name: timeless(value)
            for name, value in told.items()
            if not (name in TIMES or name.endswith("_ms"))
        }
    return [timeless(each) for each in told] if isinstance(told, list) else told
