"""A short film of a checkpoint's policy, made while a run goes on."""

import logging
from pathlib import Path

from outlast.envs.films import Looks, write_film_of
from outlast.envs.scenarios.scenario import Scenario

from .episode import episode

MOST, EVERY = 900, 3  # ticks that are shown, which is half a minute of the paper's variants; and from frame to frame
SIZE, FPS = 256, 20  # pixels; frames a second: with EVERY, twice real time
logger = logging.getLogger(__name__)


def film_checkpoint(checkpoint: Path, folder: Path, scenario: Scenario | None = None, *, seed: int = 0) -> list[Path]:
    """Film the beginning of an episode that a checkpoint's policy plays with itself. Takes a second or two.

    It does not affect a training run: it leaves global random numbers and the number of threads alone. As a run is
    worth more than its films, errors, such as a full disk, are only logged; Ctrl-C is raised. The film is complete or
    not there at all.

    Args:
        checkpoint: The file of the checkpoint.
        folder: Folder of the film, made if it does not exist: NAME.webm for NAME.zip.
        scenario: The scenario to play; None: the one named in the checkpoint, which is enough for variants.
        seed: Seed of the episode: films of one run with the same seed begin in the same world.

    Returns:
        A list of the film's path; empty if it could not be made.
    """
    target = folder / f"{checkpoint.stem}.webm"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with episode(checkpoint, seed=seed, most=MOST, scenario=scenario) as played:
            if played.differs:
                logger.warning("%s: %s is not quite what it was: %s", checkpoint, played.scenario.name, played.differs)
            looks, title = Looks(size=SIZE, every=EVERY, fps=FPS), f"{played.scenario.name}, {checkpoint.stem}"
            write_film_of(target, played.worlds, played.ticks, [0], looks, title)
    except Exception as error:  # of the disk, the encoder, the world, the policy
        logger.warning("there is no film of %s: %s", checkpoint, str(error) or type(error).__name__)
        return []
    return [target]
