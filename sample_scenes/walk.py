"""What the sample characters do, walk, wait, sit and cheer: a pose for every frame of one cycle.

The poses are solved so that the feet never slide. NumPy alone.
Character space: meters, walking along +x on the spot, so that the ground and the foot on it move
along -x. A limb's turn is a 3x3 matrix from rest to pose in that space, not relative to the parent
bone.
"""

from dataclasses import dataclass

import numpy as np

STRIKE = 0.23  # strides before its place at rest, where the foot lands
STANCE = 0.6  # part of the cycle from the heel's strike until the toe leaves the ground
# the sole is flat in between; the heel bears before, the ball after
FLAT = 0.08
HEEL_OFF = 0.30
# of the foot, degrees, toes down positive
STRIKE_PITCH = -17
LEAVE_PITCH = 62
SEAT = 0.4  # meters, the height of a bench
REACH = 0.996  # of the leg's length at most: the knee never quite straightens


@dataclass(frozen=True)
class Cycle:
    """Poses at whole frames 0 to period, the last equal to the first.

    turns: bone name > (period + 1, 3, 3).
    shift: (period + 1, 3) meters, the hips' offset from their rest place.
    stride: meters walked in one cycle.
    """

    turns: dict
    shift: np.ndarray
    stride: float


def walk_cycle(joints: dict, period: int, stride: float) -> Cycle:
    """Return the walk of a skeleton over `period` frames and `stride` meters.

    joints: those of a body.Body.
    """
    phase = np.arange(period + 1) % period / period  # 0: the left heel strikes
    k = joints["head"][2][2] / 1.75
    swing = np.cos(2 * np.pi * phase)
    lean = np.sin(2 * np.pi * (phase - 0.05))
    zero = np.zeros_like(phase)

    hips = yaw(np.radians(-6) * swing) @ roll(np.radians(2.5) * lean)
    turns = {
        "hips": hips,
        "spine": yaw(np.radians(-1) * swing) @ pitch(zero + np.radians(2)),
        "chest": yaw(np.radians(6) * swing)
        @ pitch(zero + np.radians(4))
        @ roll(np.radians(-1) * lean),
        "neck": yaw(np.radians(2) * swing) @ pitch(zero + np.radians(3)),
        "head": pitch(np.radians(1.5) * np.cos(4 * np.pi * phase)),
    }
    arm_swing = np.radians(8 + 12 * min(1.0, stride / (1.5 * joints["thigh.L"][1][2])))
    for tag, side in ((".L", 1), (".R", -1)):
        forward = -side * swing  # the arm goes with the other leg
        out = roll(zero + side * np.radians(-24))
        shoulder = turns["chest"] @ pitch(-np.radians(3) - arm_swing * forward)
        bend = np.radians(18) + np.radians(10) * forward
        turns["upper_arm" + tag] = shoulder @ out
        turns["forearm" + tag] = shoulder @ pitch(-bend) @ roll(zero + side * np.radians(-28))
        turns["hand" + tag] = (
            shoulder @ pitch(-bend - np.radians(6)) @ roll(zero + side * np.radians(-30))
        )

    late = {".L": 0.0, ".R": 0.5}
    feet = {tag: foot_path(joints, tag, (phase + late[tag]) % 1, stride) for tag in late}
    shift = np.stack([zero, 0.018 * k * lean, -0.024 * k * np.cos(4 * np.pi * (phase - 0.03))], 1)
    shift[:, 2] -= max(overreach(joints, tag, hips, shift, feet[tag][0]) for tag in feet)
    for tag, (ankle, foot, toe) in feet.items():
        hip = hip_joint(joints, tag, hips, shift)
        turns["thigh" + tag], turns["shin" + tag] = bend_leg(joints, tag, hip, ankle)
        turns["foot" + tag] = pitch(foot)
        turns["toe" + tag] = pitch(toe)
    return Cycle(turns, shift, stride)


def idle_cycle(joints: dict, period: int) -> Cycle:
    """Return a skeleton that stands and waits: it breathes, shifts its weight, looks about.

    Both feet stay where they are at rest. joints, period: as for walk_cycle.
    """
    phase = np.arange(period + 1) % period / period
    k = joints["head"][2][2] / 1.75
    sway = np.sin(2 * np.pi * phase)
    breath = np.sin(6 * np.pi * phase)
    zero = np.zeros_like(phase)
    hips = yaw(np.radians(3) * sway) @ roll(np.radians(1.5) * sway)
    turns = {
        "hips": hips,
        "spine": roll(np.radians(-1) * sway) @ pitch(zero + np.radians(1)),
        "chest": yaw(np.radians(4) * sway) @ pitch(np.radians(2) + np.radians(0.8) * breath),
        "neck": yaw(np.radians(10) * np.sin(4 * np.pi * phase)),
        "head": yaw(np.radians(24) * np.sin(4 * np.pi * phase))
        @ pitch(np.radians(4) * np.cos(2 * np.pi * phase)),
    }
    for tag, side in ((".L", 1), (".R", -1)):
        shoulder = turns["chest"] @ pitch(np.radians(2) * breath)
        turns["upper_arm" + tag] = shoulder @ roll(zero + side * np.radians(-24))
        turns["forearm" + tag] = (
            shoulder @ pitch(zero - np.radians(22)) @ roll(zero + side * np.radians(-28))
        )
        turns["hand" + tag] = (
            shoulder @ pitch(zero - np.radians(28)) @ roll(zero + side * np.radians(-30))
        )
    ankles = {tag: np.tile(joints["foot" + tag][1], (period + 1, 1)) for tag in (".L", ".R")}
    shift = np.stack([0.006 * k * breath, 0.03 * k * sway, zero], 1)
    shift[:, 2] -= (
        max(overreach(joints, tag, hips, shift, ankle) for tag, ankle in ankles.items()) + 0.01 * k
    )
    put_feet(joints, turns, shift, ankles)
    return Cycle(turns, shift, 0.0)


def sit_cycle(joints: dict, period: int) -> Cycle:
    """Return a skeleton that sits on a bench: it breathes and looks about, as in idle_cycle.

    The hips are above the origin, the feet before it; short legs hang. joints, period: as for
    walk_cycle.
    """
    waits = idle_cycle(joints, period)
    zero = np.zeros(period + 1)
    turns = waits.turns | {"hips": yaw(zero), "spine": pitch(zero - np.radians(4))}
    for tag, side in ((".L", 1), (".R", -1)):
        turns["upper_arm" + tag] = pitch(zero - np.radians(22)) @ roll(
            zero + side * np.radians(-24)
        )
        for bone in ("forearm", "hand"):
            inward = roll(zero + side * np.radians(-46))
            turns[bone + tag] = pitch(zero - np.radians(62)) @ inward
    _, hip, knee = joints["thigh.L"]
    # the thigh's half thickness is about a fifth of its length
    shift = np.zeros((period + 1, 3))
    shift[:, 2] = max(SEAT + 0.2 * (hip[2] - knee[2]), knee[2]) - hip[2]
    shin = leg_lengths(joints, ".L")[1]
    hangs = max(0.0, (hip + shift[0])[2] - 0.99 * shin - joints["foot.L"][1][2])
    put_feet(joints, turns, shift, feet_before(joints, period, hangs))
    return Cycle(turns, shift, 0.0)


def cheer_cycle(joints: dict, period: int) -> Cycle:
    """Return a skeleton that has stood up from sit_cycle, throws up its arms and bounces.

    Its feet stay where they are while it sits, on the ground. joints, period: as for walk_cycle.
    """
    phase = np.arange(period + 1) % period / period
    k = joints["head"][2][2] / 1.75
    beat = np.cos(2 * np.pi * phase)
    zero = np.zeros_like(phase)
    turns = {
        "hips": yaw(zero),
        "spine": pitch(zero - np.radians(2)),
        "chest": pitch(np.radians(-3) - np.radians(3) * beat),
        "neck": pitch(zero - np.radians(4)),
        "head": pitch(np.radians(-6) + np.radians(5) * beat),
    }
    for tag, side in ((".L", 1), (".R", -1)):
        up = pitch(np.radians(-150) - np.radians(14) * beat)
        turns["upper_arm" + tag] = up @ roll(zero + side * np.radians(-10))
        for bone in ("forearm", "hand"):
            bent = pitch(np.radians(-168) - np.radians(8) * beat)
            turns[bone + tag] = bent @ roll(zero + side * np.radians(-22))
    ankles = feet_before(joints, period, 0.0)
    shift = np.stack([ankles[".L"][:, 0], zero, 0.03 * k * (beat - 1)], 1)
    shift[:, 2] -= max(overreach(joints, tag, turns["hips"], shift, ankles[tag]) for tag in ankles)
    put_feet(joints, turns, shift, ankles)
    return Cycle(turns, shift, 0.0)


def feet_before(joints: dict, period: int, up: float) -> dict[str, np.ndarray]:
    """Return each ankle's places (period + 1, 3) while its owner sits, `up` meters above rest."""
    ahead = (0.9 * leg_lengths(joints, ".L")[0], 0.0, up)
    return {tag: np.tile(joints["foot" + tag][1] + ahead, (period + 1, 1)) for tag in (".L", ".R")}


def put_feet(joints: dict, turns: dict, shift: np.ndarray, ankles: dict[str, np.ndarray]) -> None:
    """Add to `turns` those of the legs, which bring the ankles to their places, feet level."""
    for tag, ankle in ankles.items():
        hip = hip_joint(joints, tag, turns["hips"], shift)
        turns["thigh" + tag], turns["shin" + tag] = bend_leg(joints, tag, hip, ankle)
        turns["foot" + tag] = turns["toe" + tag] = pitch(np.zeros(len(ankle)))


def foot_path(joints: dict, tag: str, phase: np.ndarray, stride: float):
    """Return the ankle's places (n, 3), and the pitches of foot and toes (n,).

    Pitches are in radians, toes down positive.
    phase: (n,) in [0, 1), 0 when this foot's heel strikes.
    """
    _, ankle, ball = joints["foot" + tag]
    ankle = ankle[[0, 2]]
    ball = np.array([ball[0], 0.0])
    heel = np.array([-0.24 * ball[0], 0.0])
    toes = joints["toe" + tag][2][0] - ball[0]

    times = [0, FLAT, HEEL_OFF, STANCE, 0.70, 0.88, 1]
    degrees = [STRIKE_PITCH, 0, 0, LEAVE_PITCH, LEAVE_PITCH + 4, -8, STRIKE_PITCH]
    foot = np.radians(ease(phase, times, degrees))
    toe = np.where(phase < HEEL_OFF, foot, 0.0)
    relax = ease(phase, [STANCE, 0.78], [0, 1])
    toe = np.where(phase > STANCE, foot * relax, toe)

    def turned(point, angle=foot):  # a point of the foot, from the ankle, (..., 2)
        x, z = point - ankle
        return np.stack(
            [x * np.cos(angle) + z * np.sin(angle), z * np.cos(angle) - x * np.sin(angle)], -1
        )

    # The foot's place is the ground's under its rest place: it moves at a constant speed while the
    # foot stands, and the foot rolls about its heel or its ball, which stay put on that ground.
    place = stride * (STRIKE - np.minimum(phase, STANCE))
    rolled = np.where(phase < FLAT, (turned(heel) - heel)[:, 0], (turned(ball) - ball)[:, 0])
    start = stride * (STRIKE - STANCE) - (turned(ball, np.radians(LEAVE_PITCH)) - ball)[0]
    end = stride * STRIKE - (turned(heel, np.radians(STRIKE_PITCH)) - heel)[0]
    t = np.clip((phase - STANCE) / (1 - STANCE), 0, 1)
    # still going back as it leaves, and a little as it comes down
    slope = -0.55 * stride * (1 - STANCE)
    flight = hermite(t, start, end, slope, 0.5 * slope)
    x = np.where(phase > STANCE, flight, place - rolled)

    tip = turned(ball)[:, 1] - toes * np.sin(toe)
    lowest = np.minimum(np.minimum(turned(ball)[:, 1], turned(heel)[:, 1]), tip)
    clearance = 0.022 * (ankle[1] / 0.075) * np.sin(np.pi * t) ** 2
    y = np.full_like(x, 0.8 * joints["foot" + tag][1][1])
    return np.stack([x, y, clearance - lowest], 1), foot, toe


def hip_joint(joints: dict, tag: str, hips: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return the place of the hip joint, (n, 3)."""
    root = joints["hips"][1]
    return root + shift + hips @ (joints["thigh" + tag][1] - root)


def leg_lengths(joints: dict, tag: str) -> tuple[float, float]:
    _, hip, knee = joints["thigh" + tag]
    return np.linalg.norm(knee - hip), np.linalg.norm(joints["shin" + tag][2] - knee)


def overreach(joints, tag, hips, shift, ankle) -> float:
    """Return how far the hips must come down so that the leg always reaches."""
    way = hip_joint(joints, tag, hips, shift) - ankle
    limit = REACH * sum(leg_lengths(joints, tag))
    return float((way[:, 2] - np.sqrt(limit**2 - way[:, 0] ** 2 - way[:, 1] ** 2)).max())


def bend_leg(joints, tag, hip, ankle) -> tuple[np.ndarray, np.ndarray]:
    """Return the turns of thigh and shin that bring the ankle to its place.

    The knee is in front. Solved by the law of cosines.
    """
    thigh, shin = leg_lengths(joints, tag)
    way = ankle - hip
    distance = np.linalg.norm(way, axis=1)
    way /= distance[:, None]
    side = unit(np.cross([1.0, 0, 0], way))
    front = np.cross(way, side)  # at right angles to the way, in the leg's plane
    front *= np.sign(front[:, [0]])
    along = (thigh**2 - shin**2 + distance**2) / (2 * distance)
    knee = hip + way * along[:, None] + front * np.sqrt(thigh**2 - along**2)[:, None]
    _, hip0, knee0 = joints["thigh" + tag]
    ankle0 = joints["shin" + tag][2]
    lateral = np.array([0, 1.0, 0])
    return (
        frame(knee - hip, side) @ frame(knee0 - hip0, lateral).T,
        frame(ankle - knee, side) @ frame(ankle0 - knee0, lateral).T,
    )


def frame(axis, side) -> np.ndarray:
    """Return (..., 3, 3) with columns axis, perpendicular side, and the third."""
    axis = unit(axis)
    side = unit(side - axis * (side * axis).sum(-1, keepdims=True))
    return np.stack([axis, side, np.cross(axis, side)], -1)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def hermite(t, a, b, slope_a, slope_b):
    """Return values from a to b with these slopes at the ends, for t from 0 to 1."""
    return (
        (2 * t**3 - 3 * t**2 + 1) * a + (t**3 - 2 * t**2 + t) * slope_a
        + (3 * t**2 - 2 * t**3) * b + (t**3 - t**2) * slope_b
    )  # fmt: skip


def ease(phase, times, values):
    """Return smooth steps from value to value, level at each."""
    i = np.clip(np.searchsorted(times, phase, side="right") - 1, 0, len(times) - 2)
    times = np.asarray(times)
    values = np.asarray(values, float)
    t = np.clip((phase - times[i]) / (times[i + 1] - times[i]), 0, 1)
    return values[i] + (values[i + 1] - values[i]) * t * t * (3 - 2 * t)


def pitch(angle):
    """Return turns about +y: forward and down is positive."""
    return rotation(angle, 2, 0)


def roll(angle):
    """Return turns about +x: the left side up is positive."""
    return rotation(angle, 1, 2)


def yaw(angle):
    """Return turns about +z: to the left is positive."""
    return rotation(angle, 0, 1)


def rotation(angle, i: int, j: int) -> np.ndarray:
    """Return (n, 3, 3) turns of axis i toward axis j by (n,) radians."""
    matrix = np.zeros((len(angle), 3, 3))
    matrix[:, range(3), range(3)] = 1
    matrix[:, i, i] = matrix[:, j, j] = np.cos(angle)
    matrix[:, j, i] = np.sin(angle)
    matrix[:, i, j] = -np.sin(angle)
    return matrix
