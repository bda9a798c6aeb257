"""Simulates the walkers of the sample scene "station" by JuPedSim, and writes station.npz.

    .venv-3.13/bin/python -m crowd_lod_extension.sample_scenes.station_tracks

The scene needs that file alone, not JuPedSim. Concourse and upper floor are two simulations in
step: who comes to the stairs' end in one of them goes on in the other.
"""

from pathlib import Path

import jupedsim
import numpy as np
import shapely

from . import station_plan as site

FILE = Path(__file__).with_name("station.npz")
# of the scene, and of the simulation in a frame
FPS = 24
STEPS = 2
EVERY = 4  # frames between two rows
# frames before the shot, and in it
WARM_UP = 60 * FPS
FRAMES = 240
TO_STAIRS = 0.08  # part of the people
COUNT = 260  # people are let in while there are fewer
# meters, seconds, part of the speed
RADIUS = 0.2
TIME_GAP = 1.0
ON_STAIRS = 0.55
# Before the stairs the floors overlap: one goes over from the concourse in FOOT, and to it in
# BOTTOM.
APRON = (-5.2, 6.0, -3.0, 9.0)
FOOT = (-4.0, 6.4, -3.1, 8.6)
BOTTOM = (-5.2, 6.3, -4.6, 8.7)


class Floor:
    """One simulation, the places where one leaves it, and the people in it."""

    def __init__(self, ground: shapely.Polygon, exits: tuple) -> None:
        self.simulation = jupedsim.Simulation(
            model=jupedsim.CollisionFreeSpeedModel(), geometry=ground, dt=1 / (FPS * STEPS)
        )
        self.ground = ground
        self.stages = [self.simulation.add_exit_stage(shapely.box(*each)) for each in exits]
        self.journeys = [
            self.simulation.add_journey(jupedsim.JourneyDescription([stage]))
            for stage in self.stages
        ]
        self.people: dict[
            int, tuple[int, int, float]
        ] = {}  # by JuPedSim's id: (person, where to, speed)

    def enter(self, place: np.ndarray, person: int, goal: int, speed: float) -> bool:
        """Let a person in; return whether there is room."""
        inside = self.ground.contains(shapely.Point(place).buffer(RADIUS + 0.05))
        if not inside or any(
            np.hypot(*(np.array(other.position) - place)) < 0.5
            for other in self.simulation.agents()
        ):
            return False
        parameters = jupedsim.CollisionFreeSpeedModelAgentParameters(
            position=tuple(place), desired_speed=speed, radius=RADIUS, time_gap=TIME_GAP,
            journey_id=self.journeys[goal], stage_id=self.stages[goal],
        )  # fmt: skip
        self.people[self.simulation.add_agent(parameters)] = person, goal, speed
        return True

    def step(self) -> list[tuple[np.ndarray, int, int, float]]:
        """Walk on, and return (place, person, where to, speed) of who has left."""
        before = {agent.id: np.array(agent.position) for agent in self.simulation.agents()}
        self.simulation.iterate()
        left = before.keys() - {agent.id for agent in self.simulation.agents()}
        return [(before[agent], *self.people.pop(agent)) for agent in sorted(left)]


def simulate(seed: int = 3) -> dict[str, np.ndarray]:
    """Return the columns of the walkers' tracks, in centimeters, by their names in the file.

    See crowd_lod/tracks/npz.py.
    """
    draws = np.random.default_rng(seed)
    stairs = shapely.box(*site.STAIRS)
    landing = shapely.box(*site.LANDING)
    blocks = [shapely.box(*rectangle) for rectangle in (site.KIOSK, *site.WAITING, *site.COLUMNS)]
    lower = Floor(
        shapely.box(*site.CONCOURSE) - shapely.union_all([stairs, landing, *blocks]),
        (*site.DOORS, FOOT),
    )
    railing = shapely.box(APRON[0], 8.9, site.STAIRS[2], 9.1)
    upper = Floor(
        shapely.union_all([shapely.box(*APRON), stairs, landing, shapely.box(*site.GALLERY)])
        - railing,
        (*site.UPPER_DOORS, BOTTOM),
    )
    waiting: list[tuple[Floor, np.ndarray, int, int, float]] = []  # between the floors
    rows = []
    count = 0
    for frame in range(-WARM_UP, FRAMES + 1):
        if len(lower.people) + len(upper.people) < COUNT:
            floor, doors = (
                (lower, site.DOORS) if draws.random() < 0.8 else (upper, site.UPPER_DOORS)
            )
            door = draws.integers(len(doors))
            goal = draws.integers(len(doors))
            if draws.random() < TO_STAIRS:
                goal = len(doors)
            if goal != door and floor.enter(
                _in(doors[door], draws), count, goal, draws.normal(1.34, 0.2)
            ):
                count += 1
        for _ in range(STEPS):
            for floor in (lower, upper):
                other, last = (
                    (upper, len(site.DOORS)) if floor is lower else (lower, len(site.UPPER_DOORS))
                )
                for place, person, goal, speed in floor.step():
                    if goal == last:
                        waiting.append(
                            (
                                other,
                                place,
                                person,
                                int(draws.integers(len(other.stages) - 1)),
                                speed,
                            )
                        )
        waiting = [(floor, *entry) for floor, *entry in waiting if not floor.enter(*entry)]
        for agent in upper.simulation.agents():
            slow = (
                ON_STAIRS
                if agent.position[0] < site.STAIRS[2] and agent.position[1] < site.STAIRS[3]
                else 1.0
            )
            agent.model.desired_speed = slow * upper.people[agent.id][2]
        if frame >= 0 and frame % EVERY == 0:
            for floor in (lower, upper):
                for agent in floor.simulation.agents():
                    x, y = agent.position
                    z = (
                        float(site.height_on_stairs(np.array(x)))
                        if y < site.GALLERY[1]
                        else site.HEIGHT
                    )
                    rows.append(
                        (floor.people[agent.id][0], frame + 1, x, y, z if floor is upper else 0.0)
                    )
    person, frame, *place = np.array(sorted(rows)).T
    _, number = np.unique(person, return_inverse=True)
    x, y, z = (np.rint(100 * coordinate) for coordinate in place)
    columns = {"id": number, "frame": frame, "x": x, "y": y, "z": z}
    return {name: values.astype(np.int16) for name, values in columns.items()}


def _in(area: tuple, draws: np.random.Generator) -> np.ndarray:
    return draws.uniform(area[:2], area[2:])


if __name__ == "__main__":
    made = simulate()
    np.savez_compressed(FILE, fps=FPS, unit="cm", **made)
    print(
        f"{FILE.name}: {made['id'].max() + 1} people, {len(made['id']):,} rows, "
        f"{FILE.stat().st_size:,} bytes"
    )
