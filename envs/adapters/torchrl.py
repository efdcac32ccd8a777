"""TorchRL: many worlds as one batched EnvBase, in which the agents of a group share networks."""

from __future__ import annotations  # the site is built with stand-ins for TorchRL's classes, which lack "|"

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from gymnasium import spaces

from outlast.ecs import AgentRoles, Clock

from ..core.concurrency import exclusive
from ..core.observations import each
from ..core.spaces import counts_vary, side
from ..core.validation import Array, check_choice, keys
from ..core.vector_env import StepBuffers, SurvivalVectorEnv, world_options
from ..errors import needed
from ..rendering.rgb import Pictured
from ..scenarios.known_numbers import Numbers
from ..scenarios.parse import checks_keywords
from ..scenarios.scenario import Scenario
from .base import requested

with needed("torchrl", "make_torchrl needs TorchRL"):
    import torch
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import Bounded, Categorical, Composite, MultiCategorical, Unbounded
    from torchrl.envs import EnvBase

GROUPS = ("all", "sides", "roles")
TAKEN = (  # names of entries, which no group may have
    *("observation", "action", "action_mask", "mask", "present", "reward", "state"),
    *("done", "terminated", "truncated", "next", "_reset"),
)
Groups = str | Mapping[str, Sequence[str]]
STEP = exclusive(SurvivalVectorEnv._step)  # a step that worlds can be left out of


@checks_keywords
def make_torchrl(
    scenario: str | Scenario,
    num_worlds: int,
    *,
    groups: Groups = "all",
    seed: int | None = None,
    threads: int = 1,
    max_episode_steps: int | None = None,
    actions: str = "joint",
    observations: str = "flat",
    scaled: bool = False,
    device: Any = "cpu",
    **numbers: Unpack[Numbers],
) -> SurvivalTorchEnv:
    """Make many worlds for TorchRL.

    >>> env = outlast.adapters.make_torchrl("teams_3", num_worlds=64, groups="sides", scaled=True)
    >>> print(env.rollout(100))

    Arguments that are not listed, numbers and errors are those of `outlast.make_vec`.

    Args:
        groups: "all": a single group, "agents". "sides": a group for each side, "team_0", or "agent_0" in free-for-all.
            "roles": a group for each role, called by its name. Or names of agents by group: {"hunters": ["agent_0"],
            ...}. ValueError if they are not the same in all episodes.
        max_episode_steps: Ticks after which a world is truncated; it sets the scenario's ending_limit.
        actions: "joint", an integer for all actions of an agent, which TorchRL's discrete losses need; "multi"; or
            "continuous", which its losses with continuous actions need.
        device: The device of tensors; the worlds are on the CPU.
    """
    asked = requested(make_torchrl, scenario, numbers, max_episode_steps)
    base_env = SurvivalVectorEnv(asked, num_worlds, autoreset_mode="Disabled", copy=False, **world_options(locals()))
    return SurvivalTorchEnv(base_env, groups, device)


class SurvivalTorchEnv(Pictured, EnvBase):  # type: ignore[misc]  # untyped
    """All worlds of a SurvivalVectorEnv; made by `outlast.adapters.make_torchrl`. Batch size: (worlds,).

    ==================== ========================================================================================
    (group, observation) float32 (worlds, n, ...): n agents of the group; with observations="dict" entries by key
    (group, action)      int64 (worlds, n), or (worlds, n, actions); float32 with actions="continuous"
    (group, action_mask) bool (worlds, n, entries), see SurvivalVectorEnv.action_masks; not with actions="continuous"
    (group, mask)        bool (worlds, n): whether the agent is alive
    (group, present)     bool (worlds, n): whether the episode has the agent; only if the number of agents varies
    (group, reward)      float32 (worlds, n, 1)
    state                float32 (worlds, size): the complete world, for critics; see SurvivalVectorEnv.state
    done, terminated,    bool (worlds, 1): worlds end for all of their agents at once. The dead stay until then, with
    truncated            the rewards of the scenario; their actions are ignored
    ==================== ========================================================================================

    TorchRL resets worlds that are done, each by itself ("_reset"). Until then, a step does not advance them, pays them
    0 and leaves them done, as happens inside a FrameSkipTransform. Worlds that "_step" leaves out do not advance,
    either. Every step has its own tensors, which the worlds write into. `set_seed(s)` and `reset(seed=s)` apply to all
    worlds: each gets the seed at its own next reset.

    Attributes:
        vector_env: The SurvivalVectorEnv below, whose autoreset mode is DISABLED.
        group_map: Names of agents by group.
        statistics: Statistics of the last episodes that ended, by name, (episodes,) or (episodes, n); {} before that.
        statistics_present: If counts vary, which agents and sides these episodes had, bool (episodes, n) by name.
    """

    def __init__(self, base_env: SurvivalVectorEnv, groups: Groups, device: Any) -> None:
        super().__init__(device=device, batch_size=torch.Size([base_env.num_worlds]))
        self.vector_env = base_env
        self.statistics, self.statistics_present = dict[str, Array](), dict[str, Array]()
        self._masked = base_env.action_mask_size > 0
        self._seed: int | None = int(base_env.worlds[Clock].seed[0, 0])
        self._waiting = np.ones(base_env.num_worlds, bool)  # worlds whose next reset uses the seed
        self._cut_off = torch.from_numpy(~self._waiting)  # worlds whose last step truncated their episode
        names = [f"agent_{i}" for i in range(base_env.num_agents)]
        self.group_map = _group_map(base_env, groups, names)
        self._members = {
            group: _selection([names.index(name) for name in own]) for group, own in self.group_map.items()
        }
        self._make_specs()

    def _make_specs(self) -> None:
        env, device = self.vector_env, self.device
        env._reader.check_fixed()
        seen, acts, rewards = (Composite(device=device) for _ in range(3))
        for group, own in self._members.items():
            n = len(self.group_map[group])
            parts = {"observation": _spec(env.single_observation_space, own, device), "mask": _flags((n,), device)}
            if counts_vary(env.worlds):
                parts["present"] = _flags((n,), device)
            if self._masked:
                parts["action_mask"] = _flags((n, env.action_mask_size), device)
            if env._actions.kind == "continuous":
                action: Any = _spec(env.single_action_space, own, device)
            elif env.noop.ndim:
                action = MultiCategorical(env.action_sizes.tolist(), (n, len(env.action_sizes)), device=device)
            else:
                action = Categorical(env.action_mask_size, (n,), device=device)
            reward = Unbounded((n, 1), dtype=torch.float32, device=device)
            seen[group] = Composite(parts, shape=(n,), device=device)
            acts[group] = Composite({"action": action}, shape=(n,), device=device)
            rewards[group] = Composite({"reward": reward}, shape=(n,), device=device)
        seen["state"] = _spec(env.state_space, ..., device)
        ends = Composite({name: _flags((1,), device) for name in ("done", "terminated", "truncated")}, device=device)
        self.full_observation_spec_unbatched, self.full_action_spec_unbatched = seen, acts
        self.full_reward_spec_unbatched, self.full_done_spec_unbatched = rewards, ends

    def _reset(
        self, tensordict: TensorDictBase | None = None, *, seed: int | None = None, **kwargs: Any
    ) -> TensorDictBase:
        if kwargs:
            raise TypeError(f"reset() has no keyword {', '.join(kwargs)}: it takes seed, which is as set_seed")
        if seed is not None:
            self._set_seed(seed)
        env = self.vector_env
        some = None if tensordict is None else tensordict.get("_reset", None)
        where = np.ones(env.num_worlds, bool) if some is None else some.cpu().numpy()[:, 0]
        where = where | ~env._tracker.running  # worlds that do not run have to be reset, too: at first, all of them
        keyed = where & self._waiting
        for seed, mask in ((self._seed, keyed), (None, where & ~keyed)):
            if mask.any():
                env.reset(seed=seed, options={"reset_mask": mask})
        self._waiting &= ~where
        out = self._room()
        env._check_running("reset")
        StepBuffers(env, out).fill()
        done = torch.from_numpy(env._tracker.done)  # worlds that had ended and were not reset now
        out["truncated"] = done & self._cut_off
        out["terminated"] = done & ~self._cut_off
        return self._entries(out)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        env, out = self.vector_env, self._room()
        some = tensordict.get("_step", None)  # which worlds to step; rollout(break_when_all_done=True) sets it
        going: Array = ~env._tracker.done  # FrameSkipTransform goes on stepping worlds that have ended
        if some is not None:
            going &= some.cpu().numpy().reshape(env.num_worlds)
        where = None if going.all() else going
        actions = np.tile(env.noop, (env.num_worlds, env.num_agents, *[1] * env.noop.ndim))
        for group, own in self._members.items():
            given = tensordict[group, "action"].detach().cpu().numpy()
            shape = (env.num_worlds, len(self.group_map[group]))
            who, what = f"agent {{1}} of {group} in world {{0}}", f"actions of the group {group}"
            # checked before they are assigned, as numpy would round numbers, and repeat a single one
            actions[:, own] = env._actions.checked(given, shape, False, axes="worlds, n", who=who, what=what)
        out |= {name: _empty((env.num_worlds,), torch.bool) for name in ("terminated", "truncated")}
        out["rewards"] = _empty((env.num_worlds, env.num_agents))
        *_, info = STEP(env, actions, out, where)
        if where is not None:
            out["rewards"][torch.from_numpy(~where)] = 0
        self._cut_off = out["truncated"] & ~out["terminated"]
        ended = info.get("_statistics", False) & going  # other worlds had ended before this step
        if ended.any():
            there = info.get("statistics_present", {})
            self.statistics = {name: values[ended] for name, values in info["statistics"].items()}
            self.statistics_present = {name: values[ended] for name, values in there.items()}
        return self._entries(out)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            keys(seed, 1, 0)
        self._seed = seed
        self._waiting[:] = seed is not None

    def _room(self) -> dict[str, Any]:
        """Return new tensors for a step, or a reset, to write into."""
        env = self.vector_env
        rows = env.num_worlds, env.num_agents
        room = {"observations": env._reader.room(_empty), "state": _empty((env.num_worlds, *env.state_space.shape))}
        if self._masked:
            room["action_mask"] = _empty((*rows, env.action_mask_size), torch.bool)
        return room

    def _entries(self, out: dict[str, Any]) -> TensorDictBase:
        """Return what TorchRL gets from a reset, and from a step, which has rewards, too."""
        flags = {key: torch.from_numpy(values) for key, values in self.vector_env._presence().items()}
        flags["mask"] = flags.pop("alive")
        data: dict[str, Any] = {"state": out["state"]}
        for group, own in self._members.items():
            parts = {
                "observation": each(out["observations"], lambda array: array[:, own]),  # noqa: B023
                **{key: values[:, own] for key, values in flags.items()},
            }
            if self._masked:
                parts["action_mask"] = out["action_mask"][:, own]
            if "rewards" in out:
                parts["reward"] = out["rewards"][:, own, None]
            data[group] = TensorDict(parts, batch_size=(*self.batch_size, len(self.group_map[group])))
        data |= {name: out[name][:, None] for name in ("terminated", "truncated")}
        data["done"] = data["terminated"] | data["truncated"]
        return TensorDict(data, batch_size=self.batch_size).to(self.device)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Close the worlds and their threads."""
        self.vector_env.close()
        super().close(raise_if_closed=raise_if_closed)


def _group_map(env: SurvivalVectorEnv, groups: Groups, names: list[str]) -> dict[str, list[str]]:
    """Return the names of agents by group. Raises ValueError if `groups` is not valid."""
    found: dict[str, list[str]] = {}
    if isinstance(groups, Mapping):
        given = [name for own in groups.values() for name in own]
        if any(type(name) is not str for name in given) or sorted(given) != sorted(names):
            raise ValueError(f"groups = {groups!r}: each of {', '.join(names)} has to be in one of them, once")
        found = {group: list(own) for group, own in groups.items()}
    else:
        check_choice("groups", groups, GROUPS, ", or names of agents by group")
        if groups == "all":
            return {"agents": names}
        roles, cure = env.worlds.layout.roles, "take 'all' or 'sides'"
        if groups == "roles" and (not roles or roles.random):
            raise ValueError(f"groups = 'roles': this scenario has no roles, or draws who has them; {cure}")
        if counts_vary(env.worlds):
            raise ValueError(f"groups = {groups!r}: the number of agents varies, so groups would, too; take 'all'")
        env.reset()  # to see who is on which side, or has which role; the first reset begins these episodes again
        numbers = (side(env.worlds) if groups == "sides" else env.worlds[AgentRoles].role)[0]
        called = env.sides if groups == "sides" else env.roles
        for name, number in zip(names, numbers.tolist(), strict=True):
            found.setdefault(called[number].replace(" ", "_"), []).append(name)
    for group, own in found.items():
        if type(group) is not str or not group or group in TAKEN:
            raise ValueError(f"groups: a group cannot be called {group!r}; take a text other than {', '.join(TAKEN)}")
        if not own:
            raise ValueError(f"groups: {group!r} has no agents; leave it out")
    return found


def _selection(indices: list[int]) -> Any:
    """Return an index of agents: if possible a slice, as that copies nothing."""
    run = range(indices[0], indices[0] + len(indices))
    return slice(run.start, run.stop) if indices == list(run) else indices


def _spec(space: Any, agents: Any, device: Any) -> Any:
    """Return the spec of some agents' part of a Box or a Dict of Boxes: Bounded if all ends are finite."""
    if isinstance(space, spaces.Dict):
        parts = {key: _spec(box, agents, device) for key, box in space.items()}
        return Composite(parts, shape=next(iter(parts.values())).shape[:1], device=device)
    low, high = (torch.from_numpy(ends[agents]) for ends in (space.low, space.high))
    if torch.isfinite(low).all() and torch.isfinite(high).all():
        return Bounded(low, high, dtype=torch.float32, device=device)
    return Unbounded(low.shape, dtype=torch.float32, device=device)


def _flags(shape: tuple[int, ...], device: Any) -> Any:
    return Categorical(2, shape, dtype=torch.bool, device=device)


def _empty(shape: Sequence[int], dtype: Any = torch.float32) -> Any:
    return torch.empty(tuple(shape), dtype=dtype, device="cpu")
