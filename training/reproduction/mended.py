"""What emerges in mended games: each run's policy plays itself, its own past and the scripted one, and is measured."""

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.rollout.saved import checkpoints
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.storage import strict_json
from outlast.systems import Behaviour

from ..errors import TrainingError
from ..evaluation.contenders import contenders
from ..evaluation.evaluation import Evaluation
from ..evaluation.report import TABLES, write_tables
from ..files import read_text
from ..tables import NONE, markdown_table, with_spread

EPISODES = 640  # of each pairing
LAST, HALF, SCRIPTED = "last", "half", "scripted"
MATES = "mate_distance"  # 0 where nobody has a mate
BY_SIDES, BY_AGENTS = 2, 0  # factors from the mean of both roles to a sum over all agents: 2; the number of agents
SELF_PLAY = {
    "length": ("ticks", 1),
    "kills": ("kills", BY_SIDES),
    "damage_dealt": ("damage", BY_AGENTS),
    "strikes_landed": ("strikes that land", 1),
    "heals_used": ("heals used", 1),
    "heals_in_need": ("in need", BY_AGENTS),
    "heals_given": ("given", BY_SIDES),
    "boxes_between": ("boxes between", BY_AGENTS),
    MATES: ("m to a mate", 1),
    "enemy_distance": ("m to an enemy", 1),
}  # of an episode in which a policy plays itself, by figure: what it is called, and how it is summed
HEADS = (
    "game",
    "seeds",
    f"wins against {SCRIPTED}",
    "against itself at half time",
    *(name for name, _ in SELF_PLAY.values()),
)
Figures = dict[str, dict[str, float]]  # mean and error by name


def measure(game: Scenario, run: Path, out: Path, progress: Callable[[int], None] = lambda episodes: None) -> None:
    """Let the policy of a run play, and write the tables of that, unless they are there.

    Args:
        game: What it was trained in.
        run: The folder of the run; its past is the checkpoint after half of its steps.
        out: Folder for the tables.
        progress: Called with how many more episodes have ended.

    Raises:
        TrainingError: The run has a single checkpoint.
    """
    saved = checkpoints(run)
    if len(saved) < 2:
        raise TrainingError(f"{run} has {len(saved)} checkpoints: its policy has no past to play against; train on")
    chosen = contenders({LAST: saved[-1], HALF: saved[(len(saved) - 1) // 2], SCRIPTED: SCRIPTED})
    for contender in chosen[:2]:
        contender.text = "/".join(Path(contender.text).parts[-2:])  # results are kept without the place of the runs
    if _complete(out, [contender.text for contender in chosen]):
        return
    evaluation = Evaluation(game.with_(Behaviour()), chosen, episodes=EPISODES)
    with contextlib.closing(evaluation):
        evaluation.play(progress)
        write_tables(evaluation, out)


def table(measured: Mapping[str, Sequence[Path]]) -> str:
    """What was measured, in Markdown: means over seeds, with 95 % intervals where there are several.

    Where a policy plays itself, both of its roles count.

    Args:
        measured: Folders of `measure` by game, one for each seed.
    """
    return markdown_table(
        HEADS, [_row(game, [_read(folder) for folder in folders]) for game, folders in measured.items()]
    )


def _row(game: str, seeds: Sequence[dict[str, Any]]) -> list[str]:
    cells = [game, str(len(seeds))]
    cells += [
        with_spread([_figures(one, LAST, other)[0]["wins"]["mean"] for one in seeds]) for other in (SCRIPTED, HALF)
    ]
    own = [_figures(one, LAST, LAST) for one in seeds]
    agents = [one["scenario"]["numbers"]["agents_count"] for one in seeds]
    for name, (_, times) in SELF_PLAY.items():
        there = [
            (times or count) * float(np.mean([role[name]["mean"] for role in roles]))
            for roles, count in zip(own, agents, strict=True)
            if name in roles[0]
        ]
        lacking = name == MATES and not any(there)
        cells.append(NONE if lacking else with_spread(there) if there else "")
    return cells


def _figures(evaluation: dict[str, Any], policy: str, against: str) -> list[Figures]:
    """The figures of a policy: in its role against another one; in both roles against itself."""
    for pairing in evaluation["pairings"]:
        if sorted(pairing["policies"]) == sorted((policy, against)):
            roles: list[Figures] = pairing["figures"]
            return roles if policy == against else [roles[pairing["policies"].index(policy)]]
    raise TrainingError(f"{policy} has not played against {against}")


def measured(folder: Path) -> bool:
    """Whether a folder has the tables of `measure`."""
    return (folder / TABLES).exists()


def _complete(folder: Path, texts: Sequence[str]) -> bool:
    """Whether a folder has the complete evaluation of these policies."""
    if not measured(folder):
        return False
    found = _read(folder)
    return bool(found["complete"]) and [policy["policy"] for policy in found["policies"]] == list(texts)


def _read(folder: Path) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads(read_text(folder / TABLES))
        return found
    except strict_json.BROKEN as error:
        raise TrainingError(f"{folder / TABLES} is no evaluation: {error}") from error
