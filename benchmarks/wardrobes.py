"""What a wardrobe costs: LOD meshes of its parts, memory, a plan, a build.

./crowd-lod bench --wardrobes

The samples' adult wears bands of its own skin: SLOTS slots of VARIANTS variants, as many agents
without as with each. LODs are by distance. Seconds are of the processor.
"""

import time

import bmesh
import bpy
import crowd_lod_extension
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.cameras import read_cameras
from crowd_lod_extension.operators.build.cost_estimate import estimate
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd, trajectory_of
from crowd_lod_extension.operators.scene.shot_reference import SceneMoment, frame_of
from crowd_lod_extension.sample_scenes.characters import make_characters
from crowd_lod_extension.sample_scenes.scenery import aim, camera

SLOTS = 0, 1, 2, 4, 8
VARIANTS = 4
AGENTS = 10_000
FINER = -1  # steps of subdivision besides the sample characters' two
TALL = 1.7  # meters


def main() -> None:
    from worth import show

    crowd_lod_extension.register()
    show(f"{AGENTS:,} agents, {VARIANTS} variants a slot", [measure(count) for count in SLOTS])


def measure(slots: int) -> dict:
    """Return what the adult with so many slots costs, as a row of the table."""
    scene = _scene(slots)
    bpy.ops.crowd_lod.populate()
    making = _seconds(bpy.ops.crowd_lod.make_levels)
    trajectory = trajectory_of(scene)
    eyes = read_cameras(scene, bpy.context.evaluated_depsgraph_get())
    frame_of(read_crowd(scene), SceneMoment(10, eyes))
    planning = _seconds(lambda: frame_of(read_crowd(scene), SceneMoment(11, eyes)))
    memory = {}
    for engine in scene.render.engine, "CYCLES":
        scene.render.engine = engine
        memory[engine] = finished(estimate(scene, [10])).as_json["By Distance"]["memory_mb"]
    eevee, cycles = memory.values()
    return {
        "parts": slots * VARIANTS,
        "combinations": (VARIANTS + 1) ** slots,
        "worn": len(trajectory.start) - AGENTS,
        "LODs s": round(making, 1),
        "LOD vertices": sum(sum(group.vertices) for group in trajectory.groups),
        "plan ms": round(1000 * planning, 1),
        "build s": round(_seconds(bpy.ops.crowd_lod.build), 1),
        "Cycles MB": round(cycles),
        "EEVEE MB": round(eevee),
    }


def _seconds(work) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def _scene(slots: int) -> bpy.types.Scene:
    """Return a new file's scene with the adult and its slots before a camera."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    people = bpy.data.collections.new("People")
    scene.collection.children.link(people)
    make_characters(people, finer=FINER)
    for child in people.children[:]:
        if child.name != "adult":
            people.children.unlink(child)
    adult = people.children["adult"]
    body = next(item for item in adult.objects if item.type == "MESH")
    for slot in range(slots):
        home = bpy.data.collections.new(f"slot: {slot}")
        home["none"] = 1.0
        adult.children.link(home)
        for variant in range(VARIANTS):
            home.objects.link(_band(body, slot / slots * TALL, variant))
    scene.camera = camera(scene, "Camera", 0.1, 200.0)
    aim(scene.camera, (0, -60, 3), (0, 0, 1))
    settings = scene.crowd_lod
    settings.characters = people
    settings.forward = "X"
    settings.count = AGENTS
    settings.size = (100, 100)
    settings.choice = "BY_DISTANCE"
    settings.method = "DECIMATE"
    return scene


def _band(body: bpy.types.Object, low: float, variant: int) -> bpy.types.Object:
    """Return a part that covers the body from `low` meters on, deformed as the body is."""
    item = body.copy()
    item.data = body.data.copy()
    top = low + TALL * (0.15 + 0.03 * variant)
    edited = bmesh.new()
    edited.from_mesh(item.data)
    outside = [face for face in edited.faces if not low <= face.calc_center_median().z <= top]
    bmesh.ops.delete(edited, geom=outside, context="FACES")
    for vertex in edited.verts:
        vertex.co += 0.01 * (variant + 1) * vertex.normal
    edited.to_mesh(item.data)
    edited.free()
    return item
