"""What agents observe, as seen from where they stand and look.

Actions are in an agent's own frame: ahead, to the left, turn. Observations are in the room's, with angles that grow
with every turn, so a network has to learn to subtract and to rotate before it can walk up to anything. Here both are
done.
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn

from .errors import TrainingError
from .observation_layout import OWN, ObservationLayout
from .rows import Rows

ANGLE = "angle"
VECTORS = {
    ("x", "y"): "x",
    ("next_x", "next_y"): "x",
    ("vx", "vy"): "vx",
}  # fields, and what of the agent is their origin
ME = ("x", "y", "vx", "vy", ANGLE)


class Egocentric(nn.Module):
    """Rows in the frame of the agent that observes: its place is the origin, and it looks along the x-axis.

    Places become relative to the agent's, velocities to its velocity; of itself it observes where the room's middle is,
    and its velocity. Angles of others become relative to its own, and all are brought to -pi to pi.
    """

    me: Tensor

    def __init__(self, layout: ObservationLayout) -> None:
        """layout: With the fields of the agent's own place, velocity and angle. Raises TrainingError without them."""
        super().__init__()
        columns = layout.field_columns()
        if not columns[OWN].keys() >= {*ME}:
            raise TrainingError(f"preset fast needs the fields {', '.join(ME)} of '{OWN}'; take another preset")
        self.register_buffer("me", torch.tensor([columns[OWN][name] for name in ME]), persistent=False)
        self.own, self.entities = Columns(), Columns()
        for key in layout.alone:
            factors = {"x": 2.0, "vx": 0.0, ANGLE: 0.0} if key == OWN else {}
            self.own.add(columns[key], 0, factors)
        for k, kind in enumerate(layout.kinds):
            self.entities.add(columns[kind.key], layout.columns - len(layout.kinds) + k, {})
        for each in (self.own, self.entities):
            each.close()

    def forward(self, seen: Rows) -> Rows:
        """The same rows in the frames of their agents."""
        with torch.no_grad():
            me = seen.own.index_select(1, self.me)
            own = self.own(seen.own, me, torch.ones_like(seen.own))
            entities = self.entities(seen.entities, me.index_select(0, seen.agent), seen.entities)
        return Rows(own, entities, seen.count)


class Columns(nn.Module):
    """The vectors and angles in rows, by column.

    A vector is (column of x, column of y, column of the kind of row that has it, place in ME of its origin's x, factor
    of the origin); an angle is (column, column of the kind, factor of the agent's angle).
    """

    def __init__(self) -> None:
        super().__init__()
        self.vectors, self.angles = list[tuple[float, ...]](), list[tuple[float, ...]]()

    def add(self, columns: Mapping[str, int], kind: int, factors: Mapping[str, float]) -> None:
        """Add those among the fields of a kind of row, whose column is `kind`. factors: 1 unless given."""
        for (x, y), origin in VECTORS.items():
            if x in columns and y in columns:
                self.vectors.append((columns[x], columns[y], kind, ME.index(origin), factors.get(x, 1.0)))
        if ANGLE in columns:
            self.angles.append((columns[ANGLE], kind, factors.get(ANGLE, 1.0)))

    def close(self) -> None:
        """Make tensors of them; none may follow."""
        for name, entries, width in (("vector", self.vectors, 5), ("turn", self.angles, 3)):
            table = torch.tensor(entries).reshape(-1, width)
            self.register_buffer(f"{name}_columns", table[:, :-1].long().T.contiguous(), persistent=False)
            self.register_buffer(f"{name}_factor", table[:, -1].float(), persistent=False)

    def forward(self, values: Tensor, me: Tensor, there: Tensor) -> Tensor:
        """The values (rows, columns) in the frame of their agents.

        Args:
            values: float32 (rows, columns).
            me: float32 (rows, numbers of ME), of the agent whose row it is.
            there: float32 (rows, columns), 1 in the column of the row's kind.
        """
        x, y, kind, origin = self.get_buffer("vector_columns")
        factor = there.index_select(1, kind) * self.get_buffer("vector_factor")
        dx = values.index_select(1, x) - me.index_select(1, origin) * factor
        dy = values.index_select(1, y) - me.index_select(1, origin + 1) * factor
        angle = me[:, -1:]
        cosine, sine = angle.cos(), angle.sin()
        found = values.index_copy(1, x, cosine * dx + sine * dy).index_copy(1, y, cosine * dy - sine * dx)
        column, kind = self.get_buffer("turn_columns")
        turned = values.index_select(1, column) - angle * there.index_select(1, kind) * self.get_buffer("turn_factor")
        return found.index_copy(1, column, torch.remainder(turned + math.pi, 2 * math.pi) - math.pi)
