"""Changes of a JSON text that leave the rest of it as it is, to the letter.

Each function takes a valid JSON text and returns the changed one. Fields are named by their paths,
as in json_reader. What is new takes over the line breaks of what stands beside it.
"""

import json
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Any

from .json_reader import FieldPath, Place, Reader

Splice = tuple[int, int, str]  # from, to, what stands there then


def dumped(value: object) -> str:
    """Return `value` as JSON in one line."""
    return json.dumps(value, ensure_ascii=False)


def put(text: str, path: FieldPath, value: object, order: Sequence[str] = ()) -> str:
    """Return the text with `value` at `path`, whose parent is there.

    order: the usual order of the parent's keys; a new field stands after those before it, or else
        last.
    """
    return put_source(text, path, dumped(value), order)


def put_source(text: str, path: FieldPath, source: str, order: Sequence[str] = ()) -> str:
    """As `put`, with the value as JSON."""
    places = _places(text)
    if path in places:
        return spliced(text, [(*places[path][1:], source)])
    parent, key = path[:-1], path[-1]
    beside = _fields(places, parent)
    before = [each for each in beside if key not in order or each[-1] in order[: order.index(str(key))]]
    new = f"{dumped(key)}: {source}"
    if before:
        last = places[before[-1]]
        return spliced(text, [(last.end, last.end, f",{_gap(text, last.begin) or ' '}{new}")])
    start = places[parent].value + 1
    if beside:
        first = places[beside[0]].begin
        return spliced(text, [(first, first, f"{new},{_gap(text, first) or ' '}")])
    return spliced(text, [(start, places[parent].end - 1, new)])


def without(text: str, path: FieldPath) -> str:
    """Return the text without the field at `path`."""
    places = _places(text)
    beside = _fields(places, path[:-1])
    n = beside.index(path)
    if n:
        return spliced(text, [(places[beside[n - 1]].end, places[path].end, "")])
    if len(beside) > 1:
        return spliced(text, [(places[path].begin, places[beside[1]].begin, "")])
    parent = places[path[:-1]]
    return spliced(text, [(parent.value + 1, parent.end - 1, "")])


def moved(text: str, path: FieldPath, by: int) -> str:
    """Return the text with the field at `path` so many places down, or up where negative."""
    places = _places(text)
    beside = _fields(places, path[:-1])
    n = beside.index(path)
    order = [*beside[:n], *beside[n + 1 :]]
    order.insert(min(max(n + by, 0), len(order)), path)
    return spliced(text, [(places[a].begin, places[a].end, _source(text, places[b])) for a, b in zip(beside, order, strict=True)])


def copied(text: str, path: FieldPath, key: str) -> str:
    """Return the text with a copy of the field at `path` after it, called `key`."""
    place = _places(text)[path]
    new = f"{dumped(key)}: {text[place.value : place.end]}"
    return spliced(text, [(place.end, place.end, f",{_gap(text, place.begin) or ' '}{new}")])


def keys_renamed(text: str, paths: Iterable[FieldPath], key: str) -> list[Splice]:
    """Return the splices that call the fields at `paths` by another key."""
    places = _places(text)
    return [(place.begin, _key_end(text, place), dumped(key)) for place in (places[path] for path in paths)]


def values_replaced(text: str, paths: Iterable[FieldPath], value: object) -> list[Splice]:
    """Return the splices that put `value` at `paths`, which are there."""
    places = _places(text)
    return [(*places[path][1:], dumped(value)) for path in paths]


def found(text: str, wanted: Callable[[FieldPath, Any], bool]) -> list[FieldPath]:
    """Return the paths of all fields of which wanted(path, value) is true."""
    reader = _read(text)

    def value(path: FieldPath) -> Any:
        held: Any = reader.root
        for key in path:
            held = held[key]
        return held

    return [path for path in reader.places if wanted(path, value(path))]


def spliced(text: str, splices: Iterable[Splice]) -> str:
    """Return the text with these parts replaced; they do not overlap."""
    for begin, end, new in sorted(splices, reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def indent_of(text: str, path: FieldPath) -> str:
    """Return the white space before the first field of the object at `path`, or before its end."""
    places = _places(text)
    inside = _fields(places, path)
    return _gap(text, places[inside[0]].begin if inside else places[path].end - 1)


@lru_cache(maxsize=4)
def _read(text: str) -> Reader:
    return Reader(text, "The text")


def _places(text: str) -> dict[FieldPath, Place]:
    return _read(text).places


def _fields(places: dict[FieldPath, Place], parent: FieldPath) -> list[FieldPath]:
    """Return the paths of the fields of an object or array, in their order."""
    return [path for path in places if len(path) == len(parent) + 1 and path[:-1] == parent]


def _gap(text: str, begin: int) -> str:
    """Return the white space before a place of the text."""
    start = begin
    while start and text[start - 1] in " \t\r\n":
        start -= 1
    return text[start:begin]


def _source(text: str, place: Place) -> str:
    return text[place.begin : place.end]


def _key_end(text: str, place: Place) -> int:
    end = place.begin + 1
    while text[end] != '"':
        end += 2 if text[end] == "\\" else 1
    return end + 1
