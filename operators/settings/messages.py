"""What Populate found that may be wrong: messages, kept with the scene, and their lines."""

from collections.abc import Iterable

import bpy

from ...crowd_lod.message_words import Line, lines_of
from ...crowd_lod.messages import Message, from_json, to_json


def label_of(operator: str) -> str:
    """Return the label of an operator, such as crowd_lod.populate."""
    return getattr(bpy.ops.crowd_lod, operator.partition(".")[2]).get_rna_type().name


def in_words(messages: Iterable[Message]) -> list[Line]:
    """Return the lines that tell the messages, with the labels that buttons have now."""
    return lines_of(messages, label_of)


def keep_messages(settings: bpy.types.PropertyGroup, messages: Iterable[Message]) -> None:
    """Keep the messages in the settings, in place of those that were there."""
    settings.trouble = to_json(messages)


def messages_of(settings: bpy.types.PropertyGroup) -> tuple[Message, ...]:
    """Return the messages that the settings keep."""
    return from_json(settings.trouble)
