"""An agent's observation as text: what it contains, and nothing else."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
Lines = dict[str, list[str]]

ROW = 8  # features of an agent's row without its team
VERTICES = 8  # numbers before the place of a box
GROUPS = {"heals": ("Heals", 0), "boxes": ("Boxes", VERTICES), "box_items": ("Broken boxes", VERTICES)}
HANDLED = {"own", "others", "zone", "heal_slot", "box_slot", *GROUPS}
FEW = 4  # numbers of an observation of other mechanics that still make a line


class Viewpoint:
    """Where an agent is and faces. row: id, [team], health, x, y, angle, velocities."""

    def __init__(self, row: Array) -> None:
        self.team = int(row[1]) if len(row) > ROW else None
        self.health, self.x, self.y, self.angle = (float(value) for value in row[-7:-3])

    def distance(self, x: float, y: float) -> float:
        """Metres to a point."""
        return math.hypot(x - self.x, y - self.y)

    def direction(self, x: float, y: float) -> str:
        """How far that is, and in which direction from where the agent faces."""
        return f"{self.distance(x, y):.1f} m {self.bearing(x, y)}"

    def bearing(self, x: float, y: float) -> str:
        """The direction alone."""
        angle = math.degrees(math.atan2(y - self.y, x - self.x) - self.angle)
        degrees = round((angle + 180) % 360 - 180)
        if abs(degrees) <= 2:
            return "ahead"
        return "behind" if abs(degrees) >= 178 else f"{abs(degrees)}° {'left' if degrees > 0 else 'right'}"


def observation_text(observation: Mapping[str, Array]) -> Lines:
    """Lines of text by heading. observation: of one agent, float32 arrays by key.

    Keys of other mechanics get a line if they are short. Velocities and the outlines of boxes get none.
    """
    if not observation["own"][-7:].any():
        return {"Health": ["dead"]}
    viewpoint = Viewpoint(observation["own"])
    lines = {"Health": [f"{viewpoint.health:.0f}"]}
    if "heal_slot" in observation or "box_slot" in observation:
        lines["Next item"] = list(_slots(observation)) or ["none"]
    if "zone" in observation:
        lines["Zone"] = list(_zone(viewpoint, *(float(value) for value in observation["zone"])))
    lines |= _agents(viewpoint, observation["others"][observation["others_mask"] > 0])
    for key, (heading, column) in GROUPS.items():
        if key in observation:
            rows = observation[key][observation[f"{key}_mask"] > 0]
            lines[heading] = _nearest(viewpoint, rows[:, column : column + 2])
    return lines | dict(_rest(observation))


def _slots(observation: Mapping[str, Array]) -> Iterator[str]:
    if "heal_slot" in observation and observation["heal_slot_mask"][0] > 0:
        yield f"heal, +{observation['heal_slot'][0, 0]:.0f}"
    if "box_slot" in observation and observation["box_slot_mask"][0] > 0:
        width, height = np.ptp(observation["box_slot"][0].reshape(4, 2), axis=0)
        yield f"box, {width:.1f} × {height:.1f} m"


def _zone(viewpoint: Viewpoint, x: float, y: float, radius: float, *after: float) -> Iterator[str]:
    if radius <= 0:
        yield "nowhere is safe"
        return
    left = radius - viewpoint.distance(x, y)
    yield f"inside, {left:.1f} m to the edge" if left >= 0 else f"outside by {-left:.1f} m, {viewpoint.bearing(x, y)}"
    x, y, radius = after
    left = radius - viewpoint.distance(x, y)
    if radius <= 0:
        yield f"it vanishes next, {viewpoint.direction(x, y)}"
    else:
        yield f"next: inside, {left:.1f} m" if left >= 0 else f"next: {-left:.1f} m away, {viewpoint.bearing(x, y)}"


def _agents(viewpoint: Viewpoint, rows: Array) -> Lines:
    """Enemies, and friends where there are teams, nearest first."""
    lines: Lines = {heading: [] for heading in ("Enemies", "Friends")[: 1 if viewpoint.team is None else 2]}
    for row in sorted(rows, key=lambda row: viewpoint.distance(*row[-6:-4])):
        other = Viewpoint(row)
        heading = "Friends" if viewpoint.team is not None and other.team == viewpoint.team else "Enemies"
        lines[heading].append(f"agent {row[0]:.0f}: {viewpoint.direction(other.x, other.y)}, health {other.health:.0f}")
    return {heading: found or ["none in sight"] for heading, found in lines.items()}


def _nearest(viewpoint: Viewpoint, places: Array) -> list[str]:
    if not len(places):
        return ["none in sight"]
    nearest = min(places, key=lambda place: viewpoint.distance(*place))
    return [f"{len(places)} in sight, nearest {viewpoint.direction(*nearest)}"]


def _rest(observation: Mapping[str, Array]) -> Iterator[tuple[str, list[str]]]:
    """Observations of other mechanics."""
    for key, values in observation.items():
        if key not in HANDLED and not key.endswith("_mask") and values.size <= FEW:
            yield key.replace("_", " ").capitalize(), [", ".join(f"{value:g}" for value in values.ravel())]
