"""What Populate has told of a scene."""

from crowd_lod_extension.operators.settings.messages import in_words, messages_of


def told(scene):
    """The lines of what Populate found, as text."""
    return "\n".join(line.sentence for line in in_words(messages_of(scene.crowd_lod)))


def sentences(messages):
    return [line.sentence for line in in_words(messages)]
