"""The colours: those of Okabe and Ito, which colour-blind people can tell apart, on greys.

Sides, heals and strikes never share a colour. Source: M. Okabe, K. Ito, "Color Universal Design" (2008).
"""

import functools

from ..canvas import Color

BLACK, WHITE = (0, 0, 0), (255, 255, 255)
ORANGE, SKY, GREEN, YELLOW = (230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66)
BLUE, VERMILLION, PURPLE = (0, 114, 178), (213, 94, 0), (204, 121, 167)

SIDES = (BLUE, VERMILLION, GREEN, ORANGE, SKY)
HEAL, STRIKE = PURPLE, YELLOW
INK = (38, 41, 48)  # outlines and writing
WALL = (72, 77, 88)  # also what is beyond the room
PAPER = (232, 233, 236)  # writing on it
FLOOR, UNSAFE = (250, 249, 246), (190, 194, 204)
RIM = (110, 118, 136)  # of the safe zone
BOX = (116, 110, 102)  # that nobody owns


@functools.lru_cache(maxsize=1024)
def mix(one: Color, other: Color, share: float) -> Color:
    """From `one` (share 0) to `other` (share 1)."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(one, other, strict=True))
    return red, green, blue


@functools.cache
def of_side(side: int) -> Color:
    """The colour of a side. After the fifth they come again, darker, then lighter, and so on; -1 (nobody) is grey."""
    if side < 0:
        return BOX
    other, share = ((BLACK, 0.0), (BLACK, 0.4), (WHITE, 0.5))[side // len(SIDES) % 3]
    return mix(SIDES[side % len(SIDES)], other, share)


@functools.cache
def of_box(owner: int) -> Color:
    """The colour of a box: that of its owner, lighter; grey and darker if nobody owns it (-1)."""
    return BOX if owner < 0 else mix(of_side(owner), WHITE, 0.35)


@functools.cache
def ink_on(color: Color) -> Color:
    """Black or white, whichever is easier to read on this colour."""
    red, green, blue = color
    return INK if 0.3 * red + 0.6 * green + 0.1 * blue > 145 else WHITE
