"""What the columns of a table are called, and the units in their names."""

import re

# for each column the names that programs give it, in lower case without anything but letters and digits
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
        "no",
        "trackid",
        "track",
    ),
    "frame": ("frame", "fr", "frameid", "framenumber", "frameno", "framenr"),
    "time": ("time", "t", "seconds", "sec", "simtime", "simsec", "timestamp"),
    "x": ("x", "posx", "px", "xpos", "centerx", "coordcentx", "positionx", "startx", "xcoord"),
    "y": ("y", "posy", "py", "ypos", "centery", "coordcenty", "positiony", "starty", "ycoord"),
    "z": ("z", "posz", "pz", "zpos", "centerz", "coordcentz", "positionz", "zcoord"),
    "heading": ("heading", "yaw"),
    "phase": ("phase",),
    "group": ("group", "type", "agenttype", "charactergroup", "class"),
}
WORDS = {"m": "m", "meter": "m", "meters": "m", "metre": "m", "metres": "m", "cm": "cm", "centimeter": "cm", "centimeters": "cm"}
WORDS |= {"mm": "mm", "millimeter": "mm", "millimeters": "mm", "ft": "ft", "feet": "ft", "foot": "ft"}


def columns_of(titles: list[str]) -> dict[str, int]:
    """Return, for each of KNOWN that is among the titles of a table's columns, which it is."""
    found: dict[str, int] = {}
    bare = [re.sub(r"[^a-z0-9]", "", re.split(r"[/\[({]|-PID", title)[0].lower()) for title in titles]
    for name, known in KNOWN.items():
        for own in known:
            if own in bare:
                found[name] = bare.index(own)
                break
    return found


def unit_of(title: str) -> str:
    """Return the unit in a title such as x/cm, x [cm] or x_cm, one of UNITS, or "" if there is none."""
    words = re.split(r"[^a-z]+", title.lower())
    return next((WORDS[word] for word in words[1:] if word in WORDS), "")
