"""Sentences of messages: the same message about several subjects is one sentence."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from .format import counted, number
from .messages import Message, MessageKind

MOST_NAMED = 4  # of subjects
NAMED = 2  # of more than those


class Line(NamedTuple):
    """A sentence, and the operator that mends what it tells; "" without."""

    sentence: str
    remedy: str


def listed(names: Iterable[str], between: str = ", ") -> str:
    """Return the names, each once: "Witch, King", or "Witch, King and 3 others" of many."""
    each = list(dict.fromkeys(names))
    if len(each) <= MOST_NAMED:
        return between.join(each)
    return f"{between.join(each[:NAMED])} and {len(each) - NAMED} others"


def lines_of(messages: Iterable[Message], label_of: Callable[[str], str]) -> list[Line]:
    """Return a line for each thing that is told, in the order of the messages.

    label_of: returns the label of an operator's button.
    """
    alike: dict[tuple, list[Message]] = {}
    for message in messages:
        shared = tuple(str(message.facts[name]) for name in APART.get(message.kind, ()))
        of_whom = (message.kind, bool(message.subject), message.crowd, message.remedy, *shared)
        key = of_whom if message.subject else (*of_whom, id(message))
        alike.setdefault(key, []).append(message)
    lines = []
    for several in alike.values():
        first = several[0]
        sentence = WORDS[first.kind](several, label_of(first.remedy) if first.remedy else "")
        lines.append(Line(f"{first.crowd}: {sentence}" if first.crowd else sentence, first.remedy))
    return list(dict.fromkeys(lines))


def _facts(several: Sequence[Message], name: str) -> list[Any]:
    return [message.facts[name] for message in several]


def _subjects(several: Sequence[Message]) -> str:
    return listed(message.subject for message in several)


def _each(several: Sequence[Message], words: str) -> str:
    """Return `words` of each subject, listed; they name {subject} and facts."""
    return listed(
        words.format(subject=message.subject, **_in_words(message)) for message in several
    )


def _in_words(message: Message) -> dict[str, str]:
    """Return the facts as text: numbers of three digits, counts with separators."""
    return {name: _fact_in_words(fact) for name, fact in message.facts.items()}


def _fact_in_words(fact: Any) -> str:
    if isinstance(fact, float):
        return number(fact)
    return f"{fact:,}" if isinstance(fact, int) else str(fact)


def _off_color(several: Sequence[Message], _: str) -> str:
    facts = several[0].facts
    pixels = counted(
        facts["pixels"],
        "pixel of the label map has no label's color and counts",
        "pixels of the label map have no label's color and count",
    )
    return (
        f"{pixels} as {facts['label']}: paint over, first in column {facts['column']}, row "
        f"{facts['row']} from the bottom."
    )


def _chatters(several: Sequence[Message], _: str) -> str:
    return _caught(
        several[0],
        "agent switches states endlessly in place",
        "agents switch states endlessly in place",
    )


def _stuck(several: Sequence[Message], _: str) -> str:
    return _caught(several[0], "agent is stuck", "agents are stuck")


def _caught(message: Message, singular: str, plural: str) -> str:
    facts = message.facts
    agents = counted(facts["agents"], singular, plural)
    where = f"most of them ({facts['there']}) at" if facts["cells"] > 1 else "at"
    place = f"x {facts['x']:.2f} m, y {facts['y']:.2f} m"
    cell = f"map column {facts['column']}, row {facts['row']} from the bottom"
    remedy = "repaint the map there, or give the state another rule for that label"
    return f"{agents}, {where} {place} ({cell}): {remedy}."


def _checked_in_part(several: Sequence[Message], _: str) -> str:
    facts = several[0].facts
    return (
        f"Only the first {facts['checked']:,} of {facts['agents']:,} agents were checked for "
        f"being stuck, {facts['seconds']:.3g} s ahead."
    )


def _beside_offset(several: Sequence[Message], _: str) -> str:
    verb, pronoun = ("stands", "its") if len(several) == 1 else ("stand", "their")
    return (
        f"{_each(several, '{subject} ({beside} m)')} {verb} beside the Instance Offset of "
        f"{pronoun} collection, so {pronoun} rig or mesh places the agents. To move the offset "
        f"there, use Set Offset from Object in the Object Properties."
    )


def _raised(several: Sequence[Message], _: str) -> str:
    whose = "its" if len(several) == 1 else "their"
    moves = listed(
        f"{message.subject} was {_risen(message, 'raised', 'lowered')}" for message in several
    )
    return f"{moves}, so that {whose} feet touch the ground."


def _risen(message: Message, up: str, down: str) -> str:
    rise = message.facts["rise"]
    return f"{up if rise > 0 else down} by {number(abs(rise))} m"


def _off_its_soles(several: Sequence[Message], _: str) -> str:
    moves = listed(f"{message.subject}: {_risen(message, 'raise', 'lower')}" for message in several)
    return f"Feet do not touch the ground ({moves}): tick Stand on Ground, or move the character."


def _unknown_extent(several: Sequence[Message], _: str) -> str:
    margin = number(max(_facts(several, "margin")))
    return (
        f"Renders may show more than was measured of {_each(several, '{subject} ({what})')}: if it "
        f"is missing at the picture's border, set Margin to Fixed, {margin} m or more."
    )


def _height(several: Sequence[Message], _: str) -> str:
    return (
        f"{_each(several, '{subject} is {height} m tall')}: if these are people, scale them to "
        f"about 1.7 m, or set Unit Scale in the scene's Units."
    )


def _still_poses(several: Sequence[Message], _: str) -> str:
    frames, seconds = (max(_facts(several, name)) for name in ("frames", "seconds"))
    poses = several[0].facts["poses"]
    stands = f"{number(frames)} frames ({number(seconds)} s) of its action"
    if len(several) == 1:
        return (
            f"{several[0].subject} is built as {poses} still poses, each of which stands for "
            f"{stands}, because {several[0].facts['reason']}: remove that, or shorten the action."
        )
    return (
        f"{_each(several, '{subject} ({reason})')} are built as {poses} still poses, each of which "
        f"stands for up to {stands}: remove what is in brackets, or shorten the action."
    )


def _by_time(several: Sequence[Message], _: str) -> str:
    verb, pronoun = ("is", "it") if len(several) == 1 else ("are", "them")
    return (
        f"{_each(several, '{subject} (by {movers})')} {verb} moved by the scene's time, which "
        f"agents do not play: renders show {pronoun} as at frame 1. Give {pronoun} an action, on a "
        f"rig or on shape keys."
    )


def _without_faces(several: Sequence[Message], _: str) -> str:
    return (
        f"Not included: {_each(several, '{subject} ({what})')}. Crowds show faces and hair: "
        f"convert the rest to meshes if needed."
    )


def _hangs_outside(several: Sequence[Message], button: str) -> str:
    hangs, wears = ("hangs", "it") if len(several) == 1 else ("hang", "them")
    return (
        f"{_each(several, '{subject} (on {character})')} {hangs} on a character outside its "
        f"collection, so no agent wears {wears}: press {button}."
    )


def _unsaved(several: Sequence[Message], _: str) -> str:
    return (
        f"No collection holds {_subjects(several)}, on which the characters depend: Blender does "
        f"not save such objects, so link them to a collection."
    )


def _root_motion(several: Sequence[Message], _: str) -> str:
    action = several[0].facts["action"]
    return (
        f"The {f'action {action}' if action else 'own animation'} moves "
        f"{_each(several, '{subject} by {way} m')} in a cycle: that is taken out, because the "
        f"crowd moves its agents."
    )


def _no_stride(several: Sequence[Message], _: str) -> str:
    action, aside, speeds = (several[0].facts[name] for name in ("action", "aside", "speeds"))
    moves = _each(several, "{subject} by {way} m in {period} s")
    if aside:
        why = f"not along Forward ({aside})"
    elif speeds:
        why = f"and agents walk at {listed(map(number, speeds), ' or ')} m/s"
    else:
        why = "and agents stand"
    plays, owner = (f"action {action}", "the action") if action else ("own animation", "the group")
    return (
        f"The {plays} moves {moves}, {why}: that is no stride, so it plays by time. To "
        f"make it one, give {owner} a custom property stride, in meters."
    )


def _feet_slide(several: Sequence[Message], _: str) -> str:
    state = several[0].facts["state"]
    slide = number(max(_facts(several, "slide")))
    actions = listed(_facts(several, "action"))
    strides = [message for message in several if message.facts["stride"]]
    if strides:
        own = number(strides[0].facts["fits"])
        remedy = (
            f"set its property stride to {own} m"
            if len(several) == 1
            else f"set their property stride: {_each(several, '{action} {fits} m')}"
        )
    else:
        speeds = sorted(_facts(several, "fits"))
        remedy = f"give the state the speed {listed(map(number, speeds), ' or ')} m/s"
    most = "" if len(several) == 1 else "up to "
    return (
        f"In the state {state} the feet of {_subjects(several)} slide by {most}{slide} m in a "
        f"cycle of {actions}: {remedy}."
    )


def _no_walk(several: Sequence[Message], button: str) -> str:
    own = listed(_facts(several, "action"))
    better = listed(
        f"{message.facts['walk']} ({chosen_by(message.facts['by_name'])})" for message in several
    )
    if len(several) == 1:
        walks = f"walks by the action {own}, and its file has"
    else:
        walks = f"walk by the actions {own}, and their files have"
    return f"{_subjects(several)} {walks} {better}: press {button}."


def chosen_by(name: bool) -> str:
    """Return why an action was chosen as the walk."""
    return "chosen by name" if name else "chosen by its speed"


def _glides(several: Sequence[Message], button: str) -> str:
    verb, pronoun = ("has", "it") if len(several) == 1 else ("have", "them")
    walks = sorted({walk for walk in _facts(several, "walk") if walk})
    others, refused = (
        list(dict.fromkeys(name for names in _facts(several, fact) for name in names))
        for fact in ("others", "refused")
    )
    if walks:
        way = f"press {button}, which gives {pronoun} {listed(walks)}"
    elif movers := [name for names in _facts(several, "movers") for name in names]:
        way = (
            f"{listed(movers)} moves {pronoun} by the scene's time, which agents do not play, so "
            f"turn that into an action by Bake Action (Object > Animation)"
        )
    elif others:
        way = f"choose the action ({listed(others)}) in Character Groups"
    else:
        way = f"import the file of the pack that holds its motion, then press {button}"
    other_skeleton = f" Made for another skeleton: {listed(refused)}." if refused else ""
    return (
        f"{_subjects(several)} {verb} no action, and would glide: {way}. Or press Stand Still."
        f"{other_skeleton}"
    )


def _glows(several: Sequence[Message], _: str) -> str:
    effect = (
        "so culled agents stay in the render"
        if several[0].facts["stays"]
        else "which culling removes without Shadows and Reflections"
    )
    verb = "casts" if len(several) == 1 else "cast"
    return (
        f"In Cycles {_each(several, '{subject} (material {material})')} {verb} light, {effect}: to "
        f"avoid it, mix the emission with Transparent by Light Path > Is Camera Ray."
    )


def _image_missing(several: Sequence[Message], _: str) -> str:
    paths = sorted({path for paths in _facts(several, "paths") for path in paths})
    is_one = len(paths) == 1
    return (
        f"{counted(len(paths), 'image')} of {_subjects(several)} {'is' if is_one else 'are'} "
        f"missing, and {'renders' if is_one else 'render'} pink ({paths[0]}): copy the pack's "
        f"textures there, or use File > External Data > Find Missing Files."
    )


def _speed(several: Sequence[Message], _: str) -> str:
    facts = several[0].facts
    remedy = (
        "check Frame Rate and Unit"
        if facts["from_file"]
        else "check the speeds of the state machine, which are in m/s"
    )
    if not facts["median"]:
        return f"No agent moves: {remedy}."
    return f"Agents walk at a median of {number(facts['median'])} m/s: {remedy}."


def _climbs(several: Sequence[Message], _: str) -> str:
    return (
        f"Agents climb by {number(several[0].facts['height'])} m in the file: if y is up in it, "
        f"set Up to Y."
    )


def _off_the_ground(several: Sequence[Message], _: str) -> str:
    facts = several[0].facts
    side = "above" if facts["height"] > 0 else "below"
    return (
        f"{facts['share']:.0%} of the agents stand {number(abs(facts['height']))} m {side} the "
        f"ground {facts['ground']}: choose it as Terrain Object, or change the z of Center."
    )


def _obstacle(several: Sequence[Message], button: str) -> str:
    return (
        f"{counted(len(several), 'object stands', 'objects stand')} in the crowd's way "
        f"({_subjects(several)}): press {button} to lead agents around."
    )


def _within_walls(several: Sequence[Message], _: str) -> str:
    facts = several[0].facts
    remedy = (
        "move it, or set Center so that they fit the scene"
        if facts["from_file"]
        else "add it to Walls and Areas, with a label where agents may not start"
    )
    walls = listed(facts["walls"])
    return f"{facts['share']:.1%} of the agents stand within {walls}: {remedy}."


def _no_terrain(several: Sequence[Message], _: str) -> str:
    facts = several[0].facts
    over = facts["over"]
    has, them, stand = ("has", "it", "stands") if over == 1 else ("have", "them", "stand")
    return (
        f"{over:,} of {facts['agents']:,} agents {has} no ground of the terrain {facts['terrain']} "
        f"under {them}, and {stand} at the crowd's height, {number(facts['height'])} m: enlarge "
        "the terrain, or move Center."
    )


def _terrain_of_characters(several: Sequence[Message], _: str) -> str:
    collection = several[0].facts["collection"]
    return (
        f"The terrain lies in the collection {collection} of the characters "
        f"({_subjects(several)}), which renders leave out: move it to another."
    )


def _terrain_moves(several: Sequence[Message], _: str) -> str:
    return (
        f"The terrain moves ({_subjects(several)}): agents stand on it as it is now, in all frames."
    )


def _places_outside(several: Sequence[Message], _: str) -> str:
    facts = several[0].facts
    size, fits = (" x ".join(map(number, facts[name])) for name in ("size", "fits"))
    return (
        f"{facts['lost']:,} of {counted(facts['places'], 'start point')} "
        f"{'lies' if facts['lost'] == 1 else 'lie'} outside the crowd's area ({size}): set Size to "
        f"{fits}."
    )


def _places_on_labels(several: Sequence[Message], _: str) -> str:
    facts = several[0].facts
    place, remedy = (
        ("where the label map does not let agents start", "paint a label there that does")
        if facts["map"]
        else (
            "on the edges of the crowd's area, where agents do not start",
            "move Center, or change Size",
        )
    )
    lies = "lies" if facts["lost"] == 1 else "lie"
    return (
        f"{facts['lost']:,} of {counted(facts['places'], 'start point')} {lies} {place}: {remedy}."
    )


# What is said of a LOD that was not made, by its facts.
OF_LODS = {
    MessageKind.SAVES_LITTLE: "save less than a fifth of the {finer} of the next finer LOD",
    MessageKind.BESIDE_GIVEN: "save too little beside a given LOD of {given}",
    MessageKind.DEVIATES_AS_MUCH: "deviate as much as one of {fewer}, or more",
    MessageKind.NEVER_ALIKE: "not look like the character from any distance",
    MessageKind.TOO_COARSE: (
        "show more than the tolerance at any distance, for the camera is orthographic"
    ),
    MessageKind.TOO_FINE: (
        "be finer than the tolerance needs at any distance, for the camera is orthographic"
    ),
    MessageKind.BEGINS_TOO_FAR: "begin {begin} m away, and the farthest agent is {farthest} m away",
    MessageKind.ENDS_TOO_NEAR: "end {end} m away, and the nearest agent is {nearest} m away",
    MessageKind.TOO_FEW: (
        "be too coarse for all agents in {few} of the {frames} frames checked, and finer than "
        "needed in the others"
    ),
    MessageKind.NOT_WORTH_IT: "save too little memory and time in {engine} to be worth it",
}


def _not_made(several: Sequence[Message], _: str) -> str:
    facts = several[0].facts
    about = "" if facts["measured"] else "about "
    triangles = counted(facts["triangles"], "triangle")
    would = OF_LODS[several[0].kind].format(**_in_words(several[0]))
    return f"{_subjects(several)}: a LOD of {about}{triangles} would {would}."


WORDS: dict[MessageKind, Callable[[Sequence[Message], str], str]] = {
    MessageKind.OFF_COLOR: _off_color,
    MessageKind.CHATTERS: _chatters,
    MessageKind.STUCK: _stuck,
    MessageKind.CHECKED_IN_PART: _checked_in_part,
    MessageKind.BESIDE_OFFSET: _beside_offset,
    MessageKind.RAISED: _raised,
    MessageKind.OFF_ITS_SOLES: _off_its_soles,
    MessageKind.UNKNOWN_EXTENT: _unknown_extent,
    MessageKind.HEIGHT: _height,
    MessageKind.STILL_POSES: _still_poses,
    MessageKind.BY_TIME: _by_time,
    MessageKind.HANGS_OUTSIDE: _hangs_outside,
    MessageKind.WITHOUT_FACES: _without_faces,
    MessageKind.UNSAVED: _unsaved,
    MessageKind.ROOT_MOTION: _root_motion,
    MessageKind.NO_STRIDE: _no_stride,
    MessageKind.FEET_SLIDE: _feet_slide,
    MessageKind.NO_WALK: _no_walk,
    MessageKind.GLIDES: _glides,
    MessageKind.GLOWS: _glows,
    MessageKind.IMAGE_MISSING: _image_missing,
    MessageKind.SPEED: _speed,
    MessageKind.CLIMBS: _climbs,
    MessageKind.OFF_THE_GROUND: _off_the_ground,
    MessageKind.OBSTACLE: _obstacle,
    MessageKind.WITHIN_WALLS: _within_walls,
    MessageKind.NO_TERRAIN: _no_terrain,
    MessageKind.TERRAIN_OF_CHARACTERS: _terrain_of_characters,
    MessageKind.TERRAIN_MOVES: _terrain_moves,
    MessageKind.PLACES_OUTSIDE: _places_outside,
    MessageKind.PLACES_ON_LABELS: _places_on_labels,
    **dict.fromkeys(OF_LODS, _not_made),
}
# facts in which subjects of one sentence agree
LOD = "measured", "triangles"
APART = {
    MessageKind.ROOT_MOTION: ("action",),
    MessageKind.NO_STRIDE: ("action", "aside", "speeds"),
    MessageKind.FEET_SLIDE: ("state", "stride"),
    MessageKind.SAVES_LITTLE: (*LOD, "finer"),
    MessageKind.BESIDE_GIVEN: (*LOD, "given"),
    MessageKind.DEVIATES_AS_MUCH: (*LOD, "fewer"),
    MessageKind.NEVER_ALIKE: LOD,
    MessageKind.TOO_COARSE: LOD,
    MessageKind.TOO_FINE: LOD,
    MessageKind.BEGINS_TOO_FAR: (*LOD, "begin", "farthest"),
    MessageKind.ENDS_TOO_NEAR: (*LOD, "end", "nearest"),
    MessageKind.TOO_FEW: (*LOD, "few", "frames"),
    MessageKind.NOT_WORTH_IT: (*LOD, "engine"),
}
