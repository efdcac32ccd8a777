"""Saved policies, where environments play them: loading, and the observations that they need."""

from collections.abc import Sequence
from typing import Any

from ..errors import UsageError, install
from ..scenarios.scenario import Scenario

SAVED = ".zip"  # what a saved policy's file ends in
MASKED, REVEALED, OMNISCIENT = "masked", "revealed", "omniscient"  # values of cameras_mode


def cameras_mode(scenario: Scenario) -> str | None:
    """What cameras_mode is there, or what it is drawn from; None without cameras."""
    mode = dict(scenario.varied).get("cameras_mode", scenario.numbers().get("cameras_mode"))
    return None if mode is None else str(mode)


def load_saved(path: str, seed: int = 0) -> Any:
    """outlast.load_policy(path, seed); UsageError if there is no PyTorch, or no such policy."""
    import outlast  # here, as the package imports the environments

    try:
        return outlast.load_policy(path, seed)
    except ModuleNotFoundError as error:
        raise UsageError(f"{path} needs {error.name}: {install('train')}") from error


def forms(scenario: Scenario) -> list[Scenario]:
    """All that `common_scenario` may make of a scenario, by who plays."""
    if cameras_mode(scenario) != MASKED:
        return [scenario]
    return [scenario, scenario.replace(cameras_mode=REVEALED).titled_as(scenario)]


def common_scenario(scenario: Scenario, players: Sequence[Any]) -> Scenario:
    """The scenario with observations that all saved policies can play with. Raises UsageError.

    What agents do and see does not depend on cameras_mode, only what the rows of hidden entities hold. Policies by name
    and networks of presets with "masked" rows ignore those, so all can play where they are "revealed".
    """
    if players and (mode := cameras_mode(scenario)) not in (None, MASKED, REVEALED):
        raise UsageError(
            f"cameras_mode is {mode}: saved policies were trained to see what cameras see, the same in all worlds; "
            f"take {MASKED} or {REVEALED}"
        )
    fitting = [player.scenario(scenario) for player in players]
    revealed = (each for each in fitting if each.numbers().get("cameras_mode") == REVEALED)
    return next(revealed, fitting[-1] if fitting else scenario)
