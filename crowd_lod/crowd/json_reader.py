"""Checked reading of hand-written JSON: an error names its line and its field."""

import json
import math
from json.decoder import scanstring  # type: ignore[attr-defined]  # typeshed leaves it out
from typing import Any, NoReturn

from ..errors import CrowdError

FieldPath = tuple[str | int, ...]  # of a field: the keys and places that lead to it
Color = tuple[int, int, int]  # sRGB, 0 to 255


class FieldError(CrowdError):
    """What is wrong with the field at `path`."""

    def __init__(self, message: str, path: FieldPath) -> None:
        super().__init__(message)
        self.path = path


class Reader:
    """Checks one field of the JSON `text` at a time. A field is named by its path."""

    def __init__(self, text: str, title: str) -> None:
        self.text = text
        self.title = title
        try:
            self.root = json.loads(text, parse_int=_whole)
            self._begins, twice, halves = _begins(text)
        except json.JSONDecodeError as error:
            raise CrowdError(
                f"{title} is not JSON: line {error.lineno}, column {error.colno}: {error.msg}."
            ) from None
        except RecursionError:
            raise CrowdError(
                f"{title} is nested too deep to be read: it needs no more than six levels."
            ) from None
        if twice:
            self.fail(twice[0], "is given twice in its object; keep one")
        if halves:
            self.fail(
                halves[0],
                "holds half of a character, an escape from \\ud800 to \\udfff without its other "
                "half; write both",
            )

    def fail(self, path: FieldPath, problem: str) -> NoReturn:
        """Raise a FieldError that says what `problem` the field at `path` has.

        Its line is the field's, or that of the nearest parent if the field is missing.
        """
        begin = next(
            self._begins[path[:n]] for n in range(len(path), -1, -1) if path[:n] in self._begins
        )
        line = self.text.count("\n", 0, begin) + 1
        raise FieldError(
            f"{self.title}, line {line}: {'.'.join(map(str, path)) or 'the file'} {problem}.", path
        )

    def table(
        self, value: object, path: FieldPath, allowed: set[str] | None = None, filled: bool = False
    ) -> dict[str, Any]:
        if not isinstance(value, dict):
            self.fail(
                path,
                "must be an object, { ... }" + ("" if value is not None else "; it is missing"),
            )
        if filled and not 0 < len(value) <= 255:
            self.fail(path, f"must hold 1 to 255 entries, it holds {len(value)}")
        if allowed is not None and (unknown := [key for key in value if key not in allowed]):
            self.fail(
                (*path, unknown[0]), f"is not known here; known are {', '.join(sorted(allowed))}"
            )
        return value

    def number(self, value: object, path: FieldPath, least: float = -math.inf) -> float:
        try:
            if (
                isinstance(value, bool)
                or not isinstance(value, int | float)
                or not (math.isfinite(value) and least <= value)
            ):
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

    def color(self, value: object, path: FieldPath) -> Color:
        try:
            if not (
                isinstance(value, str)
                and len(value) == 7
                and value[0] == "#"
                and value[1:].isalnum()
            ):
                raise ValueError
            red, green, blue = bytes.fromhex(value[1:])
            return red, green, blue
        except ValueError:
            self.fail(path, f'is {value!r}, it must be a color such as "#ff8000"')


def _whole(digits: str) -> int | float:
    """Return the int that `digits` write, or a float from 400 digits on.

    Python does not read an int of more than some thousands of digits.
    """
    return int(digits) if len(digits) < 400 else float(digits)


def _torn(value: object) -> bool:
    """Return whether `value` is a text with a lone surrogate, which nothing can show."""
    return isinstance(value, str) and any("\ud800" <= letter <= "\udfff" for letter in value)


def _begins(text: str) -> tuple[dict[FieldPath, int], list[FieldPath], list[FieldPath]]:
    """Return where fields begin, which stand twice, which hold a lone surrogate.

    text: valid JSON. A field begins at its key, if it has one. A surrogate counts in a field's key
        or its text.
    """
    begins: dict[FieldPath, int] = {}
    twice: list[FieldPath] = []
    halves: list[FieldPath] = []
    decoder = json.JSONDecoder(parse_int=_whole)

    def skip(i: int) -> int:
        while text[i] in " \t\r\n":
            i += 1
        return i

    def field(i: int, path: FieldPath, begin: int) -> int:
        """Record the field whose value begins at i, and return the index after it."""
        if path in begins:
            twice.append(path)
        begins[path] = begin
        opening = text[i]
        value, end = (None, i) if opening in "{[" else decoder.raw_decode(text, i)
        if any(map(_torn, (*path[-1:], value))):
            halves.append(path)
        if end > i:
            return end
        i = skip(i + 1)
        place = 0
        while text[i] not in "}]":
            begin = i
            key: str | int = place
            if opening == "{":
                key, i = scanstring(text, i + 1)
                i = skip(skip(i) + 1)
            i = skip(field(i, (*path, key), begin))
            place += 1
            if text[i] == ",":
                i = skip(i + 1)
        return i + 1

    first = skip(0)
    field(first, (), first)
    return begins, twice, halves
