"""Simulates the walkers of the sample scene "station" by JuPedSim, and writes station.npz.

    .venv-3.13/bin/python -m crowd_lod_extension.sample_scenes.station_tracks

The scene needs that file alone, not JuPedSim. Concourse and upper floor are two simulations in
step: people who come to the stairs' end in one of them go on in the other.
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
# Before the stairs the floors overlap. In FOOT people leave the concourse for the stairs, in BOTTOM
# the stairs for the concourse.
APRON = (-5.2, 6.0, -3.0, 9.0)
FOOT = (-4.0, 6.4, -3.1, 8.6)
BOTTOM = (-5.2, 6.3, -4.6, 8.7)


class Floor:
    """One simulation, the places where people leave it, and the people in it."""

    def __init__(self, ground: shapely.Polygon, exits: tuple) -> None:
        self.simulation = jupedsim.Simulation(
            model=jupedsim.CollisionFreeSpeedModel(), geometry=ground, dt=1 / (FPS * STEPS)
        )
        self.ground = ground
        self.stages = [self.simulation.add_exit_stage(shapely.box(*area)) for area in exits]
        self.journeys = [
            self.simulation.add_journey(jupedsim.JourneyDescription([stage]))
            for stage in self.stages
        ]
        # by JuPedSim's id: (person, where to, speed)
        self.people: dict[int, tuple[int, int, float]] = {}

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
        """Walk on, and return (place, person, where to, speed) of those who have left."""
        before = {agent.id: np.array(agent.position) for agent in self.simulation.agents()}
        self.simulation.iterate()
        left = before.keys() - {agent.id for agent in self.simulation.agents()}
        return [(before[agent], *self.people.pop(agent)) for agent in sorted(left)]


class Station:
    """Both floors, the people between them, and how many there have been.

    between: of each, (floor, place, person, where to, speed), until there is room.
    """

    def __init__(self, draws: np.random.Generator) -> None:
        stairs = shapely.box(*site.STAIRS)
        landing = shapely.box(*site.LANDING)
        blocks = (site.KIOSK, *site.WAITING, *site.COLUMNS)
        walls = shapely.union_all([stairs, landing, *(shapely.box(*block) for block in blocks)])
        railing = shapely.box(APRON[0], 8.9, site.STAIRS[2], 9.1)
        gallery = shapely.box(*site.GALLERY)
        upstairs = shapely.union_all([shapely.box(*APRON), stairs, landing, gallery]) - railing
        self.draws = draws
        self.lower = Floor(shapely.box(*site.CONCOURSE) - walls, (*site.DOORS, FOOT))
        self.upper = Floor(upstairs, (*site.UPPER_DOORS, BOTTOM))
        self.between: list[tuple[Floor, np.ndarray, int, int, float]] = []
        self.count = 0

    def let_in(self) -> None:
        """Let someone in at a door, if there are few people and there is room."""
        draws = self.draws
        if len(self.lower.people) + len(self.upper.people) >= COUNT:
            return
        floor = self.lower
        doors = site.DOORS
        if draws.random() >= 0.8:
            floor = self.upper
            doors = site.UPPER_DOORS
        door = draws.integers(len(doors))
        goal = draws.integers(len(doors))
        if draws.random() < TO_STAIRS:
            goal = len(doors)
        if goal == door:
            return
        place = _in(doors[door], draws)
        self.count += floor.enter(place, self.count, goal, draws.normal(1.34, 0.2))

    def step(self) -> None:
        """Walk on, on both floors; people at the stairs' end begin to go over."""
        for floor, other, doors in (
            (self.lower, self.upper, site.DOORS),
            (self.upper, self.lower, site.UPPER_DOORS),
        ):
            for place, person, goal, speed in floor.step():
                if goal == len(doors):
                    new_goal = int(self.draws.integers(len(other.stages) - 1))
                    self.between.append((other, place, person, new_goal, speed))

    def go_over(self) -> None:
        """Let people between the floors in where there is room, and slow down those on stairs."""
        self.between = [entry for entry in self.between if not entry[0].enter(*entry[1:])]
        for agent in self.upper.simulation.agents():
            x, y = agent.position
            on_stairs = x < site.STAIRS[2] and y < site.STAIRS[3]
            speed = self.upper.people[agent.id][2]
            agent.model.desired_speed = (ON_STAIRS if on_stairs else 1.0) * speed

    def rows(self, frame: int) -> list[tuple]:
        """(person, frame, x, y, z) of everyone, in meters."""
        rows = []
        for floor in (self.lower, self.upper):
            for agent in floor.simulation.agents():
                x, y = agent.position
                z = 0.0
                if floor is self.upper:
                    z = site.HEIGHT
                    if y < site.GALLERY[1]:
                        z = float(site.height_on_stairs(np.array(x)))
                rows.append((floor.people[agent.id][0], frame, x, y, z))
        return rows


def simulate(seed: int = 3) -> dict[str, np.ndarray]:
    """Return the columns of the walkers' tracks, in centimeters, by their names in the file.

    See crowd_lod/tracks/reading.py.
    """
    station = Station(np.random.default_rng(seed))
    rows = []
    for frame in range(-WARM_UP, FRAMES + 1):
        station.let_in()
        for _ in range(STEPS):
            station.step()
        station.go_over()
        if frame >= 0 and frame % EVERY == 0:
            rows += station.rows(frame + 1)
    person, frame, *place = np.array(sorted(rows)).T
    _, number = np.unique(person, return_inverse=True)
    x, y, z = (np.rint(100 * coordinate) for coordinate in place)
    columns = {"id": number, "frame": frame, "x": x, "y": y, "z": z}
    return {name: values.astype(np.int16) for name, values in columns.items()}


def _in(area: tuple, draws: np.random.Generator) -> np.ndarray:
    return draws.uniform(area[:2], area[2:])


if __name__ == "__main__":
    columns = simulate()
    np.savez_compressed(FILE, fps=FPS, unit="cm", **columns)
    print(
        f"{FILE.name}: {columns['id'].max() + 1} people, {len(columns['id']):,} rows, "
        f"{FILE.stat().st_size:,} bytes"
    )
