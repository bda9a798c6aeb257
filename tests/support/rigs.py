"""Animated data-blocks."""


def keyed(block, path, value, last):
    """Let `path` of the block run from what it is at frame 1 to `value` at `last`."""
    block.keyframe_insert(path, frame=1)
    setattr(block, path, value)
    block.keyframe_insert(path, frame=last)
