"""The layers of pictures and films by name. A layer reads the tables of one world and draws on a canvas.

@dataclass(frozen=True)
class MarshLayer(Layer):
    zorder = ZOrder.ZONE + 1
    needs = (Swamp,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        canvas.circle(0, 0, scene.mechanic(Swamp).radius, (120, 140, 90))

image = draw(env.worlds, 0, layers=[*LAYERS, MarshLayer(), CamerasLayer()])
"""

from collections.abc import Sequence

from outlast.ecs.kernels.errors import did_you_mean

from ..errors import FilmError
from ..scenarios.parse import member_of, module_of
from . import bodies, sight, words
from .canvas import Layer

LAYERS_BY_NAME: dict[str, Layer] = {
    "room": bodies.RoomLayer(),
    "zone": bodies.SafeZoneLayer(),
    "vision": sight.CamerasLayer(lines=False),
    "lines": sight.CamerasLayer(cones=False),
    "lidar": sight.LidarLayer(),
    "heals": bodies.HealsLayer(),
    "items": bodies.BoxItemsLayer(),
    "others": bodies.OthersLayer(),
    "boxes": bodies.BoxesLayer(),
    "walls": bodies.WallsLayer(),
    "looks": bodies.LooksLayer(),
    "melee": bodies.MeleeLayer(),
    "agents": bodies.AgentsLayer(),
    "ids": bodies.IdsLayer(),
    "hits": bodies.HitsLayer(),
    "health": bodies.HealthBarsLayer(),
    "inventory": bodies.InventoryLayer(),
    "steps": words.StepCounterLayer(),
    "legend": words.LegendLayer(),
    "feed": words.KillFeedLayer(),
}
"""Every layer of a picture by its short name."""

OPTIONAL = ("vision", "lines", "lidar")

LAYERS: tuple[Layer, ...] = tuple(layer for name, layer in LAYERS_BY_NAME.items() if name not in OPTIONAL)
"""What is drawn by default."""

FILM_LAYERS_BY_NAME: dict[str, Layer] = {
    "title": words.TitleStrip(),
    **LAYERS_BY_NAME,
    "end": words.EndLayer(),
    "feed": words.FeedStrip(),
    "scores": words.ScoresStrip(),
}
"""The layers of films, for --views: what a picture has in its margin is beside it, where there is more room."""

FILM_OPTIONAL = (*OPTIONAL, "steps")

FILM_LAYERS: tuple[Layer, ...] = tuple(each for key, each in FILM_LAYERS_BY_NAME.items() if key not in FILM_OPTIONAL)
"""What films show by default."""


def select(changes: str) -> tuple[Layer, ...]:
    """Return FILM_LAYERS with additions and removals, as in "+vision,-ids"; a name without a sign is added.

    Your own layers are added as FILE.py:NAME or package.module:NAME, where NAME is a layer, a class of layers that
    needs no arguments, or a list of layers. Layers that are shown already are not added again.

    Raises:
        FilmError: A name is unknown, or is not that of a layer.
        ScenarioError: A file or module of your own does not exist, or raises an exception.
    """
    shown, own = {name: name not in FILM_OPTIONAL for name in FILM_LAYERS_BY_NAME}, list[Layer]()
    for change in filter(None, (part.strip() for part in changes.split(","))):
        name = change[1:] if change[0] in "+-" else change
        if ":" in name and change[0] != "-":
            own += _own_layers(name)
            continue
        if name not in FILM_LAYERS_BY_NAME:
            hint = did_you_mean(name, FILM_LAYERS_BY_NAME, after=" ")
            known = f"known: {', '.join(FILM_LAYERS_BY_NAME)}; one of your own is added as FILE.py:NAME"
            raise FilmError(f"there is no layer '{name}'; {hint}{known}")
        shown[name] = change[0] != "-"
    chosen = [layer for name, layer in FILM_LAYERS_BY_NAME.items() if shown[name]]
    return (*chosen, *(layer for layer in own if layer not in chosen))


def _own_layers(text: str) -> Sequence[Layer]:
    """Return layers from a user's file or module, by their name there."""
    place, _, name = text.rpartition(":")
    module = module_of(place)
    found = member_of(module, name, place, [key for key, value in vars(module).items() if _are_layers(value)])
    if not _are_layers(found):
        raise FilmError(
            f"{text} is {type(found).__name__} {found!r:.60}: a Layer is needed, a class of layers that needs no "
            "arguments, or a list of layers"
        )
    if isinstance(found, type):
        try:
            found = found()
        except TypeError as error:
            raise FilmError(f"{text} is a class that needs arguments: {error}; name a layer that it makes") from error
    return [found] if isinstance(found, Layer) else found


def _are_layers(value: object) -> bool:
    if isinstance(value, list | tuple):
        return bool(value) and all(isinstance(each, Layer) for each in value)
    return isinstance(value, Layer) or (isinstance(value, type) and issubclass(value, Layer) and value is not Layer)
