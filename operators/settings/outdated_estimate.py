"""The cost estimate is cleared when a setting changes that it rests on."""


def outdate(owner, _) -> None:
    """Clear the cost estimate: update callback of settings that change the cost."""
    owner.id_data.crowd_lod.estimate = ""
