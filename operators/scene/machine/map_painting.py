"""A label map made in Blender: its image, the plane that shows it, and a brush for each label."""

import math
from collections.abc import Iterator
from contextlib import suppress

import bpy
import numpy as np

from ....crowd_lod import srgb
from ....crowd_lod.errors import CrowdError
from ...blender import image_data, scene_data
from ...blender.labeled_properties import IntProperty, StringProperty
from ...blender.materials import switch_nodes_on
from ...blender.operator import Reporting
from ...settings.crowds import active_crowd, active_or_new, set_lengths
from . import map_areas
from .scene_world import area_of, machine_of

MARK = "crowd_lod_map"  # custom property of the plane
# custom property of the plane: the color setting of solid viewports before it was shown
COLORS = "crowd_lod_colors"
ABOVE = 0.02  # meters of the plane above the ground, so that the two do not flicker
BRUSH = "Crowd LOD Label"


def map_of(scene: bpy.types.Scene) -> bpy.types.Image | None:
    """Return the active crowd's label map, or None."""
    crowd = active_crowd(scene.crowd_lod)
    return crowd and crowd.map_image


def plane_of(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Return the plane that shows the active crowd's label map, or None."""
    return next((item for item in scene.objects if MARK in item and item.type == "MESH"), None)


def is_plane_shown(scene: bpy.types.Scene) -> bool:
    """Return whether the plane exists and is shown."""
    plane = plane_of(scene)
    return plane is not None and not plane.hide_viewport and map_of(scene) is not None


def show(scene: bpy.types.Scene) -> bpy.types.Object:
    """Return the plane with the active crowd's map, made if need be, over that crowd's ground.

    Renders do not show it. CrowdError without a map.
    """
    image = map_of(scene)
    if image is None:
        raise CrowdError("The crowd has no label map: press New Map, or choose an image.")
    area = area_of(active_crowd(scene.crowd_lod))
    plane = plane_of(scene)
    if plane is None:
        plane = bpy.data.objects.new("Label Map", _square())
        plane[MARK] = True
        scene.collection.objects.link(plane)
    plane.hide_render = True
    plane.hide_viewport = False
    plane.parent = None
    plane.rotation_euler = plane.delta_rotation_euler = (0, 0, 0)
    plane.location = (
        (area.x_min + area.x_max) / 2,
        (area.y_min + area.y_max) / 2,
        area.z + ABOVE / scene_data.meters(scene),
    )
    plane.scale = (1, 1, 1)
    _stretch(plane.data, area.size)
    material = plane.data.materials[0] if plane.data.materials else None
    if material is None:
        material = bpy.data.materials.new("Label Map")
        plane.data.materials.append(material)
    _show_image(material, image)
    _textured(scene, plane)
    return plane


def hide(scene: bpy.types.Scene) -> None:
    """Leave Texture Paint and hide the plane; viewports look again as before it was shown."""
    plane = plane_of(scene)
    if plane is None:
        return
    if bpy.context.object == plane and plane.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    plane.hide_viewport = True
    _untextured(scene, plane)


def follow_active(scene: bpy.types.Scene) -> None:
    """Show the map of the crowd that is active now, if the plane is shown; hide it without one."""
    plane = plane_of(scene)
    if plane is None or plane.hide_viewport:
        return
    with suppress(CrowdError):  # its ground is too far off: told where the map is used
        if map_of(scene) is None:
            hide(scene)
        else:
            show(scene)


def _square() -> bpy.types.Mesh:
    """Return a square of side 1 whose UV map covers an image."""
    mesh = bpy.data.meshes.new("Label Map")
    corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
    mesh.from_pydata([(x, y, 0) for x, y in corners], [], [(0, 1, 2, 3)])
    uv = mesh.uv_layers.new(name="UVMap")
    for loop, (x, y) in zip(uv.data, corners, strict=True):
        loop.uv = (x + 0.5, y + 0.5)
    return mesh


def _stretch(mesh: bpy.types.Mesh, size: tuple[float, float]) -> None:
    """Set the square's width and depth in the mesh, since brushes warn of scaled objects."""
    for vertex in mesh.vertices:
        vertex.co = (
            math.copysign(size[0] / 2, vertex.co.x),
            math.copysign(size[1] / 2, vertex.co.y),
            0,
        )
    mesh.update()


def _show_image(material: bpy.types.Material, image: bpy.types.Image) -> None:
    """Let the material emit the image's colors, unsmoothed; it is what Texture Paint paints on."""
    tree = switch_nodes_on(material)
    texture = next((node for node in tree.nodes if node.type == "TEX_IMAGE"), None)
    if texture is None:
        tree.nodes.clear()
        texture, glow, output = (
            tree.nodes.new(f"ShaderNode{kind}")
            for kind in ("TexImage", "Emission", "OutputMaterial")
        )
        tree.links.new(texture.outputs["Color"], glow.inputs["Color"])
        tree.links.new(glow.outputs["Emission"], output.inputs["Surface"])
        texture.location.x = -300
        output.location.x = 200
    texture.image = image
    texture.interpolation = "Closest"
    tree.nodes.active = texture


def _viewports(scene: bpy.types.Scene) -> Iterator[tuple[str, bpy.types.View3DShading]]:
    """Yield a name and the shading of each viewport in a window that shows the scene."""
    for window in bpy.context.window_manager.windows:
        for number, area in enumerate(window.screen.areas if window.scene == scene else ()):
            if area.type == "VIEW_3D":
                yield f"{window.screen.name} {number}", area.spaces.active.shading


def _textured(scene: bpy.types.Scene, plane: bpy.types.Object) -> None:
    """Let solid viewports show textures, the plane's too; the plane notes their earlier setting."""
    for name, shading in _viewports(scene):
        if shading.type == "SOLID" and shading.color_type != "TEXTURE":
            plane[COLORS] = dict(plane.get(COLORS, {})) | {name: shading.color_type}
            shading.color_type = "TEXTURE"


def _untextured(scene: bpy.types.Scene, plane: bpy.types.Object) -> None:
    """Restore the viewports' colors from before `_textured`."""
    before = dict(plane.get(COLORS, {}))
    for name, shading in _viewports(scene):
        if name in before and shading.color_type == "TEXTURE":
            shading.color_type = before[name]
    if COLORS in plane:
        del plane[COLORS]


class CROWDLOD_OT_new_map(Reporting, bpy.types.Operator):
    bl_description = (
        "Make a label map over the active crowd's ground, all of the first label, and show it on a "
        "plane to paint on"
    )
    bl_idname = "crowd_lod.new_map"
    bl_label = "New Map"

    pixels: IntProperty(
        name="Pixels",
        default=map_areas.LONGER_SIDE,
        min=2,
        max=8192,
        description="Pixels along the longer side of the ground",
    )

    def run(self, context) -> str:
        crowd = active_or_new(context.scene.crowd_lod)
        set_lengths(context.scene)
        machine = machine_of(crowd)
        area = area_of(crowd)
        rows, columns = map_areas.cells_of(area.size, self.pixels)
        colors = np.broadcast_to(machine.label_colors[0], (rows, columns, 3))
        crowd.map_image = image_data.write_image("Label Map", colors)
        show(context.scene)
        cell = area.size[0] / columns * scene_data.meters(context.scene)
        return (
            f"{crowd.map_image.name}: {columns} by {rows} pixels of {cell:.3g} m, all "
            f"{machine.labels[0]}."
        )


def _unmapped(scene: bpy.types.Scene) -> str:
    return "" if map_of(scene) is not None else "The crowd has no label map: press New Map"


class CROWDLOD_OT_paint_label(Reporting, bpy.types.Operator):
    """Paint this label on the map, with a hard brush in Texture Paint"""

    bl_idname = "crowd_lod.paint_label"
    bl_label = "Paint Label"
    needs = (_unmapped,)

    label: StringProperty(name="Label", description="Label of the state machine")

    def run(self, context) -> str:
        scene = context.scene
        machine = machine_of(active_crowd(scene.crowd_lod))
        if self.label not in machine.labels:
            raise CrowdError(
                f"The state machine has no label {self.label}: choose one of "
                f"{', '.join(machine.labels)}."
            )
        plane = show(scene)
        if context.view_layer.objects.get(plane.name) is None or not plane.visible_get():
            raise CrowdError(
                f"The plane {plane.name} is hidden: show it in the Outliner, then paint."
            )
        if (
            context.object is not None
            and context.object != plane
            and context.object.mode != "OBJECT"
        ):
            bpy.ops.object.mode_set(mode="OBJECT")
        for item in context.selected_objects:
            item.select_set(False)
        plane.select_set(True)
        context.view_layer.objects.active = plane
        if plane.mode != "TEXTURE_PAINT":
            bpy.ops.object.mode_set(mode="TEXTURE_PAINT")
        _set_brush(context, machine.label_colors[machine.labels.index(self.label)] / 255)
        return (
            f"Paint {self.label} on the map; Ctrl-Tab or the mode menu leads out of Texture Paint."
        )


def _set_brush(context, color: np.ndarray) -> None:
    """Activate our brush with exactly this sRGB color (3,), 0 to 1."""
    tools = context.scene.tool_settings
    paint = tools.image_paint
    paint.mode = "MATERIAL"
    paint.dither = 0
    paint.seam_bleed = 0
    paint.use_normal_falloff = paint.use_stencil_layer = paint.use_cavity = False
    paint.use_symmetry_x = paint.use_symmetry_y = paint.use_symmetry_z = False
    brush = next(
        (each for each in bpy.data.brushes if each.name == BRUSH and each.use_paint_image), None
    )
    if brush is None:
        brush = bpy.data.brushes.new(BRUSH, mode="TEXTURE_PAINT")
        brush.size = 40
    if brush.asset_data is None:
        brush.asset_mark()
    if paint.brush != brush:
        bpy.ops.brush.asset_activate(
            asset_library_type="LOCAL", relative_asset_identifier=f"Brush/{brush.name}"
        )
    if paint.brush is None:
        raise CrowdError("Blender did not choose the brush: choose one, and press the label again.")
    _harden(paint.brush)
    unified = getattr(paint, "unified_paint_settings", None) or tools.unified_paint_settings
    for owner in (paint.brush, unified):
        linear = owner.bl_rna.properties["color"].subtype == "COLOR"  # from Blender 5.0 on
        owner.color = srgb.linear(color) if linear else color
    unified.use_unified_strength = False


def _harden(brush: bpy.types.Brush) -> None:
    """Let the brush write its plain color, without a soft edge."""
    brush.blend = "MIX"
    brush.strength = 1.0
    brush.hardness = 1.0
    brush.use_paint_antialiasing = brush.use_pressure_strength = brush.use_color_jitter = False
    brush.stroke_method = "SPACE"
    brush.color_type = "COLOR"
    falloff = (
        "curve_distance_falloff_preset"
        if hasattr(brush, "curve_distance_falloff_preset")
        else "curve_preset"
    )
    setattr(brush, falloff, "CONSTANT")
    brush.use_accumulate = False
    brush.texture_slot.texture = brush.mask_texture_slot.texture = None


CLASSES = (CROWDLOD_OT_new_map, CROWDLOD_OT_paint_label)
