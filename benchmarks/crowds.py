"""The crowds of worth.py and reach.py: characters on open ground, from a given distance on."""

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt
from pathlib import Path

import bmesh
import bpy
import lod_trial
import numpy as np
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.sample_scenes.characters import BUILDS, make_characters
from crowd_lod_extension.sample_scenes.scenery import add, aim, camera, child, film, material, tile

ROOM = 1.5  # square meters of ground for each agent


def make(
    groups: int, meters: float, finer: int = 1, pixels: int = 0, split: bool = False
) -> bpy.types.Scene:
    """A new file's scene of `groups` characters.

    Each step of `finer` has four times the faces of the samples'. They stand `meters` and more from
    the camera. pixels: of a side of the image that each has, or 0; split: of triangles with normals
    of their own, as game characters are.
    """
    scene = _open_ground(meters)
    characters = child(scene, "Characters", hidden=True)
    builds = [
        replace(
            BUILDS[g % len(BUILDS)],
            name=f"person {g:02d}",
            limb=BUILDS[g % len(BUILDS)].limb * (1 + 0.01 * g),
        )
        for g in range(groups)
    ]
    made = make_characters(characters, builds=builds, finer=finer)
    if pixels:
        for g, group in enumerate(made):
            _paint(group, pixels, g)
    if split:
        for item in characters.all_objects:
            if item.type == "MESH":
                _split(item.data)
    scene.crowd_lod.characters = characters
    scene.crowd_lod.forward = "X"
    return scene


def gather(files: Sequence[Path], meters: float) -> bpy.types.Scene:
    """A new file's scene of the characters in the glTF and FBX `files`, one each.

    They stand `meters` and more from the camera.
    """
    scene = _open_ground(meters)
    for file in files:
        imported = lod_trial.bring(file)
        for item in scene.objects:
            item.select_set(item in imported)
        bpy.ops.crowd_lod.characters_from_selection()
    return scene


def _open_ground(meters: float) -> bpy.types.Scene:
    """A new file's scene without characters; its crowd begins `meters` from the camera."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    scene = bpy.context.scene
    film(scene)
    add(
        child(scene, "Scenery"),
        "Ground",
        [(tile(-3000, -3000, 3000, 3000, -0.02), material("Ground", (0.5, 0.5, 0.48)))],
    )
    scene.camera = camera(scene, "Camera", near=0.1, far=5000.0)
    height = 1.7 + 0.3 * meters
    aim(scene.camera, (-meters, 0, height), (100, 0, -0.5))
    scene.crowd_lod.frames = "30:32"
    scene.crowd_lod.step = 1
    spread(scene, 1000)
    return scene


def spread(scene: bpy.types.Scene, agents: int) -> None:
    """Give the crowd so many agents, and ground in proportion.

    The ground begins where it did.
    """
    side = sqrt(ROOM * agents)
    settings = scene.crowd_lod
    settings.count = agents
    settings.size = (side, side)
    settings.center = (side / 2, 0, 0)


def _paint(group: bpy.types.Collection, pixels: int, seed: int) -> None:
    """Give both materials of a character one image of its own, spots in shades of gray."""
    spots = np.random.default_rng(seed).integers(
        120, 255, (pixels // 32, pixels // 32, 1), np.uint8
    )
    image = image_data.write_image(
        f"{group.name} image", spots.repeat(32, axis=0).repeat(32, axis=1).repeat(3, axis=2)
    )
    for surface in [
        each for item in group.objects if item.type == "MESH" for each in item.data.materials
    ]:
        shader = next(node for node in surface.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
        node = surface.node_tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        surface.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])


def _split(mesh: bpy.types.Mesh) -> None:
    """Cut the faces into triangles, and give the corners normals of their own."""
    work = bmesh.new()
    work.from_mesh(mesh)
    bmesh.ops.triangulate(work, faces=work.faces)
    work.to_mesh(mesh)
    work.free()
    mesh.normals_split_custom_set_from_vertices([vertex.normal for vertex in mesh.vertices])
