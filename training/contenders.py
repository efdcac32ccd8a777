"""Who plays: policies by name, and checkpoints by path, with what each of them may be told."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import TrainingError
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.scenarios.scenario import Scenario

from .matches import Act
from .player import Player

REVEALED, OMNISCIENT = "revealed", "omniscient"  # values of cameras_mode


class Contender:
    """A policy under a name that is good for files, too. player: that of a checkpoint; None: one of POLICIES."""

    def __init__(self, label: str, text: str) -> None:
        """text: a name, or the path of a checkpoint. Raises TrainingError."""
        self.label, self.text = label, text
        self.player = None if text in POLICIES else Player(text)

    def check(self, env: SurvivalVectorEnv) -> None:
        """Raises TrainingError where it cannot play."""
        if self.player is not None:
            self.player.check(env)

    def act(self, env: SurvivalVectorEnv, seed: int) -> Act:
        """What it does, drawn from a generator with that seed."""
        player = self.player
        if player is None:
            whole = POLICIES[self.text](env, seed)
            return lambda seen, seats: np.asarray(whole(seen)[seats])
        player.generator = torch.Generator().manual_seed(seed)
        return lambda seen, seats: player({key: values[seats] for key, values in seen.items()})


def contenders(texts: Sequence[str]) -> list[Contender]:
    """One for each name or path. Raises TrainingError, also where one is there twice."""
    return [Contender(label, text) for label, text in zip(labels(texts), texts, strict=True)]


def labels(texts: Sequence[str]) -> list[str]:
    """A name for each that no other has: of paths, as little from the end as it takes. Raises TrainingError."""
    whole = [(text,) if text in POLICIES else Path(text).resolve().with_suffix("").parts for text in texts]
    if len(set(whole)) < len(whole):
        raise TrainingError(f"a policy is named twice: {', '.join(texts)}")
    return [_shortest(parts, [other for other in whole if other != parts]) for parts in whole]


def _shortest(parts: tuple[str, ...], others: list[tuple[str, ...]]) -> str:
    taken = {_joined(other, length) for other in others for length in range(1, len(other) + 1)}
    found = (_joined(parts, length) for length in range(1, len(parts) + 1))
    return next((name for name in found if name not in taken), _joined(parts, len(parts)))


def _joined(parts: tuple[str, ...], length: int) -> str:
    return re.sub(r"[^\w.]+", "-", "-".join(parts[-length:])).strip("-")


def common(scenario: Scenario, chosen: Sequence[Contender]) -> Scenario:
    """The scenario in which all can play. Raises TrainingError.

    What agents do and see does not depend on cameras_mode, only what the rows of hidden entities hold. Policies by name
    and networks of presets with "masked" rows never look at those, so all can play where they are "revealed".
    """
    players = [contender.player for contender in chosen if contender.player is not None]
    if players and "cameras" in scenario and scenario.numbers()["cameras_mode"] == OMNISCIENT:
        raise TrainingError("cameras_mode is omniscient: saved policies were trained to see what cameras see")
    revealed = [player for player in players if player.preset.cameras == REVEALED]
    for player in revealed or players:
        scenario = player.scenario(scenario)
    return scenario
