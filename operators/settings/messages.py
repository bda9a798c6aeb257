"""Messages in words, with the labels that buttons have now."""

from collections.abc import Iterable

import bpy

from ...crowd_lod.message_words import Line, lines_of
from ...crowd_lod.messages import Message


def label_of(operator: str) -> str:
    """Return the label of an operator, such as crowd_lod.populate."""
    return getattr(bpy.ops.crowd_lod, operator.partition(".")[2]).get_rna_type().name


def in_words(messages: Iterable[Message]) -> list[Line]:
    """Return the lines that tell the messages."""
    return lines_of(messages, label_of)
