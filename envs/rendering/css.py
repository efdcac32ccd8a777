"""The colours of pictures as CSS, on a light and on a dark ground."""

from .canvas import Color
from .layers.palette import (
    BLACK,
    BOX,
    FLOOR,
    GREEN,
    HEAL,
    INK,
    ORANGE,
    RIM,
    SKY,
    STRIKE,
    UNSAFE,
    VERMILLION,
    WALL,
    WHITE,
    mix,
)

NIGHT = mix(INK, BLACK, 0.45)

COMMON = {
    "heal": HEAL,
    "strike": STRIKE,
    "box": BOX,
    "whole": GREEN,
    "hurt": ORANGE,
    "dying": VERMILLION,
    "beyond": SKY,
    "white": WHITE,
}
LIGHT = {
    "floor": FLOOR,
    "unsafe": UNSAFE,
    "wall": WALL,
    "rim": RIM,
    "ink": INK,
    "outline": INK,
    "page": mix(FLOOR, UNSAFE, 0.3),
    "card": mix(FLOOR, WHITE, 0.6),
}
DARK = {
    "floor": mix(INK, WALL, 0.35),
    "unsafe": mix(NIGHT, INK, 0.5),
    "wall": mix(WALL, RIM, 0.4),
    "rim": RIM,
    "ink": mix(FLOOR, UNSAFE, 0.3),
    "outline": mix(NIGHT, BLACK, 0.4),
    "page": NIGHT,
    "card": mix(NIGHT, INK, 0.8),
}


def css(color: Color) -> str:
    """As style sheets and canvases take it: #rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def themes() -> dict[str, dict[str, str]]:
    """The colours by name, for "light" and "dark"; what sides and their boxes look like is in the description."""
    return {
        name: {key: css(color) for key, color in (COMMON | theme).items()}
        for name, theme in (("light", LIGHT), ("dark", DARK))
    }
