"""Floor plans: walls and start areas as data, from lists, text, files and running worlds."""

import json
import math
import os
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import ascii_uppercase
from typing import Any, NamedTuple

import numpy as np

from outlast.components import Body, Floor, Shape, Wall
from outlast.components.limits import FAR
from outlast.ecs import Entity, Module, Worlds, checked_worlds
from outlast.ecs.kernels.errors import did_you_mean
from outlast.ecs.kernels.integers import is_whole
from outlast.systems import Maze, Pillars, Room, Rooms, Walls
from outlast.systems.geometry.places import ENTRY, ITEMS, WALL, kind_use
from outlast.systems.geometry.plans import are_free, connected, corners

from ..errors import ScenarioError
from ..storage import inputs
from ..storage.inputs import read_text
from ..storage.outputs import atomic_write

Rectangle = tuple[float, float, float, float, float]
FORMAT, VERSION = "outlast floor plan", 1
KEYS = ("format", "version", "width", "height", "walls", "starts")
MOST = 450  # rectangles at most, as physics takes at most 512 bodies
LARGEST = 2**20  # bytes of a file at most
BLANK = ". "  # floor, in a drawing
LONGEST_LINE = 1000  # characters of a line of a drawing, and number of lines, at most
CELLS = 10  # points of the lattice of a floor per diameter of the disc
LATTICE = 1000  # points along a side of the room at most; in larger rooms they are farther apart
LISTED = 4  # parts that a sentence lists at most
EXAMPLE = "(x, y, width, height) or (x, y, width, height, angle), in metres and radians"


class Part(NamedTuple):
    """A part of the floor in which a disc can get everywhere, but which it cannot leave.

    Attributes:
        x: Position of a point in the part, near its middle, where the middle of the disc can be, metres.
        y: Its second coordinate, metres.
        area: The area that the middle of the disc can reach, square metres.
        starts: Indices of the start areas that overlap it.
    """

    x: float
    y: float
    area: float
    starts: tuple[int, ...]


@dataclass(frozen=True)
class FloorPlan:
    """Walls inside a room, and the areas in which agents and items start.

    >>> plan = outlast.levels.FloorPlan(walls=[(0, 0, 6, 0.4)], starts=[(0, -8, 0, 4, 8), (1, 8, 0, 4, 8)])
    >>> scenario = outlast.variant("ffa_3").with_(plan.mechanic())

    Attributes:
        walls: Rectangles (x, y, width, height, angle): x and y of the middle, width and height in metres; the angle in
            radians, 0 if left out.
        starts: Start areas (owner, x, y, width, height, angle), where the angle may be left out as well. The owner is
            the number of a side, the name of a kind such as "heal" or "crate", or "items" for all other kinds that
            have a start place. Kinds without an area start anywhere.
        width: Width of the room that the plan is for, metres; 0: a room of any size.
        height: Height of that room.

    Raises:
        ScenarioError: A rectangle or a size is not valid, or there are too many rectangles.
    """

    walls: Sequence[Sequence[float]] = ()
    starts: Sequence[Sequence[float | str]] = ()
    width: float = 0.0
    height: float = 0.0

    def __post_init__(self) -> None:
        walls = tuple(_rectangle(f"walls[{k}]", each) for k, each in enumerate(_listed("walls", self.walls)))
        starts = tuple(_start(f"starts[{k}]", each) for k, each in enumerate(_listed("starts", self.starts)))
        if len(walls) + len(starts) > MOST:
            raise ScenarioError(f"a floor plan of {len(walls) + len(starts)} rectangles: at most {MOST} are possible")
        for name in ("width", "height"):
            if not 0 <= _real(name, getattr(self, name)) <= FAR:
                raise ScenarioError(f"{name} = {getattr(self, name)!r}: metres are needed, or 0 for any room")
        if bool(self.width) != bool(self.height):
            sides = f"width = {self.width:g}, height = {self.height:g}"
            raise ScenarioError(f"{sides}: both are needed, or neither, for any room")
        object.__setattr__(self, "walls", walls)
        object.__setattr__(self, "starts", starts)

    def __repr__(self) -> str:
        size = f", {self.width:g} x {self.height:g} m" if self.width and self.height else ""
        return f"FloorPlan({len(self.walls)} walls, {len(self.starts)} start areas{size})"

    @classmethod
    def from_text(cls, text: str, cell: float = 1.0, kinds: Mapping[str, str] | None = None) -> "FloorPlan":
        """Read a plan drawn in characters: `#` is a wall, `.` and blanks are floor, a letter is where a side starts.

        >>> outlast.levels.FloorPlan.from_text('''
        ... A....#....B
        ... A.........B
        ... A....#....B
        ... ''')

        `A` is side 0, `B` side 1 and so on to `Z`; `*` is where items start. The middle of the text is the middle of
        the room; the first line is at the top. Equal characters that form a rectangle become a single rectangle.

        Args:
            text: Lines of characters; blank lines around them and their common indentation are ignored.
            cell: Side of the square that a character stands for, metres.
            kinds: The kinds that start at other signs: {"c": "crate", "r": "ramp"}.

        Raises:
            ScenarioError: The text has another character or no lines, or is not a possible plan (see `FloorPlan`).
        """
        if not 0 < _real("cell", cell) <= 1e3:
            raise ScenarioError(f"cell = {cell!r}: the metres of a character are needed")
        owners: dict[str, Any] = {**{sign: k for k, sign in enumerate(ascii_uppercase)}, "*": "items"}
        if taken := [sign for sign in kinds or () if len(sign) != 1 or sign in {*owners, *"#. "}]:
            raise ScenarioError(f"kinds has {taken[0]!r:.60}: signs are single characters other than # . * and A to Z")
        owners |= kinds or {}
        rectangles, columns, rows = _drawn(text, float(cell), {"#", *owners})
        walls = [place for sign, place in rectangles if sign == "#"]
        areas = [(sign, place) for sign, place in rectangles if sign != "#"]
        starts = [(owners[sign], *place) for sign, place in areas]
        return cls(walls, starts, columns * float(cell), rows * float(cell))

    @classmethod
    def of_world(cls, worlds: Worlds, w: int = 0) -> "FloorPlan":
        """Return the walls that stand in a world now, such as those a generator drew; without start areas.

        Args:
            worlds: The worlds, as in env.worlds.
            w: The number of the world.

        Raises:
            ScenarioError: The world does not exist.
            TypeError: `worlds` is something else, as an environment.
        """
        last = checked_worlds(worlds).count - 1
        if not is_whole(w, 0, last):
            raise ScenarioError(f"world {w!r}: there are the worlds 0 to {last}")
        if Wall not in worlds:
            return cls()
        body, shape, alive = worlds[Body], worlds[Shape], worlds[Entity].alive[w]
        rows = [e for e in worlds.layout.rows(Wall) if alive[e]]
        columns = (body.x, body.y, 2 * shape.half_width, 2 * shape.half_height, body.angle)
        sides = worlds[Floor].size[w]
        return cls([[float(c[w, e]) for c in columns] for e in rows], (), float(sides[0]), float(sides[-1]))

    def parts(self, width: float, room: tuple[float, float] | None = None) -> list[Part]:
        """Return the connected parts of the floor: a disc can get everywhere in its part, but never leaves it.

        >>> [part] = plan.parts(1.0)  # or ValueError: agents of a metre cannot get everywhere

        Computed on a lattice whose points are a tenth of the disc's width apart (or a thousandth of the room's longer
        side, if that is more). Passages wider than the disc by that distance or more count as open, those too narrow
        for the disc as closed; those in between may count as either.

        Args:
            width: The diameter of the disc, metres, such as 2 * agents_radius.
            room: Width and height of the floor, metres; None: those of the plan.

        Returns:
            (x, y, area, starts) for each part, the largest first: a point in it, the area in square metres that the
            middle of the disc can reach, and the indices of the start areas that overlap it.

        Raises:
            ScenarioError: The plan is for rooms of any size and `room` is not given, or the disc is too small for a
                lattice.
        """
        sides = tuple(room or (self.width, self.height))
        if len(sides) != 2 or not all(sides):
            raise ScenarioError(
                f"{self} in a room of {sides}: width and height are needed, as in parts(1.0, room=(25, 25))"
            )
        disc, across, along = (_real("parts", each) for each in (width, *sides))
        step = max(disc / CELLS, max(across, along) / LATTICE)
        if not (disc > 0 and min(across, along) > 0 and step <= disc / 2):
            raise ScenarioError(
                f"parts: a disc of {disc:g} m on a floor of {across:g} x {along:g} m; a diameter from a "
                f"{LATTICE // 2}th of the floor's longer side on is needed"
            )
        columns, rows = math.ceil(across / step), math.ceil(along / step)
        x, y = np.meshgrid(*(((np.arange(n) + 0.5) / n - 0.5) * side for n, side in ((columns, across), (rows, along))))
        free = are_free(x, y, (), (across, along), disc / 2)
        for wall in self.walls:
            ends = np.array(corners(wall))
            near = _around(y[:, 0], ends.imag, disc), _around(x[0], ends.real, disc)
            free[near] &= are_free(x[near], y[near], [wall], (across, along), disc / 2)
        labels, cell = connected(free), across * along / (columns * rows)
        inside = [_is_in(place, x, y) for _, *place in self.starts]
        found = [_part(x, y, labels == n, inside, cell) for n in range(1, int(labels.max(initial=0)) + 1)]
        return sorted(found, key=lambda part: -part.area)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "FloorPlan":
        """Read what `save` wrote, or a plan drawn in characters that stand for a metre each (see `from_text`).

        Args:
            path: The file.

        Raises:
            ScenarioError: The file is neither, is of another version, or is damaged.
            OSError: The file cannot be read.
        """
        name = os.fspath(path)
        try:
            text = read_text(path, LARGEST)
            if not text.lstrip().startswith("{"):
                return cls.from_text(text)
            given = inputs.parse_json(text)
            if given.get("format") != FORMAT:
                raise ScenarioError(f'it lacks "format": "{FORMAT}"')
            inputs.check_version(given, VERSION)
            inputs.check_keys(given, KEYS)
            return cls(given["walls"], given["starts"], given["width"], given["height"])
        # UnicodeDecodeError and JSONDecodeError are ValueErrors
        except (ScenarioError, *inputs.BROKEN_JSON) as error:
            raise ScenarioError(f"{name} is not a floor plan: {error}") from None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan to a JSON file, completely or not at all, replacing what was there before.

        Args:
            path: The file.

        Raises:
            OSError: The file cannot be written.
        """
        values = (FORMAT, VERSION, self.width, self.height, self.walls, self.starts)
        with atomic_write(Path(path)) as place:
            place.write_text(json.dumps(dict(zip(KEYS, values, strict=True)), indent=1) + "\n", encoding="utf-8")

    def layout(self, length: int = 0) -> tuple[float, ...]:
        """Return the plan as a value of the number walls_layout. Each episode can choose among values of one length.

        >>> scenario.vary(walls_layout=outlast.distributions.choice(one.layout(20), two.layout(20)))

        Args:
            length: Number of rectangles, walls and start areas together; shorter plans are padded. 0: as many as the
                plan has.

        Raises:
            ScenarioError: The plan has more rectangles than that.
        """
        uses = [
            ITEMS if owner == "items" else kind_use(owner) if isinstance(owner, str) else int(owner) + 1
            for owner, *_ in self.starts
        ]
        places = [*self.walls, *(place for _, *place in self.starts)]
        found = list(zip(places, [WALL] * len(self.walls) + uses, strict=True))
        if length and length < len(found):
            raise ScenarioError(f"{self} has {len(found)} rectangles, more than {length}; take a longer layout")
        empty = max(0, length - len(found)) * ENTRY
        return (*(float(number) for place, use in found for number in (*place, use)), *[0.0] * empty)

    def mechanic(self, length: int = 0) -> Walls:
        """Return the mechanic that builds this plan: scenario.with_(plan.mechanic()). length: as for `layout`."""
        return Walls(layout=self.layout(length))

    def room(self) -> Room:
        """Return a room as large as the plan: scenario.with_(plan.room(), plan.mechanic()).

        Raises:
            ScenarioError: The plan is for rooms of any size.
        """
        if not (self.width and self.height):
            raise ScenarioError(f"{self} is for rooms of any size: give it a width and a height, or leave room() out")
        return Room(width=self.width, height=self.height)


GENERATORS: dict[str, type[Maze | Rooms | Pillars]] = {"maze": Maze, "rooms": Rooms, "pillars": Pillars}
LAYOUT = "maze, rooms, pillars, or a file with a floor plan"


def named_layout(name: str) -> tuple[Module, ...]:
    """Return the mechanics of a layout: a generator, or those of a floor plan in a file and a room of its size.

    Raises ScenarioError if the name is neither one of GENERATORS nor a file with a floor plan.
    """
    if name in GENERATORS:
        return (GENERATORS[name](),)
    try:
        plan = FloorPlan.load(name)
    except OSError as error:
        hint = did_you_mean(name, GENERATORS, after=" ")
        raise ScenarioError(f"layout {name}: {error.strerror}; {hint}{LAYOUT} is needed") from None
    return (plan.room(), plan.mechanic()) if plan.width and plan.height else (plan.mechanic(),)


def _listed(name: str, given: Any) -> Iterable[Any]:
    if isinstance(given, (str, bytes, dict)) or not isinstance(given, Iterable):
        raise ScenarioError(f"{name} = {given!r:.60}: a list of rectangles is needed, {EXAMPLE}")
    return given


def _rectangle(name: str, given: Any) -> Rectangle:
    numbers = tuple(_listed(name, given))
    if len(numbers) not in (4, 5):
        raise ScenarioError(f"{name} has {len(numbers)} numbers: {EXAMPLE} is needed")
    x, y, width, height, *angle = (_real(name, number) for number in numbers)
    if width <= 0 or height <= 0:
        raise ScenarioError(f"{name} is {width:g} x {height:g} m: width and height must be above 0")
    return x, y, width, height, angle[0] if angle else 0.0


def _start(name: str, given: Any) -> tuple[int | str, float, float, float, float, float]:
    owner, *place = tuple(_listed(name, given)) or ("",)
    if not (isinstance(owner, str) and owner.isidentifier()) and (type(owner) is not int or not 0 <= owner < 2**16):
        raise ScenarioError(
            f'{name} is for {owner!r:.60}: the number of a side is needed first, the name of a kind, or "items"'
        )
    return (owner, *_rectangle(name, place))


def _real(name: str, number: Any) -> float:
    if isinstance(number, bool) or not isinstance(number, (int, float)) or not abs(number) <= FAR:
        raise ScenarioError(f"{name} has {number!r:.60}: a number of at most {FAR:g} is needed")
    if not math.isfinite(number):
        raise ScenarioError(f"{name} has {number!r}: a finite number is needed")
    return float(number)


def _drawn(text: str, cell: float, signs: Collection[str]) -> tuple[list[tuple[str, Rectangle]], int, int]:
    """Return sign and place, metres, of each rectangle of `signs` in a drawing, and its numbers of columns and rows."""
    lines = "\n".join(line.rstrip() for line in textwrap.dedent(text).splitlines()).strip("\n").splitlines()
    columns, rows = max(map(len, lines), default=0), len(lines)
    if not 0 < columns <= LONGEST_LINE or rows > LONGEST_LINE:
        raise ScenarioError(f"a drawing of {columns} x {rows} characters: 1 to {LONGEST_LINE} either way are needed")
    grid = [list(line.ljust(columns)) for line in lines]
    found = []
    for row in range(rows):
        for column in range(columns):
            sign = grid[row][column]
            if sign in BLANK:
                continue
            if sign not in signs:
                raise ScenarioError(
                    f"line {row + 1}, column {column + 1}: {sign!r} means nothing; # is a wall, . is floor, A to Z are "
                    "where sides start, * where items do; other signs stand for kinds, as in kinds={'c': 'crate'}"
                )
            wide, high = _cut_out(grid, row, column, sign)
            x, y = column + wide / 2 - columns / 2, rows / 2 - row - high / 2
            found.append((sign, (x * cell, y * cell, wide * cell, high * cell, 0.0)))
    return found, columns, rows


def _cut_out(grid: list[list[str]], row: int, column: int, sign: str) -> tuple[int, int]:
    """Cut a rectangle of a sign out of the grid, from here as far to the right as it goes, then as far down."""
    wide = high = 1
    while column + wide < len(grid[0]) and grid[row][column + wide] == sign:
        wide += 1
    while row + high < len(grid) and grid[row + high][column : column + wide] == [sign] * wide:
        high += 1
    for line in grid[row : row + high]:
        line[column : column + wide] = "." * wide
    return wide, high


def in_words(parts: Sequence[Part], owners: Sequence[float | str], width: float) -> str:
    """Return a text that a floor has several parts, where they are and who starts there; "" if there is at most one.

    owners: Who starts in each start area: a side, or "items". width: The diameter of the disc, metres.
    """
    if len(parts) < 2:
        return ""
    listed = []
    for part in parts[:LISTED]:
        who = sorted({"items" if owners[k] == "items" else f"side {owners[k]}" for k in part.starts})
        there = f", where {' and '.join(who)} start" if who else ""
        listed.append(f"{part.area:.3g} square metres around ({part.x:.3g}, {part.y:.3g}){there}")
    more = [f"{len(parts) - LISTED} more"] * (len(parts) > LISTED)
    return f"agents {width:.3g} m wide cannot get from one part of the floor to another: {'; '.join(listed + more)}"


def _around(points: Any, ends: Any, margin: float) -> slice:
    """Return the slice of the sorted points along an axis that are between the ends, or up to `margin` beyond them."""
    first, last = np.searchsorted(points, (ends.min() - margin, ends.max() + margin))
    return slice(int(first), int(last))


def _is_in(area: Sequence[Any], x: Any, y: Any) -> Any:
    """Return which points are in a rectangle, bool of the shape of x and y."""
    turned = ((x - area[0]) + 1j * (y - area[1])) * np.exp(-1j * area[4])
    return (abs(turned.real) <= area[2] / 2) & (abs(turned.imag) <= area[3] / 2)


def _part(x: Any, y: Any, own: Any, inside: Sequence[Any], cell: float) -> Part:
    """Return the part that consists of the points `own`. cell: square metres that each of them stands for."""
    xs, ys = x[own], y[own]
    middle = int(np.hypot(xs - xs.mean(), ys - ys.mean()).argmin())
    starts = tuple(k for k, area in enumerate(inside) if (area & own).any())
    return Part(float(xs[middle]), float(ys[middle]), float(own.sum()) * cell, starts)
