"""A short film of a checkpoint's policy, made during a run."""

import logging
from pathlib import Path

from outlast.envs.api.film import write_film_of
from outlast.envs.api.options import Looks
from outlast.envs.scenarios.scenario import Scenario

from .episode import episode

MOST, EVERY = 900, 3  # maximum ticks shown, half a minute of the paper's variants; ticks from frame to frame
SIZE, FPS = 256, 20  # pixels; frames a second: with EVERY, twice real time
logger = logging.getLogger(__name__)


def film_checkpoint(checkpoint: Path, folder: Path, scenario: Scenario | None = None, *, seed: int = 0) -> list[Path]:
    """Film the beginning of an episode that a checkpoint's policy plays against itself. Takes a second or two.

    Does not change the state of a training run, such as global random numbers and the number of threads. Any error,
    such as a full disk, is only logged, because a run is worth more than its films; but Ctrl-C is raised. A film is
    written completely or not at all.

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
