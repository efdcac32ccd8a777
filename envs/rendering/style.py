"""Colours and sizes of pictures, films and pages. web/assets.py passes them to JavaScript.

Colours are those of Okabe and Ito, which are distinct to colour-blind people, on greys. Sides, heals and strikes never
share a colour. Source: M. Okabe, K. Ito, "Color Universal Design" (2008).
"""

import functools
from dataclasses import dataclass

Color = tuple[int, int, int]

BLACK, WHITE = (0, 0, 0), (255, 255, 255)
ORANGE, SKY, GREEN, YELLOW = (230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66)
BLUE, VERMILLION, PURPLE = (0, 114, 178), (213, 94, 0), (204, 121, 167)

SIDES = (BLUE, VERMILLION, GREEN, ORANGE, SKY)
HEAL, STRIKE = PURPLE, YELLOW
WHOLE, HURT, DYING, EXTRA = GREEN, ORANGE, VERMILLION, SKY  # hit points; EXTRA: more than at the start
INK = (38, 41, 48)  # outlines and text
WALL = (72, 77, 88)  # also the area outside of the room
PAPER = (232, 233, 236)  # text on WALL
FLOOR, UNSAFE = (250, 249, 246), (190, 194, 204)
RIM = (110, 118, 136)  # of the safe zone's disc
BOX = (116, 110, 102)  # a box without an owner
KINDS = ((150, 90, 40), (0, 140, 140), (150, 40, 110), (110, 125, 30), (90, 80, 170))  # other items and bodies, by kind


@dataclass(frozen=True)
class Sizes:
    """Lengths in metres, unless a comment gives another unit."""

    margin: float = 1.1  # the picture's side over the room's, so that bars of agents at a wall, or words, fit in
    # its corners, in radii of the agent ahead and to the left
    beak: tuple[tuple[float, float], ...] = ((0.6, 0.75), (1.5, 0.0), (0.6, -0.75))
    outline: float = 0.08  # of agents and boxes
    cross: float = 0.5  # length of the arms of a heal's cross, in radii of the heal
    cross_width: float = 0.25  # in radii of the heal
    box_item: float = 0.9  # half the side of a broken box, in radii of the item
    bar_length: float = 1.2
    bar_height: float = 0.18
    bar_gap: float = 1.6  # between the bar and the body, in heights of the bar
    bar_lift: float = 0.6  # a bar is at most this far, plus the gap, above a body's centre
    hurt: float = 0.5  # up to this share of the hit points at the start, a bar has the colour HURT
    dying: float = 0.25  # as `hurt`, for DYING
    bag_half: float = 0.15  # half the side of a carried item
    bag_step: float = 2.6  # from item to item, in bag_half
    bag_below: float = 2.2  # below the body, in bag_half
    strike: float = 0.16
    star: float = 0.26
    star_rim: float = 0.08
    cone_opacity: float = 0.15  # 0 to 1
    sight_line: float = 0.06
    ray: float = 0.05
    zone_rim: float = 0.1
    zone_dash: float = 0.7


SIZES = Sizes()


@functools.lru_cache(maxsize=1024)
def mix(one: Color, other: Color, share: float) -> Color:
    """Mix two colours, from `one` (share 0) to `other` (share 1)."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(one, other, strict=True))
    return red, green, blue


def of_side(side: int) -> Color:
    """Return the colour of a side. After the fifth, colours repeat darker, then lighter, and so on; -1 (none): grey."""
    if side < 0:
        return BOX
    other, share = ((BLACK, 0.0), (BLACK, 0.4), (WHITE, 0.5))[side // len(SIDES) % 3]
    return mix(SIDES[side % len(SIDES)], other, share)


def of_box(owner: int) -> Color:
    """Return the colour of a box: its owner's, but lighter; darker grey without an owner (-1)."""
    return BOX if owner < 0 else mix(of_side(owner), WHITE, 0.35)


def ink_on(color: Color) -> Color:
    """Return black or white, whichever is easier to read on this colour."""
    red, green, blue = color
    return INK if 0.3 * red + 0.6 * green + 0.1 * blue > 145 else WHITE


def of_health(share: float) -> Color:
    """Return the colour of a bar that is filled to this share."""
    return WHOLE if share > SIZES.hurt else HURT if share > SIZES.dying else DYING


def css(color: Color) -> str:
    """Return a colour as used in style sheets and canvases: #rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*color)
