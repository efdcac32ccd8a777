"""The game: one world in which a person steers one agent. Independent of pages and sockets."""

import math
import os
from collections import deque
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import numpy as np

from outlast.components import Respawned
from outlast.components.score import End, Episode, Kills, Outcome
from outlast.ecs import Action, Clock
from outlast.systems.ending import outliving_wins

from ... import recording
from ...core.agents import alive, fewest_agents, side
from ...core.spaces import published
from ...core.vector_env import SurvivalVectorEnv
from ...errors import PlayError
from ...inspect.observation_text import observation_text
from ...inspect.world_json import describe, events, snapshot
from ...rollout.lineup import Lineup, Others, entries_of
from ...rollout.outcome import Standings, own_wins
from ...rollout.summary import RESULTS
from ...scenarios.scenario import Scenario

Json = dict[str, Any]

RECENT = 8  # the newest events, all of which are sent each time, as a page may miss ticks
SLOW, SLOWLY = 1.5, 0.5  # an episode begins slowly: seconds, and share of the usual speed


class GamePhase(StrEnum):
    """States of play: running, or why not."""

    READY = "ready"  # a new episode, which waits for a key
    RUNNING = "running"
    PAUSED = "paused"
    OVER = "over"  # the episode has ended; restart begins the next one


class Game:
    """World 0 of `scenario`, seeded. agent: the number of the agent that a person steers.

    others: who plays the other agents, see lineup.Lineup. record: a new file for a recording of the game, see
    outlast.record. name: what the recording calls the others. Keys set actions by name, in the engine's own values
    (ahead: -1, 0, 1). Raises PlayError if there is no such agent, RecordingError if the file cannot be written, and
    what environments raise.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        agent: int = 0,
        others: Others = "scripted",
        seed: int = 0,
        record: str | os.PathLike[str] | None = None,
        name: str = "",
    ) -> None:
        self.env = SurvivalVectorEnv(scenario, 1, seed=seed, autoreset_mode="Disabled", copy=False)
        try:
            if Episode not in self.env.worlds:
                raise PlayError(f"{scenario.name} has no 'record', by which episodes are judged here: add Record()")
            self._choose(agent)
            if record is not None:
                recording.record(self.env, record, played={"agent": self.agent, "others": name})
        except BaseException:
            self.env.close()
            raise
        self.worlds, self._standings = self.env.worlds, Standings(self.env.worlds)
        self.ranges = {key: (int(c.low), int(c.high)) for key, _, _, c in published(self.worlds, Action)}
        self._others = Lineup(entries_of(others), self.env, agent)
        self.restart()

    def restart(self) -> None:
        """Go on to the next episode, even if the present one has not ended."""
        self.env.reset()
        self.phase = GamePhase.READY
        self.death: Json | None = None
        self._recent: deque[Json] = deque(maxlen=RECENT)
        self._held: Mapping[str, int] = {}
        self._tapped: dict[str, int] = {}
        self._standings.begin(np.ones(1, bool))
        game = self.env.scenario
        world = {"name": game.name, "about": game.about, "agent": self.agent, "actions": self.ranges}
        world["comes_back"] = Respawned in self.worlds
        self.world = describe(self.worlds, 0) | world

    def hold(self, held: Mapping[str, int], tapped: Mapping[str, int]) -> None:
        """Set the keys that are held from now on, and those tapped, which count in the next tick even if up by then.

        The first key begins the episode, as `begin` does. Keys that come while the world stands still are not kept.
        """
        if any(held.values()) or any(tapped.values()):
            self.begin()
        self._held = held
        if self.phase is GamePhase.RUNNING:
            self._tapped.update(tapped)

    def begin(self) -> None:
        """Begin the episode, without taking an action."""
        if self.phase is GamePhase.READY:
            self.phase = GamePhase.RUNNING

    @property
    def pace(self) -> float:
        """The world's speed as a multiple of the usual one: the start of an episode is slow."""
        return SLOWLY if self.worlds[Clock].tick[0, 0] * self.world["seconds"] < SLOW else 1

    def pause(self) -> None:
        """Stand still until `resume`."""
        if self.phase is GamePhase.RUNNING:
            self.phase = GamePhase.PAUSED
            self._tapped.clear()

    def resume(self) -> None:
        """Go on where `pause` stopped."""
        if self.phase is GamePhase.PAUSED:
            self.phase = GamePhase.RUNNING

    def tick(self) -> bool:
        """Run one tick of the world; unless it is running, do nothing and return False."""
        if self.phase is not GamePhase.RUNNING:
            return False
        actions = np.zeros((1, self.env.num_agents, len(self.ranges)), np.int64)
        actions[:, self._others.agents] = self._others.actions()
        actions[0, self.agent] = self.action()
        self._tapped.clear()
        _, _, terminated, truncated, _ = self.env.step(actions)
        self._note_events()
        if terminated[0] or truncated[0]:
            self.phase = GamePhase.OVER
        return True

    def action(self) -> list[int]:
        """Return the person's action in the next tick, as the environment takes it: numbers from 0."""
        keys = {**self._held, **self._tapped}
        return [keys.get(name, 0) - low for name, (low, _) in self.ranges.items()]

    def state(self) -> Json:
        """Return all that a page shows after a tick: the world, the person's observation as text, events, result."""
        observation = {key: values[0, self.agent] for key, values in self.env.observe().items()}
        return {
            "phase": self.phase,
            "slow": self.pace < 1,
            "snapshot": snapshot(self.worlds, 0),
            "text": observation_text(observation, self.env.fields, self.env.roles),
            "death": None if alive(self.worlds, 0)[self.agent] else self.death,
            "events": list(self._recent),
            "result": self._result() if self.phase is GamePhase.OVER else None,
        }

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def _choose(self, agent: int) -> None:
        last, name = fewest_agents(self.env.worlds) - 1, self.env.scenario.name
        if not 0 <= agent <= last:
            where = " in every episode" if last < self.env.num_agents - 1 else ""
            raise PlayError(f"agent {agent}: {name} has the agents 0 to {last}{where}; take one of them")
        self.agent = agent

    def _note_events(self) -> None:
        """Keep how far sides have come, and the events of the tick."""
        tick = int(self.worlds[Clock].tick[0, 0])
        self._standings.watch()
        for event in events(self.worlds, 0):
            self._recent.append(event | {"tick": tick})
            if event["kind"] in ("kill", "death") and event["agent"] == self.agent:
                self.death = event | {"tick": tick}

    def _result(self) -> Json:
        """Return the result of the episode that has ended, as the person's side sees it.

        verdict: "won" if this side came farther than all others, by living longer or by components.Outcome,
        "drawn" if as far as the best other one, else "lost"; "over" without another side or a result.
        kills: None if agents cannot die. return: None if it is not finite.
        """
        episode, mine = self.worlds[Episode], int(side(self.worlds, 0)[self.agent])
        come, paid = self._standings.of(np.array([0])), float(episode.returns[0, self.agent])
        decided = Outcome in self.worlds or outliving_wins(self.worlds.layout)
        contested = decided and np.isfinite(come).sum() > 1
        return {
            "verdict": RESULTS[int(2 - 2 * own_wins(come, np.array([mine]))[0])] if contested else "over",
            "truncated": bool(self.worlds[End].truncated[0, 0]),
            "kills": int(self.worlds[Kills].kills[0, mine]) if Kills in self.worlds else None,
            "length": int(episode.length[0, 0]),
            "return": round(paid, 2) if math.isfinite(paid) else None,
        }
