"""What is kept of the scene from frame to frame is what reading it anew finds, whatever was changed
meanwhile.
"""

import bpy
import crowd_lod_extension
import numpy as np
import pytest
from crowd_lod_extension.operators.blender import scenery
from crowd_lod_extension.operators.blender.materials import switch_nodes_on

from ..support.objects import collection, filmed_from, lamp, mesh_of


@pytest.fixture
def stage():
    """A set of props: plain ones, one animated with its child, one that glows, an instanced
    collection, lamps, a mirror.
    """
    scene = bpy.context.scene
    mesh = mesh_of("prop", [(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)], [(0, 1, 2), (0, 1, 3)])
    mesh.materials.append(material("plain"))
    bright = mesh.copy()
    bright.materials.clear()
    bright.materials.append(material("bright", 2.0))
    home = collection("set")
    props = {name: bpy.data.objects.new(name, mesh) for name in ("still", "walks", "child", "part")}
    props["glows"] = bpy.data.objects.new("glows", bright)
    props["lamp"] = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SPOT"))
    props["crane"] = bpy.data.objects.new("crane", None)
    parts = bpy.data.collections.new("parts")
    for name, item in props.items():
        (parts if name == "part" else home).objects.link(item)
    props["crane"].instance_type = "COLLECTION"
    props["crane"].instance_collection = parts
    props["child"].parent = props["walks"]
    for name, x in (("walks", 3), ("lamp", 5)):
        for frame in (1, 50):
            props[name].location.x = x * frame
            props[name].keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    return scene


def material(name, strength=0.0):
    made = bpy.data.materials.new(name)
    switch_nodes_on(made).nodes["Principled BSDF"].inputs[
        "Emission Strength"
    ].default_value = strength
    return made


def find(shown, depsgraph):
    """What is found, to be compared."""
    box = shown.box(depsgraph)
    kinds = shown.things, shown.lamps(depsgraph)
    named = [
        sorted((item.name, tuple(each.name for each in inside)) for item, inside in some)
        for some in kinds
    ]
    return named, None if box is None else box.tolist()


def compared(scene):
    """The scenery of the scene, after it was compared with what is found anew."""
    depsgraph = bpy.context.view_layer.depsgraph
    shown = scenery.scenery_of(scene, depsgraph)
    assert find(shown, depsgraph) == find(scenery.Scenery(scene, depsgraph), depsgraph)
    return shown


def thing(name):
    return bpy.data.objects[name]


def node(name, kind="materials"):
    return getattr(bpy.data, kind)[name].node_tree.nodes


def linked(name):
    item = bpy.data.objects.new("new", bpy.data.meshes["prop"])
    item.location = 90, 0, 0
    bpy.data.collections[name].objects.link(item)
    return item


def excluded(name):
    bpy.context.view_layer.layer_collection.children[name].exclude = True


def corner_moved():
    mesh = bpy.data.meshes["prop"]
    mesh.vertices[1].co.x = 40
    mesh.update()


def grouped(name):
    """Show the material `name` by a group that holds an Emission."""
    group = bpy.data.node_groups.new("group", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    emission = group.nodes.new("ShaderNodeEmission")
    end = group.nodes.new("NodeGroupOutput")
    group.links.new(emission.outputs[0], end.inputs[0])
    holder = node(name).new("ShaderNodeGroup")
    holder.node_tree = group
    bpy.data.materials[name].node_tree.links.new(
        holder.outputs[0], node(name)["Material Output"].inputs["Surface"]
    )


def fog():
    world = bpy.context.scene.world = bpy.data.worlds.new("fog")
    switch_nodes_on(world)
    scatter = world.node_tree.nodes.new("ShaderNodeVolumeScatter")
    output = world.node_tree.nodes["World Output"]
    world.node_tree.links.new(scatter.outputs[0], output.inputs["Volume"])


EDITS = {
    "moved": lambda: setattr(thing("still"), "location", (-70, 8, 1)),
    "turned by what it hangs on": lambda: setattr(thing("walks"), "rotation_euler", (1, 2, 3)),
    "scaled": lambda: setattr(thing("still"), "scale", (30, 1, 1)),
    "another shape": corner_moved,
    "another mesh": lambda: setattr(thing("still"), "data", bpy.data.meshes["prop.001"]),
    "hidden": lambda: setattr(thing("walks"), "hide_render", True),
    "hidden in the viewport": lambda: setattr(thing("walks"), "hide_viewport", True),
    "hidden part": lambda: setattr(thing("part"), "hide_render", True),
    "hidden collection": lambda: setattr(bpy.data.collections["set"], "hide_render", True),
    "excluded": lambda: excluded("set"),
    "removed": lambda: bpy.data.objects.remove(bpy.data.collections["set"].objects[0]),
    "unlinked": lambda: bpy.data.collections["set"].objects.unlink(
        bpy.data.collections["set"].objects[-1]
    ),
    "added": lambda: linked("set"),
    "part added": lambda: linked("parts"),
    "part moved": lambda: setattr(thing("part"), "location", (0, 0, 60)),
    "instancer moved": lambda: setattr(thing("crane"), "location", (0, 60, 0)),
    "instances moved": lambda: setattr(
        bpy.data.collections["parts"], "instance_offset", (0, 0, 80)
    ),
    "no instances": lambda: setattr(thing("crane"), "instance_type", "NONE"),
    "instances of faces": lambda: setattr(thing("walks"), "instance_type", "FACES"),
    "nodes": lambda: thing("still").modifiers.new("nodes", "NODES"),
    "lit up": lambda: setattr(
        node("plain")["Principled BSDF"].inputs["Emission Strength"], "default_value", 1.0
    ),
    "lit up by a node": lambda: node("plain").new("ShaderNodeEmission"),
    "lit up by a group of nodes": lambda: grouped("plain"),
    "put out": lambda: setattr(
        node("bright")["Principled BSDF"].inputs["Emission Strength"], "default_value", 0.0
    ),
    "another material": lambda: bpy.data.meshes["prop"].materials.append(
        bpy.data.materials["bright"]
    ),
    "material of the object": lambda: setattr(thing("still").material_slots[0], "link", "OBJECT"),
    "lamp off": lambda: setattr(bpy.data.lights["lamp"], "energy", 0),
    "lamp black": lambda: setattr(bpy.data.lights["lamp"], "color", (0, 0, 0)),
    "no shadows": lambda: setattr(bpy.data.lights["lamp"], "use_shadow", False),
    "another lamp": lambda: setattr(bpy.data.lights["lamp"], "type", "SUN"),
    "parent": lambda: setattr(thing("still"), "parent", thing("walks")),
    "constraint": lambda: setattr(
        thing("still").constraints.new("COPY_LOCATION"), "target", thing("walks")
    ),
    "delta": lambda: setattr(thing("still"), "delta_location", (0, 0, -50)),
    "fog": fog,
}


@pytest.mark.parametrize("edit", EDITS)
def test_what_is_kept_follows_every_edit(stage, edit):
    first = compared(stage)
    assert compared(stage) is first
    EDITS[edit]()
    bpy.context.view_layer.update()
    compared(stage)
    stage.frame_set(7)
    compared(stage)
    EDITS[edit]()  # once more, or the same again, with no look in between
    stage.frame_set(8)
    last = compared(stage)
    stage.frame_set(20)
    assert compared(stage) is last


@pytest.mark.parametrize("name", ["still", "lamp", "part", "crane", "glows"])
def test_what_is_hidden_in_some_frames(stage, name):
    thing(name).hide_render = True
    thing(name).keyframe_insert("hide_render", frame=1)
    thing(name).hide_render = False
    thing(name).keyframe_insert("hide_render", frame=5)
    shown = []
    for frame in (1, 2, 5, 6, 4, 3, 7):
        stage.frame_set(frame)
        compared(stage)
        shown.append(
            thing(name)
            in {
                item
                for item, _ in scenery.scenery_of(stage, bpy.context.view_layer.depsgraph).things
            }
        )
    assert shown == [False, False, True, True, False, False, True]


def test_what_is_in_another_view_layer_alone(stage):
    other = stage.view_layers.new("other")
    far = linked("parts")
    bpy.context.view_layer.layer_collection.children["set"].exclude = True
    assert bpy.context.view_layer != other
    stage.frame_set(2)
    compared(stage)
    for item, x in ((thing("still"), -300), (far, 500)):
        item.location.x = x
        other.update()
        stage.frame_set(stage.frame_current + 1)
        compared(stage)
    node("plain")["Principled BSDF"].inputs["Emission Strength"].default_value = 1.0
    stage.frame_set(9)
    compared(stage)
    other.use = False
    stage.frame_set(10)
    compared(stage)


def test_another_scenes_frames(stage):
    """As a bake evaluates its frames: in a copy of the scene."""
    copy = stage.copy()
    layer = copy.view_layers[0]
    boxes = []
    for frame in (1, 10):
        copy.frame_set(frame)
        boxes.append(scenery.scenery_of(stage, layer.depsgraph).box(layer.depsgraph))
        assert (boxes[-1] == scenery.Scenery(stage, layer.depsgraph).box(layer.depsgraph)).all()
    assert boxes[1][1, 0] > boxes[0][1, 0]


def test_frames_of_what_is_animated_alone_are_not_read_anew(stage):
    boxes = []
    stage.frame_set(1)
    first = compared(stage)
    for frame in range(2, 12):
        stage.frame_set(frame)
        assert compared(stage) is first
        boxes.append(
            scenery.scenery_of(stage, bpy.context.view_layer.depsgraph).box(
                bpy.context.view_layer.depsgraph
            )
        )
    assert (np.diff([box[1, 0] for box in boxes]) > 0).all()


@pytest.fixture
def handled():
    """Adds a function to the front or the end of a list of handlers."""
    added = []

    def add(event, at, function):
        handlers = getattr(bpy.app.handlers, event)
        handlers.insert(0 if at == "front" else len(handlers), function)
        added.append((handlers, function))

    yield add
    for handlers, function in added:
        handlers.remove(function)


HANDLED = [
    "moved",
    "turned by what it hangs on",
    "another shape",
    "hidden",
    "removed",
    "added",
    "lit up",
    "another mesh",
]


@pytest.mark.parametrize("event", ["frame_change_post", "depsgraph_update_post"])
@pytest.mark.parametrize("at", ["front", "end"])
def test_what_other_handlers_change(stage, handled, event, at):
    """Blender evaluates it anew without asking any handler."""
    changes = {4 + 2 * k: EDITS[name] for k, name in enumerate(HANDLED)}
    handled(event, at, lambda scene, depsgraph: changes.pop(scene.frame_current, lambda: None)())
    for frame in range(2, 22):
        stage.frame_set(frame)
        compared(stage)
        thing("lamp").data.energy += 1
        bpy.context.view_layer.update()
        compared(stage)
    assert not changes


@pytest.mark.parametrize("event", ["frame_change_post", "depsgraph_update_post"])
def test_handlers_that_a_script_clears(stage, event):
    handlers = getattr(bpy.app.handlers, event)
    ours = list(handlers)
    compared(stage)
    handlers.clear()
    try:
        EDITS["moved"]()
        stage.frame_set(2)
        bpy.context.view_layer.update()
        compared(stage)
        crowd_lod_extension.unregister()
        crowd_lod_extension.register()
        assert list(handlers) == ours
    finally:
        handlers[:] = ours


def test_what_is_gone_before_the_next_update(stage):
    compared(stage)
    for name in ("still", "lamp", "part", "crane"):
        bpy.data.objects.remove(thing(name))
        compared(stage)


def test_instances_of_a_collection_that_moves_its_origin(stage):
    """Blender says that the collection has changed, and nothing of what instances it or is in
    it.
    """
    outer = bpy.data.collections.new("outer")
    outer.children.link(bpy.data.collections["parts"])
    thing("crane").instance_collection = outer
    for offset in (0, 30, 60):
        outer.instance_offset.x = offset
        bpy.context.view_layer.update()
        compared(stage)
        stage.frame_set(stage.frame_current + 1)
        compared(stage)


def test_a_group_of_nodes_that_emits_makes_a_material_glow(stage):
    assert [item.name for item, _ in scenery.Scenery(stage, None).lamps(None)] == ["lamp", "glows"]
    grouped("plain")
    assert {item.name for item, _ in scenery.Scenery(stage, None).lamps(None)} >= {
        "still",
        "walks",
        "part",
    }


def test_parts_of_collections_that_are_hidden_in_renders_are_not_shown(stage):
    inner = collection("inner", within=bpy.data.collections["parts"])
    linked("inner").name = "inmost"
    shown = {item.name for item, inside in scenery.Scenery(stage, None).things if inside}
    assert shown == {"part", "inmost"}
    inner.hide_render = True
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert {item.name for item, inside in scenery.Scenery(stage, depsgraph).things if inside} == {
        "part"
    }


def test_renders_find_what_is_on_and_shown_at_their_own_frames(stage, handled, tmp_path):
    """The file's own data have the values of the frame that the interface shows."""
    strength = node("plain")["Principled BSDF"].inputs["Emission Strength"]
    second = lamp("POINT")
    keyed = (
        (second, "hide_render", True, False),
        (thing("lamp").data, "energy", 0, 9),
        (strength, "default_value", 0, 1),
    )
    for frame, column in ((1, 2), (2, 2), (3, 3), (4, 3)):
        for owner, name, *values in keyed:
            setattr(owner, name, values[column - 2])
            owner.keyframe_insert(name, frame=frame)
    found = {}

    def look(scene, depsgraph):
        lamps = scenery.scenery_of(scene, depsgraph).lamps(depsgraph)
        found.setdefault((depsgraph.mode, scene.frame_current), {item.name for item, _ in lamps})

    handled("frame_change_post", "end", look)
    filmed_from((0, 0, 0))
    stage.render.engine = "CYCLES"
    stage.cycles.samples = 1
    stage.cycles.use_denoising = False
    stage.render.resolution_x = stage.render.resolution_y = 8
    stage.render.filepath = str(tmp_path / "f")
    stage.frame_start = 1
    stage.frame_end = 4
    for own in (1, 4):
        found.clear()
        stage.frame_set(own)
        bpy.ops.render.render(animation=True)
        dark = {"glows"}
        lit = {"glows", "lamp", "POINT", "still", "walks", "child", "part"}
        assert [found["RENDER", frame] for frame in (1, 2, 3, 4)] == [dark, dark, lit, lit]
