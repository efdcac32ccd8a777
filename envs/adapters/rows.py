"""What a caller hands to faces with a row for each sub-environment: actions, seeds and masks, checked."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from ..core.make import make_vec
from ..core.validation import Array, as_array, autoreset_mode
from ..core.vector_env import SurvivalVectorEnv
from ..errors import ActionError
from ..scenarios.scenario import Scenario


def face_core(
    scenario: str | Scenario, num_worlds: int, autoreset: AutoresetMode | str, **options: Any
) -> tuple[SurvivalVectorEnv, AutoresetMode]:
    """The core of a face, and the face's mode: under SAME_STEP, the face looks at the ended worlds and then resets."""
    mode = autoreset_mode(autoreset)
    inner = mode if mode is AutoresetMode.NEXT_STEP else AutoresetMode.DISABLED
    return make_vec(scenario, num_worlds, autoreset=inner, **options), mode


def checked_rows(given: Any, count: int, sizes: Array, ranges: bool) -> Array:
    """`given` as an integer array (count, actions). ranges: check that each is below its size. Raises ActionError."""
    actions, shape = as_array(given), (count, len(sizes))
    if actions.shape != shape:
        raise ActionError(f"actions have shape {actions.shape}: (num_envs, actions) = {shape} is needed")
    if actions.dtype.kind not in "iu":
        raise ActionError(f"actions are {actions.dtype}: integers are needed")
    if ranges and (bad := (actions < 0) | (actions >= sizes)).any():
        j, k = (int(index[0]) for index in np.nonzero(bad))
        raise ActionError(f"action {k} of sub-environment {j} is {actions[j, k]}: 0 to {sizes[k] - 1} is allowed")
    return actions


def world_seeds(seed: Any, worlds: int, each: int) -> Any:
    """One seed, or one for each world, out of what reset is given; `each`: sub-environments a world.

    A scalar is left for the core to check.
    """
    if as_array(seed).ndim == 0:
        return seed
    seeds = np.asarray(seed, object)
    if seeds.shape != (worlds * each,):
        wanted = f"one integer, or one for each of {worlds * each} sub-environments"
        raise ValueError(f"seed has shape {seeds.shape}: {wanted}")
    return _agreed("seed", seeds, each).tolist()


def world_mask(mask: Array, each: int) -> Array:
    """A mask of worlds out of one of sub-environments, `each` of them in a world."""
    return _agreed("reset_mask", mask, each)


def _agreed(name: str, rows: Array, each: int) -> Array:
    """The one value that the `each` rows of a world have in common."""
    by_world = rows.reshape(-1, each)
    differ = (by_world != by_world[:, :1]).any(1)
    if differ.any():
        w = int(differ.argmax())
        raise ValueError(
            f"{name}: sub-environments {w * each} to {(w + 1) * each - 1} are the agents of world {w} and must agree; "
            f"they have {by_world[w].tolist()}"
        )
    return by_world[:, 0]
