"""Slots of parts that agents of a group wear: who wears what, and that every step shows it."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.messages import from_json
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.shot_cost import work_in
from crowd_lod_extension.operators.blender.colors import BY_AGENT, Looks
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.blender.mesh_data import read_points
from crowd_lod_extension.operators.build import bake
from crowd_lod_extension.operators.build.shelves import points_of
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.plan.shot_plan import PlanRequest, plan_shot, write_levels
from crowd_lod_extension.operators.scene.characters.characters import all_characters
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of
from crowd_lod_extension.operators.viewport.draw_data import by_material
from crowd_lod_extension.operators.viewport.skinned_characters import SkinnedCharacter

from ..support.built import bodies, off, populated, standing
from ..support.rigs import itself
from ..support.scatter import scatter
from ..support.scene_frames import frame_now
from .test_points_source import crowd_of
from .test_props import ball

PARTS = ["adult", "adult + cap", "adult + crown", "adult + bob", "child"]


def slot(name, *items, **properties):
    """A slot of the adult that holds the objects `items`."""
    home = bpy.data.collections.new(f"slot: {name}")
    adult = bpy.data.collections["adult"]
    adult.children.link(home)
    for item in items:
        adult.objects.unlink(item)
        home.objects.link(item)
    for key, value in properties.items():
        home[key] = value
    return home


@pytest.fixture
def dressed(scene):
    """Adults of whom some wear a cap or a crown, and some hair, but not under the crown."""
    cap = ball("cap", 0.2, (0, 0, 1.8), "head")
    crown = ball("crown", 0.4, (0, 0, 1.9), "head")
    bob = ball("bob", 0.25, (0, 0, 1.6), "head")
    crown["excludes"] = "hair"
    cap["share"] = 2.0
    slot("a hat", cap, crown, none=1.0)
    slot("hair", bob, none=1.0)
    return scene


def test_what_is_told_of_a_wearer_is_not_repeated_for_what_it_wears(dressed):
    for item in dressed.crowd_lod.characters.all_objects:
        if item.parent is None:
            item.location.z += 0.4
    bpy.ops.crowd_lod.populate()
    told = from_json(dressed.crowd_lod.trouble)
    assert [message.subject for message in told] == ["adult", "child"]


def test_parts_are_agents_who_do_what_their_wearers_do(dressed):
    dressed.crowd_lod.count = 4000
    trajectory = populated(dressed)
    names = [group.name for group in trajectory.groups]
    assert sorted(names) == sorted(PARTS)
    adult, cap, crown, bob = (names.index(name) for name in PARTS[:4])
    people = trajectory.bare
    assert len(people.start) == 4000 and set(people.start.group) == {adult, names.index("child")}
    crowd = trajectory.at(37)
    worn = {}
    for g in (cap, crown, bob):
        rows = np.flatnonzero(crowd.group == g)
        agents = trajectory.wearer[rows]
        for column in ("x", "y", "z", "heading", "phase_class", "pace", "key"):
            values = getattr(crowd, column)
            assert (values[rows] == values[agents]).all()
        assert (crowd.group[agents] == adult).all()
        rate = trajectory.gaits.rates
        assert (rate[g] == rate[adult]).all()
        worn[g] = set(crowd.x[rows].tolist())
    adults = np.count_nonzero(people.start.group == adult)
    for g, share in ((cap, 0.5), (crown, 0.25), (bob, 0.375)):
        assert abs(len(worn[g]) - share * adults) < 5 * np.sqrt(adults * share * (1 - share))
    assert not worn[cap] & worn[crown] and not worn[crown] & worn[bob] and worn[cap] & worn[bob]
    spheres = trajectory.spheres
    assert len({spheres.radius[g] for g in (adult, cap, crown, bob)}) == 1
    bpy.data.objects["bob"]["share"] = 0.5
    again = populated(dressed).at(37)
    assert np.array_equal(again.x[again.group == cap], crowd.x[crowd.group == cap])


def test_what_is_worn_follows_overrides_points_and_other_crowds(dressed):
    scene = dressed
    settings = scene.crowd_lod
    settings.count = 200
    trajectory = populated(scene)
    names = [group.name for group in trajectory.groups]
    first, second, third = np.unique(trajectory.wearer[200:])[:3].tolist()
    values = ("HIDE", {}), ("GROUP", {"group_name": "child"}), ("NUDGE", {"move": (3, 0, 0)})
    for agent, (kind, more) in zip((first, second, third), values, strict=True):
        entry = settings.overrides.add()
        entry.type = kind
        entry.agents = str(agent)
        for name, value in more.items():
            setattr(entry, name, value)
    overridden = trajectory_of(scene)
    crowd = overridden.at(1)
    before = trajectory.at(1)
    rows = [overridden.with_worn(np.array([agent])) for agent in (first, second, third)]
    assert len(rows[0]) > 1 and not crowd.present[rows[0]].any()
    assert len(rows[1]) == 1 and crowd.group[rows[1]] == [names.index("child")]
    assert len(rows[2]) > 1 and np.allclose(crowd.x[rows[2]] - before.x[third], 3)
    settings.agent = int(rows[2][1])  # what a large change of the plan may be of
    bpy.ops.crowd_lod.override_agent(type="HIDE")
    assert settings.overrides[-1].agents == str(third)
    settings.overrides.clear()
    bpy.ops.crowd_lod.add_row(kind="crowds")
    settings.crowds[1].count = 50
    several = populated(scene)
    assert len(several.bare.start) == 250 and len(several.parts) == 2
    settings.crowds[1].use_crowd = False
    hidden = trajectory_of(scene).at(1).present
    assert (hidden == (several.wearer < 200)).all()
    settings.crowds.remove(1)
    item = scatter(attributes=[("id", "INT", np.arange(60) * 7)])
    points = crowd_of(scene, item)
    people = len(points.bare.start)
    assert people == 60 and (points.ids[people:] == -1).all()
    for name in ("x", "y", "heading"):
        column = getattr(points.start, name)
        assert (column == column[points.wearer]).all()


WRONG = {
    "The slot hair of adult is empty": ("bob", "hide_render", True),
    "of the slot hair of adult are all 0": ("bob", "share", 0.0),
    r"The part adult \+ crown excludes the slot beard": ("crown", "excludes", "beard"),
    "No agent can wear the slot a hat of adult": ("slot: hair", "excludes", "a hat"),
    r"The part adult \+ bob is not moved by adult rig": ("bob", "parent", None),
    "two slots called a hat": ("slot: hair", "slot", "a hat"),
    '"share" of bob is -1.0, and must be numbers from 0': ("bob", "share", -1.0),
}


@pytest.mark.parametrize("said", WRONG)
def test_slots_that_cannot_be_used_are_named(dressed, said):
    name, key, value = WRONG[said]
    bpy.data.collections["slot: hair"]["none"] = 0.0
    item = bpy.data.objects.get(name) or bpy.data.collections[name]
    if hasattr(item, key):
        setattr(item, key, value)
    else:
        item[key] = value
    with pytest.raises(CrowdError, match=said):
        all_characters(dressed)


@pytest.mark.once
def test_plan_build_and_bake_show_each_part_where_its_wearer_is(dressed, tmp_path):
    scene = dressed
    scene.crowd_lod.level_count = 1
    scene.crowd_lod.count = 60
    populated(scene)
    list(make_levels(scene))
    plan = finished(plan_shot(scene, PlanRequest([50], tmp_path)))
    write_levels(tmp_path, plan)
    scene.crowd_lod.shot_plan = str(tmp_path / "plan.npz")
    finished(bake.bake(scene, [50]))
    rigs = [item for item in scene.crowd_lod.build.all_objects if item.type == "ARMATURE"]
    # of adults, of what their bones carry, of children
    assert len({item.data for item in rigs}) == 3
    assert len(rigs) == work_in(plan.shot, plan.plan.bill.agents_shown).rigs
    scene.frame_set(50)
    frame = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    crowd = frame.crowd
    trajectory = frame.trajectory
    assert frame.planned and frame.people == 60
    assert len(set(plan.stored.phases.shift.tolist())) > 1
    assert (crowd.phase_class == crowd.phase_class[trajectory.wearer]).all()
    agents = frame.buckets.order
    built = read_points(points_of(scene.crowd_lod.build)["LOD", 0].data)
    assert set(built["row"]) == set(agents.tolist())
    assert (built["id"] == trajectory.wearer[built["row"]]).all()
    visible = bodies(scene)
    assert len(visible) == len(agents) > len(frame.without_worn(frame.buckets).order)
    for g in range(5):
        agent = agents[crowd.group[agents] == g][0]
        rate = trajectory.gaits.rates[g, crowd.pace[agent]]
        phase = (crowd.phase_class[agent] / trajectory.gaits.classes + rate * 50 / 24) % 1.0
        points = standing(scene, crowd, agent, itself(scene, g, phase))
        assert off(points, visible) < 2e-4


def test_make_slot_takes_what_is_selected_or_changes_nothing(scene):
    cap = ball("cap", 0.2, (0, 0, 1.8), "head")
    crown = ball("crown", 0.4, (0, 0, 1.9), "head")
    with pytest.raises(RuntimeError, match="Select objects of one character group first"):
        bpy.ops.crowd_lod.make_slot()
    for item in (bpy.data.objects["adult"], cap, crown):
        item.select_set(True)
    with pytest.raises(RuntimeError, match="All meshes of the character group adult are props or"):
        bpy.ops.crowd_lod.make_slot(slot="hat")
    adult = bpy.data.collections["adult"]
    assert not adult.children and cap.users_collection == (adult,) and "share" not in cap
    bpy.ops.object.select_all(action="DESELECT")
    cap.select_set(True)
    bpy.ops.crowd_lod.make_slot(slot="hat", none=0.5)
    cap.select_set(False)
    crown.select_set(True)
    bpy.ops.crowd_lod.make_slot(slot="hat")
    (home,) = adult.children
    assert home.name == "slot: hat" and set(home.objects) == {cap, crown} and home["none"] == 0.5
    assert [(part.name, part.chance) for part in all_characters(scene)[1:3]] == [
        ("adult + cap", 0.4),
        ("adult + crown", 0.4),
    ]
    home.name = "things"  # as a user's own collection
    del home["none"]
    bpy.ops.object.select_all(action="DESELECT")
    layer = bpy.context.view_layer
    layer.active_layer_collection = layer.layer_collection.children["People"]
    with pytest.raises(RuntimeError, match="or make a collection active that lies in a group's"):
        bpy.ops.crowd_lod.make_slot(slot="hat")
    groups = layer.layer_collection.children["People"].children
    layer.active_layer_collection = groups["adult"].children["things"]
    bpy.ops.crowd_lod.make_slot(slot="hat")
    assert home["slot"] == "hat" and all_characters(scene)[1].chance == pytest.approx(1 / 3)


def color_ramp(name, color):
    """A material that varies with `looks`: black, and from 0.5 on `color`."""
    material = bpy.data.materials.new(name)
    tree = switch_nodes_on(material)
    nodes = tree.nodes
    number = nodes.new("ShaderNodeAttribute")
    number.attribute_type = "INSTANCER"
    number.attribute_name = "looks"
    ramp = nodes.new("ShaderNodeValToRGB")
    ramp.color_ramp.interpolation = "CONSTANT"
    ramp.color_ramp.elements[1].position = 0.5
    ramp.color_ramp.elements[1].color = color
    tree.links.new(number.outputs["Fac"], ramp.inputs["Fac"])
    tree.links.new(ramp.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    return material


def test_the_overlay_colors_each_part_by_its_looks(dressed):
    looks = Looks()
    red = (1, 0, 0, 1)
    assert looks.of(color_ramp("caps", red)) == (0.5, 0, 0, BY_AGENT)
    assert looks.of(color_ramp("feathers", (0, 0, 1, 1)))[3] == -1  # an agent has one color
    trajectory = populated(dressed)
    none = np.empty(0)
    cast = [
        SkinnedCharacter(group.name, none, (), none, np.full(3, 0.2), 0.0, None, ramp=ramp)
        for group in trajectory.groups
        for ramp in [looks.ramp if group.name == "adult + cap" else None]
    ]
    frame = frame_now(dressed, bpy.context.evaluated_depsgraph_get())
    colors = by_material(frame, cast)
    caps = frame.crowd.group == [part.name for part in cast].index("adult + cap")
    shown = colors.palette[colors.index]
    assert (shown[caps] == np.where(trajectory.looks[caps, None] < 0.5, (0, 0, 0, 1), red)).all()
    assert (shown[~caps, :3] == np.float32(0.2)).all() and caps.sum() > 20
