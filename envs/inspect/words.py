"""An agent's observation in words: what it is told, and nothing else."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
Lines = dict[str, list[str]]

ROW = 8  # features of an agent's row without its team
VERTICES = 8  # numbers before the place of a box
THINGS = {"heals": ("Heals", 0), "boxes": ("Boxes", VERTICES), "box_items": ("Broken boxes", VERTICES)}
WORDED = {"self", "others", "zone", "heal_slot", "box_slot", *THINGS}
FEW = 4  # numbers of an observation of other mechanics that still make a line


class Eye:
    """Where an agent is and faces. row: id, [team], health, x, y, angle, velocities."""

    def __init__(self, row: Array) -> None:
        self.team = int(row[1]) if len(row) > ROW else None
        self.health, self.x, self.y, self.angle = (float(value) for value in row[-7:-3])

    def distance(self, x: float, y: float) -> float:
        """Metres to a point."""
        return math.hypot(x - self.x, y - self.y)

    def to(self, x: float, y: float) -> str:
        """How far that is, and in which direction from where the agent faces."""
        return f"{self.distance(x, y):.1f} m {self.bearing(x, y)}"

    def bearing(self, x: float, y: float) -> str:
        """The direction alone."""
        angle = math.degrees(math.atan2(y - self.y, x - self.x) - self.angle)
        degrees = round((angle + 180) % 360 - 180)
        if abs(degrees) <= 2:
            return "ahead"
        return "behind" if abs(degrees) >= 178 else f"{abs(degrees)}° {'left' if degrees > 0 else 'right'}"


def tell(seen: Mapping[str, Array]) -> Lines:
    """Lines by heading. seen: what one agent observes, by key, float32.

    Keys of other mechanics get a line if they are short. Velocities and the outlines of boxes get none.
    """
    if not seen["self"][-7:].any():
        return {"Health": ["dead"]}
    eye = Eye(seen["self"])
    lines = {"Health": [f"{eye.health:.0f}"]}
    if "heal_slot" in seen or "box_slot" in seen:
        lines["Next item"] = list(_slots(seen)) or ["none"]
    if "zone" in seen:
        lines["Zone"] = list(_zone(eye, *(float(value) for value in seen["zone"])))
    lines |= _agents(eye, seen["others"][seen["others_mask"] > 0])
    for key, (heading, column) in THINGS.items():
        if key in seen:
            lines[heading] = _things(eye, seen[key][seen[f"{key}_mask"] > 0][:, column : column + 2])
    return lines | dict(_rest(seen))


def _slots(seen: Mapping[str, Array]) -> Iterator[str]:
    if "heal_slot" in seen and seen["heal_slot_mask"][0] > 0:
        yield f"heal, +{seen['heal_slot'][0, 0]:.0f}"
    if "box_slot" in seen and seen["box_slot_mask"][0] > 0:
        width, height = np.ptp(seen["box_slot"][0].reshape(4, 2), axis=0)
        yield f"box, {width:.1f} × {height:.1f} m"


def _zone(eye: Eye, x: float, y: float, radius: float, *after: float) -> Iterator[str]:
    if radius <= 0:
        yield "nowhere is safe"
        return
    left = radius - eye.distance(x, y)
    yield f"inside, {left:.1f} m to the edge" if left >= 0 else f"outside by {-left:.1f} m, {eye.bearing(x, y)}"
    x, y, radius = after
    left = radius - eye.distance(x, y)
    if radius <= 0:
        yield f"it vanishes next, {eye.to(x, y)}"
    else:
        yield f"next: inside, {left:.1f} m" if left >= 0 else f"next: {-left:.1f} m away, {eye.bearing(x, y)}"


def _agents(eye: Eye, rows: Array) -> Lines:
    """Enemies, and friends where there are teams, nearest first."""
    lines: Lines = {heading: [] for heading in ("Enemies", "Friends")[: 1 if eye.team is None else 2]}
    for row in sorted(rows, key=lambda row: eye.distance(*row[-6:-4])):
        other = Eye(row)
        heading = "Friends" if eye.team is not None and other.team == eye.team else "Enemies"
        lines[heading].append(f"agent {row[0]:.0f}: {eye.to(other.x, other.y)}, health {other.health:.0f}")
    return {heading: found or ["none in sight"] for heading, found in lines.items()}


def _things(eye: Eye, places: Array) -> list[str]:
    if not len(places):
        return ["none in sight"]
    nearest = min(places, key=lambda place: eye.distance(*place))
    return [f"{len(places)} in sight, nearest {eye.to(*nearest)}"]


def _rest(seen: Mapping[str, Array]) -> Iterator[tuple[str, list[str]]]:
    """What other mechanics tell."""
    for key, values in seen.items():
        if key not in WORDED and not key.endswith("_mask") and values.size <= FEW:
            yield key.replace("_", " ").capitalize(), [", ".join(f"{value:g}" for value in values.ravel())]
