"""How a table of text is laid out: its titles, units, rate, and where its rows begin."""

import csv
import math
import re
from collections.abc import Container, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from ..errors import CrowdError

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


LONGEST_LINE = 2**20  # bytes
RATE = re.compile(r"(?:frame\s*rate|fps)\s*[:=]?\s*([0-9]+(?:[.,][0-9]+)?)", re.IGNORECASE)
IN = re.compile(r"\bin\s+(\w+)", re.IGNORECASE)
NUMBER = re.compile(r"[-+]?[0-9.,]+(?:[eE][-+]?[0-9]+)?|[-+]?nan|[-+]?inf")
COMMENTS = ("#", "%", "//", "*")
TEXTS = ("id", "group")  # columns that may have texts
ENDS = {"time": "endtime", "x": "endx", "y": "endy"}  # of Vadere's steps


@dataclass(frozen=True)
class Table:
    """How a table of text is laid out.

    begins: bytes before its first row.
    split: between two values; None for any white space.
    width: how many values a row has.
    columns: for each name in names.KNOWN its place.
    factors: for time and heading, what one is in seconds and radians, where titles tell it.
    rate, unit: as in Rows.
    numeric: whether all values of the first row are numbers.
    texts: columns that are read as texts.
    """

    begins: int
    split: str | None
    width: int
    columns: dict[str, int]
    factors: dict[str, float]
    rate: float
    unit: str
    numeric: bool
    texts: tuple[str, ...]


def long_line(where: str) -> CrowdError:
    """Return the error of a file with a line longer than LONGEST_LINE."""
    return CrowdError(
        f"The file {where} has a line of more than {LONGEST_LINE:,} bytes: give each row a line "
        f"of its own."
    )


def _lines(data: bytearray, where: str) -> Iterator[bytearray]:
    at = 0
    while at < len(data):
        end = data.find(b"\n", at, at + LONGEST_LINE) + 1
        if not end and len(data) - at > LONGEST_LINE:
            raise long_line(where)
        end = end or len(data)
        if b"\0" in data[at:end]:
            raise CrowdError(
                f"The file {where} is neither text nor NPZ nor a database: choose a file of "
                f"trajectories."
            )
        yield data[at:end]
        at = end


class _Head(NamedTuple):
    """The beginning of a table.

    begins: bytes before the first row of values.
    row: the first row of values; "" if there is none.
    titles: those asked for, else those of the table; none if it has none.
    """

    begins: int
    row: str
    titles: list[str]
    comments: list[str]


def _head_of(data: bytearray, where: str, asked: list[str]) -> _Head:
    at = 0
    row = ""
    comments: list[str] = []
    titles = asked
    for raw in _lines(data, where):
        text = raw.decode("utf-8", "replace").strip()
        if not text or text.startswith(COMMENTS):
            words = _split_titles(re.sub(r"^[#%/*\s]+", "", text))
            comments.append(text)
            if (
                not asked
                and {"id", "x", "y"} <= (known := columns_of(words)).keys()
                and ("frame" in known or "time" in known)
            ):
                titles = words
        elif _numeric(text) or (titles and _numeric_places(text, titles)):
            row = text
            break
        elif not titles:
            titles = _split_titles(text)
            if not {"x", "y"} <= columns_of(titles).keys():
                break
        elif not asked:  # a row of units below the titles
            titles = [
                f"{title}/{unit}"
                for title, unit in zip(titles, [*_split(text), *[""] * len(titles)], strict=False)
            ]
        at += len(raw)
    return _Head(at, row, titles, comments)


def layout_of(data: bytearray, where: str, columns_asked: str = "") -> Table:
    """Return the layout of the table `data`; CrowdError if it lacks a column.

    where: the file, for messages.
    columns_asked: titles of its columns, whatever the table tells; "" for its own.
    """
    asked = _asked(columns_asked, where)
    begins, row, titles, comments = _head_of(data, where, asked)
    columns = columns_of(titles)
    values = _split(row) if row else []
    _check_titles(titles, columns, row, where, bool(asked))
    bare = [re.sub(r"[^a-z]", "", title.split("-")[0].lower()) for title in titles]
    columns = {name: place for name, place in columns.items() if place < len(values)}
    if "time" in columns and set(ENDS.values()) <= set(bare[: len(values)]):
        columns |= {name: bare.index(name) for name in ENDS.values()}
    factors = {}
    for name, units in (("time", SECONDS), ("heading", RADIANS)):
        if name in columns and (unit := unit_of(titles[columns[name]], units)):
            factors[name] = units[unit]
    rates = [match[1] for text in comments if (match := RATE.search(text))]
    lengths = [
        _unit(titles, columns, where),
        *(LENGTHS.get(match[1].lower(), "") for text in comments for match in IN.finditer(text)),
    ]
    texts = tuple(
        name
        for name in TEXTS
        if name in columns and (name == "group" or not _is_number(values[columns[name]]))
    )
    return Table(
        begins=begins,
        split=_splitter(row),
        width=len(values),
        columns=columns,
        factors=factors,
        rate=float(rates[-1].replace(",", ".")) if rates else 0.0,
        unit=next(filter(None, lengths), ""),
        numeric=all(map(_is_number, values)),
        texts=texts,
    )


def _asked(columns_asked: str, where: str) -> list[str]:
    """Return the titles in the setting Columns; CrowdError if one that a table needs lacks."""
    titles = _split_titles(columns_asked) if columns_asked.strip() else []
    if titles and (lacks := _lacks(columns_of(titles))):
        raise CrowdError(
            f"Columns names {', '.join(titles[:12])}, and none for {', '.join(lacks)}: name id, "
            f"frame (or time, in seconds), x and y of the table {where}."
        )
    return titles


def _lacks(columns: dict[str, int]) -> list[str]:
    """Return the columns that a table needs and that are not among `columns`."""
    return [
        name
        for name in ("id", "frame", "x", "y")
        if name not in columns and not (name == "frame" and "time" in columns)
    ]


def _check_titles(
    titles: list[str], columns: dict[str, int], row: str, where: str, asked: bool
) -> None:
    """Raise CrowdError if a table with such titles and such a first row cannot be read.

    asked: whether the titles are those of the setting Columns.
    """
    lacks = _lacks(columns)
    if titles and lacks:
        kinds = notes_on_places(titles) if "x" in lacks or "y" in lacks else ""
        request = f"These are {kinds}; give it" if kinds else "give it"
        raise CrowdError(
            f"The table {where} has the columns {', '.join(titles[:12])}, and none for "
            f"{', '.join(lacks)}: {request} columns id, frame "
            "(or time, in seconds), x and y."
        )
    if not row:
        raise CrowdError(f"The file {where} has no rows: choose a file of trajectories.")
    if not titles:
        begin = row.expandtabs(2)[:60]
        raise CrowdError(
            f'The table {where} has no titles and begins with "{begin}": set Columns to what its '
            f"columns are, such as frame,id,x,y."
        )
    values = _split(row)
    if max(columns[name] for name in columns.keys() & {"id", "frame", "time", "x", "y"}) >= len(
        values
    ):
        raise CrowdError(
            f"The table {where} has {len(titles)} titles{' by Columns' if asked else ''} "
            f"({', '.join(titles[:12])}) and {len(values)} values in its first row: "
            "give each column one title."
        )
    for name, units in (("time", SECONDS), ("heading", RADIANS)):
        if name in columns and unit_of(titles[columns[name]], units) is None:
            raise CrowdError(
                f"The table {where} has the column {titles[columns[name]]}: give {name} in one of "
                f"{', '.join(units)}."
            )


def _unit(titles: list[str], columns: dict[str, int], where: str) -> str:
    """Return the unit in the titles of places, or ""; CrowdError if several or an unknown one."""
    units = {axis: unit_of(titles[columns[axis]]) for axis in "xyz" if axis in columns}
    for axis, unit in units.items():
        if unit is None:
            raise CrowdError(
                f"The table {where} has the column {titles[columns[axis]]}: give places in one of "
                f"{', '.join(dict.fromkeys(LENGTHS.values()))}."
            )
    known_units = {axis: LENGTHS[unit] for axis, unit in units.items() if unit}
    if len(set(known_units.values())) > 1:
        listed = " and ".join(f"{axis} in {unit}" for axis, unit in known_units.items())
        raise CrowdError(f"The table {where} has {listed}: give all places in one unit.")
    return next(iter(known_units.values()), "")


def _splitter(row: str) -> str | None:
    """Return the separator of a row's values; None for white space."""
    if ";" in row:
        return ";"
    if "\t" in row:
        return "\t"
    return "," if "," in row else None


def _split(row: str) -> list[str]:
    """Return the values of a row."""
    split = _splitter(row)
    return [value.strip() for value in split_row(row, split)]


def split_row(row: str, split: str | None) -> list[str]:
    if split is None:
        return row.split()
    try:
        return next(csv.reader([row], delimiter=split), [])
    except csv.Error:  # a value longer than csv reads
        return row.split(split)


def _split_titles(row: str) -> list[str]:
    """Return the titles of a row: a unit in brackets belongs to the title before it."""
    return _split(row if _splitter(row) else re.sub(r"\s+([\[({])", r"\1", row))


def _is_number(value: str) -> bool:
    return NUMBER.fullmatch(value) is not None


def _numeric(row: str) -> bool:
    """Return whether a row is one of numbers: at least its first three values that are told are."""
    values = [value for value in _split(row) if value]
    return sum(map(_is_number, values)) >= min(3, max(len(values), 1))


def _numeric_places(row: str, titles: list[str]) -> bool:
    """Return whether the row has numbers where the titles have places, as beside ids that are
    texts.
    """
    columns = columns_of(titles)
    values = _split(row)
    return all(columns[axis] < len(values) and _is_number(values[columns[axis]]) for axis in "xy")
