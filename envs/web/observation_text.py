"""An agent's observation as text."""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from outlast.ecs import Field, Fields, columns_of

from ..core.validation import Array

Lines = dict[str, list[str]]

HEADINGS = {"box_items": "Broken boxes"}  # others are called like their keys
ZONE = ("x", "y", "radius", "next_x", "next_y", "next_radius")
MOTION = ("x", "y", "angle", "vx", "vy", "omega")
PLACED = {"id", "team", *MOTION}  # fields that are described in words
HANDLED = {"own", "others", "zone", "lidar", "heal_slot", "box_slot"}
FEW = 4  # an observation of a user's mechanic gets a line if it has at most this many numbers
RAYS = 32  # up to this many rays, all are written; of more, only the shortest and the longest


class Viewpoint:
    """An agent, its position and its heading. row: one of `own` or `others`, with these fields; roles: their names."""

    def __init__(self, row: Array, fields: Mapping[str, Field], roles: Sequence[str]) -> None:
        self.id, self.x, self.y, self.angle = _values(row, fields, "id", "x", "y", "angle")
        self.team = row[fields["team"].start] if "team" in fields else None
        shown = row[fields["role"].columns] if "role" in fields and roles else np.zeros(1)
        self.role = roles[int(shown.argmax())] if shown.any() else ""
        self.rest = {
            name: ", ".join(f"{round(float(value), 2):g}" for value in row[field.columns])
            for name, field in fields.items()
            if name not in PLACED and field.size <= FEW and not (name == "role" and roles)
        }

    def distance(self, x: float, y: float) -> float:
        """Return the metres to a point."""
        return math.hypot(x - self.x, y - self.y)

    def direction(self, x: float, y: float) -> str:
        """Return the distance to a point and its bearing, in words."""
        return f"{self.distance(x, y):.1f} m {self.bearing(x, y)}"

    def bearing(self, x: float, y: float) -> str:
        """Return the direction of a point, relative to the agent's heading, in words."""
        angle = math.degrees(math.atan2(y - self.y, x - self.x) - self.angle)
        degrees = round((angle + 180) % 360 - 180)
        if abs(degrees) <= 2:
            return "ahead"
        return "behind" if abs(degrees) >= 178 else f"{abs(degrees)}° {'left' if degrees > 0 else 'right'}"


def observation_text(observation: Mapping[str, Array], fields: Fields, roles: Sequence[str] = ()) -> Lines:
    """Return lines of text by heading. observation: What one agent observes, float32 arrays by key.

    Rows with a place are counted; other observations, and fields of agents, are written if they are short. Velocities
    and the outlines of boxes are left out.
    """
    own = observation["own"]
    living = [name for name in ("health", *MOTION) if name in fields["own"]]
    if not own[columns_of(fields["own"], *living)].any():
        return {"Health" if "health" in living else "Agent": ["dead"]}
    viewpoint = Viewpoint(own, fields["own"], roles)
    lines: Lines = {_heading(name): [words] for name, words in viewpoint.rest.items()}
    if viewpoint.role:
        lines["Role"] = [viewpoint.role]
    if "heal_slot" in observation or "box_slot" in observation:
        lines["Next item"] = list(_slots(observation, fields)) or ["none"]
    if "zone" in observation:
        lines["Zone"] = list(_zone(viewpoint, *_values(observation["zone"], fields["zone"], *ZONE)))
    if "lidar" in observation:
        lines["Lidar"] = [_rays(observation["lidar"][fields["lidar"]["distance"].columns])]
    others = observation["others"][observation["others_mask"] > 0]
    lines |= _agents(viewpoint, [Viewpoint(row, fields["others"], roles) for row in others])
    for key, values in observation.items():
        if key in HANDLED or key.endswith("_mask"):
            continue
        if f"{key}_mask" in observation and {"x", "y"} <= fields.get(key, {}).keys():
            places = values[observation[f"{key}_mask"] > 0][:, columns_of(fields[key], "x", "y")]
            near = min(places, key=lambda place: viewpoint.distance(*place), default=None)
            words = "none in sight" if near is None else f"{len(places)} in sight, nearest {viewpoint.direction(*near)}"
            lines[_heading(key)] = [words]
        elif values.size <= FEW:
            lines[_heading(key)] = [", ".join(f"{value:g}" for value in values.ravel())]
    return lines


def _heading(name: str) -> str:
    return HEADINGS.get(name, name.replace("_", " ").capitalize())


def _slots(observation: Mapping[str, Array], fields: Fields) -> Iterator[str]:
    if "heal_slot" in observation and observation["heal_slot_mask"][0] > 0:
        yield f"heal, +{observation['heal_slot'][0, fields['heal_slot']['amount'].start]:.0f}"
    if "box_slot" in observation and observation["box_slot_mask"][0] > 0:
        vertices = observation["box_slot"][0, fields["box_slot"]["vertices"].columns]
        width, height = np.ptp(vertices.reshape(4, 2), axis=0)
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


def _rays(distances: Array) -> str:
    if not distances.any():
        return "blind"
    if len(distances) > RAYS:
        return f"{distances.min():.1f} to {distances.max():.1f} m along {len(distances)} rays"
    return f"{' '.join(f'{distance:.1f}' for distance in distances)} m, from right to left"


def _agents(viewpoint: Viewpoint, others: list[Viewpoint]) -> Lines:
    """Return lines about enemies and, with teams, about friends, the nearest first."""
    lines: Lines = {heading: [] for heading in ("Enemies", "Friends")[: 1 if viewpoint.team is None else 2]}
    for other in sorted(others, key=lambda other: viewpoint.distance(other.x, other.y)):
        heading = "Friends" if viewpoint.team is not None and other.team == viewpoint.team else "Enemies"
        lines[heading].append(
            ", ".join(
                [f"agent {other.id:.0f}: {viewpoint.direction(other.x, other.y)}"]
                + [f"{name.replace('_', ' ')} {words}" for name, words in other.rest.items()]
                + [other.role] * (other.role != "")
            )
        )
    return {heading: found or ["none in sight"] for heading, found in lines.items()}


def _values(row: Array, fields: Mapping[str, Field], *names: str) -> Iterator[float]:
    return (float(row[fields[name].start]) for name in names)
