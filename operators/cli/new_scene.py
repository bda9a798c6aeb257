"""The commands scene and simulate: scenes made of trajectories, given or simulated."""

from collections.abc import Generator, Iterable
from contextlib import suppress
from math import floor, radians
from pathlib import Path

import bpy
import numpy as np

from ...crowd_lod.culling.camera import framing
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted, printable
from ...crowd_lod.frame.frame_range import spread_evenly
from ...crowd_lod.output import files
from ...crowd_lod.progress import Workload
from ...crowd_lod.sources.recorded import Recorded
from ..blender import cameras, console, removal, scene_data
from ..blender.references import closure_of
from ..build.render_setup import remove_build
from ..scene.characters.stored_groups import groups_of
from ..scene.populate import populate_scene
from ..scene.scene_crowd import characters_of, trajectory_of
from ..scene.sources.crowd_sources import depsgraph_of
from ..scene.sources.simulate import lay_out, simulate_into
from ..scene.sources.simulation_source import file_digest, file_name, simulated_crowds
from ..settings.crowd_settings import CharacterSettings
from ..settings.crowds import first_crowd, set_lengths
from ..settings.level_settings import LevelSettings
from .options import (
    add_command,
    add_out,
    add_scene,
    add_setting,
    apply_settings,
    open_shot,
    to_path,
)
from .scene_files import blend_path, finish, first_line, open_scene, save, stem_of

# Settings that the new scene keeps: those of characters and their LOD meshes. The detail map is
# painted over another ground.
KEPT = {
    *CharacterSettings.__annotations__,
    *LevelSettings.__annotations__,
    *("groups", "levels", "memory_tolerance", "memory_made", "dropped"),
} - {"bias_image"}
LENS = 28.0  # millimeters
DOWN = 0.2  # part of the picture's height by which the horizon is above the middle
BORDER = 0.95  # part of the picture that the crowd is framed in
MOST_FRAME = 1_048_574  # the last one of Blender's timeline
LOOKS = 40  # frames by which the camera is placed
MOST_PLACES = 400_000  # places of agents in these frames


def add_new_scene(commands, program: str) -> None:
    """Add the command scene to the program's."""
    command = add_command(
        commands,
        program,
        "scene",
        new_scene,
        "scene bottleneck.txt --unit cm --fps 25 --characters people.blend --out bottleneck.blend",
    )
    command.add_argument(
        "tracks", type=to_path, metavar="TRACKS", nargs="?", help="a file of trajectories"
    )
    command.add_argument(
        "--characters",
        type=to_path,
        required=True,
        metavar="FILE",
        help="a .blend file; those that its scene has set are taken",
    )
    command.add_argument(
        "--source",
        metavar="OBJECT",
        help="in place of TRACKS: the points of this object in FILE are the agents",
    )
    command.add_argument(
        "--ground", type=to_path, metavar="FILE", help="a .blend file whose scene is the ground"
    )
    add_setting(command, "--columns", "tracks_columns", "NAMES", usual="the file's titles")
    add_setting(command, "--fps", "tracks_rate", "N", usual="0")
    add_setting(command, "--unit", "tracks_unit", usual="auto")
    add_setting(command, "--up", "tracks_up", usual="z")
    add_out(command, "FILE", "the .blend file (default: TRACKS.blend, or OBJECT.blend)")


def new_scene(args) -> dict:
    """Run the command scene: write a scene of trajectories, or of an object's points."""
    if (args.tracks is None) == (args.source is None):
        raise CrowdError(
            "Give either a file of trajectories, TRACKS, or --source with the name of an object."
        )
    path = blend_path(args.out or Path(f"{args.source or args.tracks.stem}.blend"))
    tracks, characters, ground = (
        _existing(value) for value in (args.tracks, args.characters, args.ground)
    )
    with files.staged_file(path) as part:
        scene = open_scene(str(characters))
        characters_of(scene)  # says what is wrong with them
        source = _object(args.source, characters)
        is_own_ground = ground is not None and ground.samefile(characters)
        scenery = _empty(scene, source, is_own_ground)
        crowd = first_crowd(scene.crowd_lod)
        if ground is not None:
            crowd.terrain = scenery if is_own_ground else _add_ground(scene, ground)
        if source is None:
            crowd.source = "FILE"
            crowd.tracks_file = str(tracks)
            apply_settings(args, scene.crowd_lod)
        else:
            crowd.source = "POINTS"
            crowd.points = source
        sentence = finish(_filled(scene), f"scene of {path.stem}", args.quiet)
        if source is None:
            with suppress(ValueError):  # on another drive
                # saving makes it relative to the new file
                crowd.tracks_file = bpy.path.relpath(str(tracks))
        save(part, path)
    count = scene.frame_end - scene.frame_start + 1
    return {
        "out": printable(path),
        "frames": [scene.frame_start, scene.frame_end],
        "camera": [round(value, 3) for value in scene.camera.matrix_world.translation],
        "summary": f"{sentence}\n{counted(count, 'frame')} at "
        f"{scene_data.frame_rate(scene):g} a second.\n{printable(path)}",
    }


def _existing(path: Path | None) -> Path | None:
    """Return the path from the root; CrowdError if nothing is there."""
    if path is None:
        return None
    if not path.exists():
        raise CrowdError(f"There is no file {printable(path)}: give another path.")
    return files.absolute(path)


def _object(name: str | None, path: Path) -> bpy.types.Object | None:
    """Return the object of that name in the open file; CrowdError if there is none."""
    if name is not None and name not in bpy.data.objects:
        raise CrowdError(
            f"There is no object {name} in {printable(path)}: give the name of one whose points "
            f"are the agents."
        )
    return None if name is None else bpy.data.objects[name]


def _empty(
    scene: bpy.types.Scene, source: bpy.types.Object | None, keeps: bool
) -> bpy.types.Collection | None:
    """Empty the open file but for `scene` and the object `source`.

    Of the scene its characters, LOD meshes, world and render settings stay.

    keeps: whether all else that the scene shows stays, too, in a collection that is returned.
    """
    settings = scene.crowd_lod
    if settings.build is not None:
        remove_build(settings)
    for prop in settings.bl_rna.properties:
        if prop.identifier not in KEPT and not prop.is_readonly:
            settings.property_unset(prop.identifier)
    for name in ("crowds", "overrides"):
        getattr(settings, name).clear()
    scene.animation_data_clear()
    scene.timeline_markers.clear()
    scene.sequence_editor_clear()
    scene.camera = scene.background_set = None
    for other in [other for other in bpy.data.scenes if other != scene]:
        removal.remove([other])
    top = scene.collection
    home = bpy.data.collections.new("Ground")
    homes = {
        settings.characters,
        *([settings.levels] if settings.levels in top.children_recursive else []),
    }
    homes |= _homes_of_needed(homes, source)
    for parent in (top, *bpy.data.collections):
        for child in homes & set(parent.children):
            parent.children.unlink(child)
    for child in list(top.children):
        home.children.link(child)
        top.children.unlink(child)
    for item in list(top.objects):
        if item != source:
            home.objects.link(item)
        top.objects.unlink(item)
    for child in (*homes, *([home] if keeps else [])):
        top.children.link(child)
    settings.characters.hide_render = True
    if source is not None:
        top.objects.link(source)
    if not keeps:
        removal.remove([home])
    bpy.data.orphans_purge(do_recursive=True)
    meters = scene_data.meters(scene)
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.scale_length = meters
    return home if keeps else None


def _homes_of_needed(
    collections: Iterable[bpy.types.Collection], source: bpy.types.Object | None
) -> set[bpy.types.Collection]:
    """Return a new hidden collection of what the objects need from outside, if anything.

    Blender would purge parents and targets that no collection holds, and without them characters
    would change their size and place.

    collections: of the objects.
    source: needs no home.
    """
    inside = {item for collection in collections for item in collection.all_objects}
    outside = set(closure_of(inside)) - inside - {source}
    if not outside:
        return set()
    home = bpy.data.collections.new("Characters' Parents")
    home.hide_render = True
    for item in outside:
        home.objects.link(item)
    return {home}


def _add_ground(scene: bpy.types.Scene, path: Path) -> bpy.types.Collection:
    """Append all that the first scene with meshes in a file shows; return its collection.

    Its world comes along if `scene` has none.
    """
    try:
        with console.quiet(), bpy.data.libraries.load(str(path), link=False) as (there, loaded):
            loaded.scenes = there.scenes
    except (OSError, RuntimeError) as error:
        raise CrowdError(f"Blender cannot read {printable(path)}: {first_line(error)}") from None
    home = bpy.data.collections.new("Ground")
    scene.collection.children.link(home)
    ground = next(
        (other for other in loaded.scenes if any(item.type == "MESH" for item in other.objects)),
        None,
    )
    if ground is None:
        raise CrowdError(
            f"No scene of {printable(path)} shows a mesh: give a file with the ground, or leave "
            f"out --ground."
        )
    its_meters = scene_data.meters(ground)
    meters = scene_data.meters(scene)
    if abs(its_meters / meters - 1) > 1e-5:
        raise CrowdError(
            f"A unit of the scene {ground.name} in {printable(path.name)} is {its_meters:g} m, and "
            f"one of the characters' scene {meters:g} m: give both files the same Unit Scale."
        )
    for child in ground.collection.children:
        home.children.link(child)
    for item in ground.collection.objects:
        home.objects.link(item)
    scene.world = scene.world or ground.world
    for other in loaded.scenes:
        removal.remove([other])
    bpy.data.orphans_purge(do_recursive=True)
    return home


def _filled(scene: bpy.types.Scene) -> Generator[float, None, str]:
    """Populate the scene, add camera and light: yield the progress, return a sentence."""
    work = Workload(2)  # populating takes about as long as looking where agents are
    sentence, warnings = yield from work.take(populate_scene(scene), 1)
    if first_crowd(scene.crowd_lod).source == "FILE":
        trajectory = trajectory_of(scene)
        last = _last(trajectory)
        if last > MOST_FRAME:
            raise CrowdError(
                f"The file plays until frame {last:,}, and Blender's timeline ends at "
                f"{MOST_FRAME:,}: give rows of a shorter time, or the right --fps."
            )
        scene.frame_start = trajectory.first_frame
        scene.frame_end = last
    _film(scene, (yield from work.take(_places(scene), 1)))
    if not any(item.type == "LIGHT" for item in scene.objects):
        _add(scene, "Sun", bpy.data.lights.new("Sun", "SUN")).rotation_euler = (
            radians(50),
            0,
            radians(30),
        )
    if scene.world is None:
        scene.world = bpy.data.worlds.new("World")
    scene.frame_set(scene.frame_start)
    return " ".join((sentence, *warnings))


def _last(trajectory: Recorded) -> int:
    """Return the last whole frame of the scene in which the file has anyone."""
    return floor(trajectory.scene_frame(trajectory.tracks.last) + 1e-6)


def _places(scene: bpy.types.Scene) -> Generator[float, None, np.ndarray]:
    """Find where agents are all over the shot: yield the progress, return (n, 3) float64."""
    frames = spread_evenly(range(scene.frame_start, scene.frame_end + 1), LOOKS)
    places = []
    work = Workload(len(frames))
    for frame in frames:
        scene.frame_set(frame)
        trajectory = trajectory_of(scene)
        yield from work.take(trajectory.approach(frame), 1)
        crowd = trajectory.at(frame)
        there = np.stack([crowd.x, crowd.y, crowd.z], axis=1)[
            slice(None) if crowd.present is None else crowd.present
        ]
        places.append(there[:: max(1, len(there) * len(frames) // MOST_PLACES)])
    return np.concatenate(places)


def _film(scene: bpy.types.Scene, places: np.ndarray) -> None:
    """Add a camera that frames the `places` (n, 3)."""
    camera = _add(scene, "Camera", bpy.data.cameras.new("Camera"))
    width, height = cameras.image_size(scene.render)
    camera.data.lens = LENS
    camera.data.shift_y = -DOWN * height / max(width, height)
    scene.camera = camera
    window = cameras.camera_from(camera, scene.render, bpy.context.evaluated_depsgraph_get()).window
    meters = scene_data.meters(scene)
    view = framing(
        places * meters, BORDER * window.right, -BORDER * window.bottom, BORDER * window.top
    )
    x, y = view.ahead
    scene_data.look_at(camera, view.eye / meters, (y, -x, 0), (0, 0, 1), (x, y, 0))
    camera.data.clip_start = 0.1 / meters
    camera.data.clip_end = view.far / meters


def _add(scene: bpy.types.Scene, name: str, data: bpy.types.ID) -> bpy.types.Object:
    item = bpy.data.objects.new(name, data)
    scene.collection.objects.link(item)
    return item


def add_simulate(commands, program: str) -> None:
    """Add the command simulate to the program's."""
    command = add_command(
        commands,
        program,
        "simulate",
        simulate_scene,
        "simulate hall.blend --seconds 60 --out hall_simulated.blend",
    )
    add_scene(command, program)
    add_setting(command, "--seconds", "simulated_seconds", "S")
    add_setting(command, "--agents", "count", "N")
    add_setting(command, "--seed", "seed", "N")
    add_out(command, "FILE", "the .blend file (default: SCENE_simulated.blend)")


def simulate_scene(args) -> dict:
    """Write the scene with its crowds simulated, and their trajectories beside it.

    Where no crowd has the source Simulation, the first one gets it.
    """
    stem = stem_of(args)
    path = files.follow_link(blend_path(args.out or Path(f"{stem}_simulated.blend")))
    with files.staged(path.parent, path.name) as hidden:
        scene = open_shot(args)
        if not simulated_crowds(scene):
            first_crowd(scene.crowd_lod).source = "SIMULATION"
        set_lengths(scene)
        depsgraph = depsgraph_of(scene)
        lay_out(scene, depsgraph)
        crowds = simulated_crowds(scene)
        groups = groups_of(scene.crowd_lod)
        digest = file_digest(scene, groups)
        names = [f"{path.stem}_{file_name(crowd, digest)}" for crowd in crowds]
        steps = simulate_into([hidden / name for name in names], scene, groups, depsgraph)
        sentence = finish(steps, f"simulation of {stem}", args.quiet)
        for crowd, name in zip(crowds, names, strict=True):
            beside = bpy.data.filepath and bpy.path.relpath(str(path.with_name(name)))
            crowd.simulation_file = beside or f"//{name}"
        part = hidden.with_suffix(".part")
        save(part, path)
        part.replace(hidden / path.name)
    tracks = [printable(path.with_name(name)) for name in names]
    lines = sentence, printable(path), *tracks
    return {"out": printable(path), "tracks": tracks, "summary": "\n".join(lines)}
