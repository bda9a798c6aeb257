"""A frame of a small crowd."""

from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, edge_map

from .crowds import walker

GROUPS = walker(), walker(sizes=(500, 50, 5))


def shot(groups=GROUPS):
    machine = load_preset("chapter")
    world = edge_map(Area(-40, 0, 40, 100), machine.labels)
    return Walk(populate(3000, 2, 2, machine, world), machine, world, groups, 1 / 24)
