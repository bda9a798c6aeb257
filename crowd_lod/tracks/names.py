"""What the columns of a table are called, and the units in their names."""

import math
import re
from collections.abc import Container

# for each column the names that programs give it, in lower case without anything but letters and
# digits
KNOWN = {
    "id": (
        "id",
        "agent",
        "agentid",
        "person",
        "personid",
        "persid",
        "ped",
        "pedid",
        "pedestrian",
        "pedestrianid",
        "trackid",
        "track",
    ),
    "frame": ("frame", "fr", "frameid", "framenumber", "frameno", "framenr"),
    "time": ("time", "t", "seconds", "sec", "simtime", "timestamp", "timesteptime"),
    "x": (
        "x",
        "posx",
        "px",
        "xpos",
        "centerx",
        "xcenter",
        "personx",
        "positionx",
        "startx",
        "xcoord",
        "xest",
    ),
    "y": (
        "y",
        "posy",
        "py",
        "ypos",
        "centery",
        "ycenter",
        "persony",
        "positiony",
        "starty",
        "ycoord",
        "yest",
    ),
    "z": (
        "z",
        "posz",
        "pz",
        "zpos",
        "centerz",
        "zcenter",
        "personz",
        "positionz",
        "zcoord",
    ),
    "heading": ("heading", "yaw"),
    "phase": ("phase",),
    "group": ("group", "type", "agenttype", "charactergroup", "class"),
}
LENGTHS = {"m": "m", "meter": "m", "meters": "m", "metre": "m", "metres": "m"}
LENGTHS |= {
    "cm": "cm",
    "centimeter": "cm",
    "centimeters": "cm",
    "mm": "mm",
    "millimeter": "mm",
    "millimeters": "mm",
}
LENGTHS |= {
    "dm": "dm",
    "decimeter": "dm",
    "decimeters": "dm",
    "km": "km",
    "kilometer": "km",
    "kilometers": "km",
}
LENGTHS |= {"ft": "ft", "feet": "ft", "foot": "ft", "yd": "yd", "yard": "yd", "yards": "yd"}
LENGTHS |= {"in": "in", "inch": "in", "inches": "in"}
# what one is in seconds, and in radians
SECONDS = {
    "s": 1.0,
    "sec": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "min": 60.0,
    "minutes": 60.0,
    "h": 3600.0,
    "hours": 3600.0,
}
SECONDS |= {"ms": 1e-3, "millisecond": 1e-3, "milliseconds": 1e-3, "us": 1e-6, "ns": 1e-9}
RADIANS = {
    "rad": 1.0,
    "radian": 1.0,
    "radians": 1.0,
    "deg": math.pi / 180,
    "degree": math.pi / 180,
    "degrees": math.pi / 180,
}
RADIANS |= {"\N{DEGREE SIGN}": math.pi / 180}
# titles of places that are none on the ground in meters, and what to do about them
OTHER_PLACES = {
    "boxes in a picture, not places on the ground": ("xmin", "bbleft", "bbx", "left", "x1"),
    "longitude and latitude, not lengths": ("lon", "longitude", "lng", "lat", "latitude"),
    "pixels, not lengths": ("pixelx", "xpixel", "u"),
}
UNIT = re.compile(r"[\[({](?P<inside>[^\])}]*)|/(?P<after>.*)$|[\s_](?P<word>[A-Za-z]+)$")


def columns_of(titles: list[str]) -> dict[str, int]:
    """Return, for each of KNOWN that is among the titles of a table's columns, which it is.

    A title counts without what follows a bracket or slash, which is its unit, and else as a whole,
    as in P[x].
    """
    bare = [_letters(re.split(r"[/\[({]|-PID", title)[0]) for title in titles]
    whole = [_letters(title) for title in titles]
    without_word = [
        _letters(re.sub(r"(\s+in)?[\s_][A-Za-z]+$", "", title)) if _word_is_unit(title) else ""
        for title in titles
    ]
    columns: dict[str, int] = {}
    for name, known in KNOWN.items():
        for names in (bare, whole, without_word):
            place = next((names.index(title) for title in known if title in names), None)
            if place is not None:
                columns[name] = place
                break
    return columns


def _letters(title: str) -> str:
    return re.sub(r"[^a-z0-9]", "", title.lower())


def _word_is_unit(title: str) -> bool:
    word = re.split(r"[\s_]", title.strip())[-1].lower()
    return word in LENGTHS or word in SECONDS or word in RADIANS


def unit_of(title: str, units: Container[str] = LENGTHS) -> str | None:
    """Return the unit in a title such as x/cm, x [cm] or x_cm.

    units: that may be there, in lower case.
    "" if the title has none, None if it has one that is not among `units`.
    """
    match = UNIT.search(title.strip())
    if match is None:
        return ""
    word = next(group for group in match.groups() if group is not None).lower()
    words = re.findall(r"[a-z\N{DEGREE SIGN}]+", word)
    known_words = [word for word in words if word in units]
    if known_words:
        return known_words[-1]
    is_name = match["word"] is not None or word in ("x", "y", "z")
    return "" if is_name or not words else None


def notes_on_places(titles: list[str]) -> str:
    """Return what the `titles` tell of places that cannot be used, or ""."""
    names = {_letters(title) for title in titles}
    return next((told for told, known in OTHER_PLACES.items() if names & set(known)), "")
