"""The character groups: their list in the sidebar."""

import bpy


class CROWDLOD_UL_groups(bpy.types.UIList):
    """One group of agents a row: its name."""

    def draw_item(  # noqa: PLR0913 - Blender's own signature
        self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0
    ) -> None:
        layout.label(text=item.name, icon="COMMUNITY", translate=False)

    def filter_items(self, context, data, property) -> tuple[list[int], list[int]]:
        """Return which groups are shown, but for what only some agents wear, in their own order."""
        groups = getattr(data, property)
        return [0 if group.variant_of else self.bitflag_filter_item for group in groups], []


def _agents_of(scene: bpy.types.Scene) -> list[int]:
    """Return the places of the groups of agents among all groups."""
    return [k for k, group in enumerate(scene.crowd_lod.groups) if not group.variant_of]


def selected_group(scene: bpy.types.Scene) -> bpy.types.PropertyGroup:
    """Return the group that is selected in the list; there is one at least."""
    agents = _agents_of(scene) or [0]
    chosen = scene.crowd_lod_editor.group_index
    return scene.crowd_lod.groups[chosen if chosen in agents else agents[0]]


def draw_groups(layout, scene: bpy.types.Scene) -> bpy.types.PropertyGroup:
    """Draw the list of the groups, if there are several, and return the selected one."""
    if len(_agents_of(scene)) > 1:
        layout.template_list(
            "CROWDLOD_UL_groups",
            "",
            scene.crowd_lod,
            "groups",
            scene.crowd_lod_editor,
            "group_index",
            rows=3,
        )
    return selected_group(scene)


CLASSES = (CROWDLOD_UL_groups,)
