"""What agents observe, as seen from where they stand and in the direction that they look.

An agent's actions are in its own frame (ahead, to the left, turn), but observations are in the room's, with angles that
grow with every turn. So a network would have to learn to subtract and to rotate before it could walk up to anything.
This module does both.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..base.errors import TrainingError
from ..base.observation_layout import OWN, ObservationLayout

Array = np.ndarray[Any, Any]
ANGLE = "angle"
VECTORS = {  # the fields of a vector: the first field of the agent's own vector that is subtracted from it
    ("x", "y"): "x",
    ("next_x", "next_y"): "x",
    ("vx", "vy"): "vx",
}
ME = ("x", "y", "vx", "vy", ANGLE)


class Egocentric:
    """Brings rows into the frame of the agent that observes: its place is the origin, and it looks along the x-axis.

    Places become relative to the agent's place, velocities to its velocity; of itself, the agent observes where the
    room's middle is, and its velocity. Angles of others become relative to its own, and all angles are brought into the
    range of -pi to pi.
    """

    def __init__(self, layout: ObservationLayout) -> None:
        """layout: Must have the fields of the agent's own place, velocity and angle; raises TrainingError if not."""
        columns = layout.field_columns()
        if not columns[OWN].keys() >= {*ME}:
            raise TrainingError(f"preset fast needs the fields {', '.join(ME)} of '{OWN}'; take another preset")
        self.me = np.array([columns[OWN][name] for name in ME])
        self.own, self.entities = Columns(), Columns()
        for key in layout.alone:
            factors = {"x": 2.0, "vx": 0.0, ANGLE: 0.0} if key == OWN else {}
            self.own.add(columns[key], 0, factors)
        for k, kind in enumerate(layout.kinds):
            self.entities.add(columns[kind.key], layout.columns - len(layout.kinds) + k, {})

    def __call__(self, own: Array, entities: Array, agent: Array) -> None:
        """Bring rows into the frames of their agents, in place.

        own: float32 (agents, layout.own), the agents' own numbers. entities: float32 (rows, layout.columns), as in
        Rows. agent: int (rows,), the agent that each row belongs to.
        """
        me = own[:, self.me]
        turn = np.cos(me[:, 4:]), np.sin(me[:, 4:])
        self.own.turn(own, me, turn, None)
        self.entities.turn(entities, me[agent], (turn[0][agent], turn[1][agent]), entities)


class Columns:
    """Where vectors and angles are in rows.

    vectors: The columns of x and y, the column that marks their kind, the index of their origin in ME, and how often
    that is subtracted. angles: The column, that of the kind, and how often the agent's angle is subtracted.
    """

    def __init__(self) -> None:
        self.vectors, self.angles = list[tuple[int, int, int, int, float]](), list[tuple[int, int, float]]()

    def add(self, columns: Mapping[str, int], kind: int, factors: Mapping[str, float]) -> None:
        """Add the vectors and angles among the fields of one kind of row.

        columns: The column of each field. kind: The column that is 1 in rows of the kind. factors: How often the
        agent's place, velocity or angle is subtracted, by field; once unless given.
        """
        self.vectors += [
            (columns[x], columns[y], kind, ME.index(origin), factors.get(x, 1.0))
            for (x, y), origin in VECTORS.items()
            if x in columns and y in columns
        ]
        if ANGLE in columns:
            self.angles.append((columns[ANGLE], kind, factors.get(ANGLE, 1.0)))

    def turn(self, values: Array, me: Array, turn: tuple[Array, Array], there: Array | None) -> None:
        """Bring the values into the frame of their agents, in place.

        Args:
            values: float32 (rows, columns).
            me: float32 (rows, len(ME)), the fields ME of the agent that each row belongs to.
            turn: Cosine and sine of the agent's angle, float32 (rows, 1) each.
            there: float32 (rows, columns), 1 in the column that marks the row's kind, 0 in those of other kinds; None:
                all rows have all of the fields.
        """
        if self.vectors:
            x, y, kinds, origin, moved = map(np.array, zip(*self.vectors, strict=True))
            factor = moved.astype(np.float32)
            factor = factor if there is None else there[:, kinds] * factor
            cosine, sine = turn
            dx, dy = values[:, x] - me[:, origin] * factor, values[:, y] - me[:, origin + 1] * factor
            values[:, x], values[:, y] = cosine * dx + sine * dy, cosine * dy - sine * dx
        if self.angles:
            column, kinds, turned = map(np.array, zip(*self.angles, strict=True))
            factor = turned.astype(np.float32)
            factor = factor if there is None else there[:, kinds] * factor
            angle = values[:, column] - me[:, 4:] * factor
            values[:, column] = np.mod(angle + np.float32(math.pi), np.float32(2 * math.pi)) - np.float32(math.pi)
