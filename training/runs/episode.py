"""An episode that a checkpoint's policy plays against itself, to be watched in films and on pages."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gymnasium.vector import AutoresetMode

import outlast
from outlast.ecs import Worlds
from outlast.envs.rollout.memory import told
from outlast.envs.scenarios.fingerprint import difference, fingerprint, planned, rebuilt
from outlast.envs.scenarios.scenario import Scenario

from ..base import policy_file, run_header
from ..base.errors import TrainingError


@dataclass(frozen=True)
class WatchedEpisode:
    """One world in which a policy plays an episode.

    worlds: The world, which is reset when the first tick is asked for. ticks: Each item that is asked for plays one
    more tick, until the episode ends; the first item is the reset. differs: How the scenario differs from the one that
    the policy was trained in; "" if it does not.
    """

    worlds: Worlds
    ticks: Iterator[int]
    scenario: Scenario
    differs: str


@contextlib.contextmanager
def episode(path: Path, *, seed: int, most: int, scenario: Scenario | None = None) -> Iterator[WatchedEpisode]:
    """Open an episode of a checkpoint's policy, in which everything random comes from `seed`.

    PyTorch's global random numbers and its number of threads stay as they are.

    Raises TrainingError: the checkpoint is broken, of another game, or does not say enough about its own.

    most: The number of ticks after which the episode is left, even if it has not ended. scenario: What is played; None:
    what the checkpoint says, see `recorded_scenario`.
    """
    header = policy_file.read_header(path, ("scenario",))
    game, differs = (scenario, "") if scenario is not None else recorded_scenario(header)
    player = outlast.load_policy(path, seed)
    game = player.scenario(game)
    mode = AutoresetMode.DISABLED
    env = outlast.make_vec(game, 1, seed=seed, autoreset_mode=mode, copy=False, check_actions=False)

    def ticks() -> Iterator[int]:
        act = told(player, env)
        observations, _ = env.reset()
        yield 0
        for tick in range(1, most + 1):
            observations, _, terminated, truncated, _ = env.step(act(observations))
            yield tick
            if terminated[0] or truncated[0]:
                break

    with contextlib.closing(env):
        player.check(env)
        yield WatchedEpisode(env.worlds, ticks(), game, differs)


def recorded_scenario(header: run_header.Header) -> tuple[Scenario, str]:
    """Rebuild the scenario of a run that `outlast train` began, without importing anything.

    Returns the scenario, and how it differs from that of the run, which another version of outlast may have begun; ""
    if it does not differ. Raises TrainingError: the scenario has mechanics of the user's own that are not imported.

    header: run.json of the run, or of one of its checkpoints.
    """
    given = header["scenario"]
    try:
        made = rebuilt(given, header["modules"], strict=False)
        planned(made)
    except ValueError as error:
        raise TrainingError(f"the scenario {given['name']!r} cannot be made from a checkpoint: {error}") from error
    return made, difference(given, fingerprint(made)).partition("): ")[2]  # without the name
