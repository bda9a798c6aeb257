"""What Populate has told of a scene."""

from crowd_lod_extension.crowd_lod.messages import from_json
from crowd_lod_extension.operators.settings.messages import in_words


def told(scene):
    """The lines of what Populate found, as text."""
    return "\n".join(line.sentence for line in in_words(from_json(scene.crowd_lod.trouble)))


def sentences(messages):
    return [line.sentence for line in in_words(messages)]
