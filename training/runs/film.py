"""Episodes that a checkpoint's policy plays against itself, for pages, and short films of them, made during a run."""

import contextlib
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gymnasium.vector import AutoresetMode

import outlast
from outlast.ecs import Worlds
from outlast.envs.api.film import Looks, write_film_of
from outlast.envs.rollout.memory import told
from outlast.envs.scenarios.fingerprint import difference, fingerprint, planned, rebuilt
from outlast.envs.scenarios.scenario import Scenario

from ..base import policy_file
from ..base.errors import TrainingError

MOST, EVERY = 900, 3  # maximum ticks shown, half a minute of the paper's variants; ticks from frame to frame
SIZE, FPS = 256, 20  # pixels; frames a second: with EVERY, twice real time
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class WatchedEpisode:
    """One world in which a policy plays an episode."""

    worlds: Worlds  # one, which is reset when the first tick is requested
    ticks: Iterator[int]  # each item requested plays a tick, until the episode ends; the first is the reset
    scenario: Scenario
    differs: str  # difference between the scenario and the one that the policy was trained in; "": none


@contextlib.contextmanager
def episode(path: Path, *, seed: int, most: int, scenario: Scenario | None = None) -> Iterator[WatchedEpisode]:
    """Open an episode of a checkpoint's policy, whose random numbers all come from `seed`; PyTorch's stay as they are.

    most: Maximum number of ticks. scenario: The game; None: the one of the checkpoint, see `recorded_scenario`. Raises
    TrainingError: the checkpoint is broken, of another game, or does not describe its own sufficiently.
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


def recorded_scenario(header: policy_file.Header) -> tuple[Scenario, str]:
    """Rebuild the scenario of run.json, and describe how it differs. Raises TrainingError for users' mechanics."""
    given = header["scenario"]
    try:
        made = rebuilt(given, header["modules"], strict=False)
        planned(made)
    except ValueError as error:
        raise TrainingError(f"the scenario {given['name']!r} cannot be rebuilt from a checkpoint: {error}") from error
    return made, difference(given, fingerprint(made)).partition("): ")[2]  # without the name


def film_checkpoint(checkpoint: Path, folder: Path, scenario: Scenario | None = None, *, seed: int = 0) -> list[Path]:
    """Film the beginning of an episode that a checkpoint's policy plays against itself. Takes a second or two.

    Any error, such as a full disk, is only logged, because a run is worth more than its films; but Ctrl-C is raised. A
    film is written completely or not at all. The state of a training run stays as it is.

    Args:
        checkpoint: File of the checkpoint.
        folder: Folder of the film, created if it is missing: NAME.webm for a policy called NAME.
        scenario: The game; None: the one described by the checkpoint, which is enough for variants.
        seed: Seed of the episode: films of one run with the same seed begin in the same world.

    Returns:
        The path of the film; an empty list if it could not be made.
    """
    target = folder / f"{checkpoint.stem}.webm"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with episode(checkpoint, seed=seed, most=MOST, scenario=scenario) as played:
            if played.differs:
                logger.warning(
                    "%s: %s differs from that of the run: %s", checkpoint, played.scenario.name, played.differs
                )
            looks, title = Looks(size=SIZE, every=EVERY, fps=FPS), f"{played.scenario.name}, {checkpoint.stem}"
            write_film_of(target, played.worlds, played.ticks, [0], looks, title)
    except Exception as error:  # of the disk, the encoder, the world, the policy
        logger.warning("no film of %s was made: %s", checkpoint, str(error) or type(error).__name__)
        return []
    return [target]
