"""A policy whose thoughts are known, for recordings of what policies think."""

from typing import Any

import numpy as np

ENTITIES = [("others", 1), ("heals", 15)]


class Thinker:
    """A policy whose thoughts are a simple function of each observation."""

    entities = ENTITIES

    def __init__(self) -> None:
        self.told: list[list[bool]] = []

    def check(self, env: Any) -> None:
        """Accept all worlds."""

    def explainer(self) -> "Thinker":
        return self

    def reset(self, where: Any) -> None:
        self.told.append(where.tolist())

    def __call__(self, observations: Any) -> tuple[Any, Any, Any]:
        own = observations["own"]
        likely = np.abs(own[..., :1]) / 100 + np.arange(15) / 100
        return own.sum(-1), likely, np.zeros((*own.shape[:2], 16)) + observations["heals"][..., :1, 0] / 100
