"""Messages to the user as values: what is told, of whom, with which numbers, and what mends it.

message_words.py makes sentences of them, where they are drawn or printed.
"""

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from enum import StrEnum, auto
from typing import Any


class MessageKind(StrEnum):
    """What a message tells."""

    # of agents that a state machine moves
    OFF_COLOR = auto()
    CHATTERS = auto()
    STUCK = auto()
    CHECKED_IN_PART = auto()
    # of characters
    BESIDE_OFFSET = auto()
    RAISED = auto()
    OFF_ITS_SOLES = auto()
    UNKNOWN_EXTENT = auto()
    HEIGHT = auto()
    STILL_POSES = auto()
    BY_TIME = auto()
    HANGS_OUTSIDE = auto()
    WITHOUT_FACES = auto()
    UNSAVED = auto()
    ROOT_MOTION = auto()
    NO_STRIDE = auto()
    FEET_SLIDE = auto()
    NO_WALK = auto()
    GLIDES = auto()
    GLOWS = auto()
    IMAGE_MISSING = auto()
    # of a crowd in its scene
    SPEED = auto()
    CLIMBS = auto()
    OFF_THE_GROUND = auto()
    OBSTACLE = auto()
    WITHIN_WALLS = auto()
    NO_TERRAIN = auto()
    TERRAIN_OF_CHARACTERS = auto()
    TERRAIN_MOVES = auto()
    PLACES_OUTSIDE = auto()
    PLACES_ON_LABELS = auto()
    # of LODs that were not made
    SAVES_LITTLE = auto()
    BESIDE_GIVEN = auto()
    DEVIATES_AS_MUCH = auto()
    NEVER_ALIKE = auto()
    TOO_COARSE = auto()
    TOO_FINE = auto()
    BEGINS_TOO_FAR = auto()
    ENDS_TOO_NEAR = auto()
    TOO_FEW = auto()
    NOT_WORTH_IT = auto()


@dataclass(frozen=True)
class Message:
    """What the user is to know of one subject.

    subject: the name of a character group or an object; "" where it is of a whole crowd.
    facts: the numbers and names in it; lengths in meters. WORDS of message_words.py say which.
    remedy: bl_idname of the operator that mends it; "" if a setting or the user's own work does.
    crowd: the name of the crowd, where there are several; "" if it is of all.
    """

    kind: MessageKind
    subject: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)
    remedy: str = ""
    crowd: str = ""


def to_json(messages: Iterable[Message]) -> str:
    return json.dumps([asdict(message) for message in messages])


def from_json(text: str) -> tuple[Message, ...]:
    """Return the messages that `to_json` has written; none from any other text."""
    with suppress(ValueError, TypeError, LookupError):  # a script may have put anything there
        return tuple(
            Message(**row | {"kind": MessageKind(row["kind"])}) for row in json.loads(text)
        )
    return ()
