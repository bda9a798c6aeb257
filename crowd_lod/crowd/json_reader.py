"""Checked reading of JSON that people write: whatever is wrong is named with its line and its field."""

import json
import math
from json.decoder import scanstring  # type: ignore[attr-defined]  # typeshed leaves it out
from typing import Any, NoReturn

from ..errors import CrowdError

FieldPath = tuple[str | int, ...]  # of a field: the keys and places that lead to it
Colour = tuple[int, int, int]  # sRGB, 0 to 255


class Reader:
    """Checks one field of the JSON `text` at a time. A field is named by its path."""

    def __init__(self, text: str, what: str) -> None:
        self.text, self.what = text, what
        try:
            self.root = json.loads(text, parse_int=_whole)
            self.places, twice, halves = _places(text)
        except json.JSONDecodeError as error:
            raise CrowdError(f"{what} is not JSON: line {error.lineno}, column {error.colno}: {error.msg}.") from None
        except RecursionError:
            raise CrowdError(f"{what} is nested too deep to be read: it needs no more than six levels.") from None
        if twice:
            self.fail(twice[0], "stands twice in its object; keep one")
        if halves:
            self.fail(halves[0], "holds half of a character, an escape from \\ud800 to \\udfff without its other half; write both")

    def fail(self, path: FieldPath, problem: str) -> NoReturn:
        """Raise the CrowdError that `problem` is what is wrong with the field; the line is that of its nearest parent
        if the field is missing."""
        place = next(self.places[path[:n]] for n in range(len(path), -1, -1) if path[:n] in self.places)
        line = self.text.count("\n", 0, place) + 1
        raise CrowdError(f"{self.what}, line {line}: {'.'.join(map(str, path)) or 'the file'} {problem}.")

    def table(self, value: object, path: FieldPath, allowed: set[str] | None = None, filled: bool = False) -> dict[str, Any]:
        if not isinstance(value, dict):
            self.fail(path, "must be an object, { ... }" + ("" if value is not None else "; it is missing"))
        if filled and not 0 < len(value) <= 255:
            self.fail(path, f"must hold 1 to 255 entries, it holds {len(value)}")
        if allowed is not None and (unknown := [key for key in value if key not in allowed]):
            self.fail((*path, unknown[0]), f"is not known here; known are {', '.join(sorted(allowed))}")
        return value

    def number(self, value: object, path: FieldPath, least: float = -math.inf) -> float:
        try:
            if isinstance(value, bool) or not isinstance(value, int | float) or not least <= float(value) < math.inf:
                raise ValueError
            return float(value)
        except (ValueError, OverflowError):
            bound = f" of at least {least:g}" if least > -math.inf else ""
            self.fail(path, f"is {value!r}, it must be a finite number{bound}")

    def boolean(self, value: object, path: FieldPath) -> bool:
        if not isinstance(value, bool):
            self.fail(path, f"is {value!r}, it must be true or false")
        return value

    def string(self, value: object, path: FieldPath) -> str:
        if not isinstance(value, str):
            self.fail(path, f"is {value!r}, it must be a text in quotes")
        return value

    def colour(self, value: object, path: FieldPath) -> Colour:
        try:
            if not (isinstance(value, str) and len(value) == 7 and value[0] == "#" and value[1:].isalnum()):
                raise ValueError
            red, green, blue = bytes.fromhex(value[1:])
            return red, green, blue
        except ValueError:
            self.fail(path, f'is {value!r}, it must be a color such as "#ff8000"')


def _whole(digits: str) -> int | float:
    """The number that the digits write; Python reads no more than some thousands of them as a whole one."""
    return int(digits) if len(digits) < 400 else float(digits)


def _torn(value: object) -> bool:
    """Whether it is a text with a lone surrogate, which no file and no window can show."""
    return isinstance(value, str) and any("\ud800" <= each <= "\udfff" for each in value)


def _places(text: str) -> tuple[dict[FieldPath, int], list[FieldPath], list[FieldPath]]:
    """(where each field of the sound JSON `text` begins, its key if it has one; the fields that stand twice; those of which
    the key or the text holds a lone surrogate)."""
    places: dict[FieldPath, int] = {}
    twice: list[FieldPath] = []
    halves: list[FieldPath] = []
    decoder = json.JSONDecoder(parse_int=_whole)

    def skip(i: int) -> int:
        while text[i] in " \t\r\n":
            i += 1
        return i

    def field(i: int, path: FieldPath, begins: int) -> int:
        """Note the field whose value is at i; the index behind it."""
        if path in places:
            twice.append(path)
        places[path] = begins
        opening = text[i]
        value, end = (None, i) if opening in "{[" else decoder.raw_decode(text, i)
        if any(map(_torn, (*path[-1:], value))):
            halves.append(path)
        if end > i:
            return end
        i, place = skip(i + 1), 0
        while text[i] not in "}]":
            begins, key = i, place
            if opening == "{":
                key, i = scanstring(text, i + 1)
                i = skip(skip(i) + 1)
            i, place = skip(field(i, (*path, key), begins)), place + 1
            if text[i] == ",":
                i = skip(i + 1)
        return i + 1

    first = skip(0)
    field(first, (), first)
    return places, twice, halves
