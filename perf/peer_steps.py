"""Steps of a simulator, timed in a process of the Python that has it: perf.peers runs this file as a script.

Its arguments are the name of a function below, a game, a number of worlds and options as JSON. It writes a line of JSON
when it is ready, and the CPU seconds of a step of all worlds for each line that it reads. Actions are random: drawn
before the clock starts or, for JAX, in the compiled step.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

SECONDS = 0.7  # of a measurement
DRAWS = 20  # different actions
SCANNED = 50  # steps in a call of a compiled scan
Made = tuple[int, int, Callable[[int], object]]  # agents of a world, steps of a call, and the call


def outlast(game: str, worlds: int, **numbers: Any) -> Made:
    """Episodes of 100 steps that restart by themselves; worlds are spread over all steps of their episodes."""
    root = Path(__file__).resolve().parents[1]
    sys.path[:1] = [str(root), str(root / "docs" / "examples")]
    from outlast import make_vec, variant
    from perf.measure import stepper

    module, _, name = game.rpartition(":")
    scenario = (getattr(import_module(module), name) if module else variant(name)).replace(**numbers)
    return make_vec(scenario, 1).num_agents, 1, stepper(scenario, worlds)


def vmas(game: str, worlds: int, **options: Any) -> Made:
    """Continuous actions; worlds are not reset at the end of an episode, which VMAS leaves to its caller."""
    import torch

    torch.set_num_threads(1)
    env = import_module("vmas").make_env(game, num_envs=worlds, device="cpu", seed=0, **options)
    env.reset()
    draws = [[env.get_random_action(agent) for agent in env.agents] for _ in range(DRAWS)]
    return len(env.agents), 1, lambda k: env.step(draws[k % DRAWS])


def jaxmarl(game: str, worlds: int, level: str = "") -> Made:
    """A scan of env.step, which restarts episodes by itself."""
    jax, library = import_module("jax"), import_module("jaxmarl")
    levels = import_module("jaxmarl.environments.smax").map_name_to_scenario
    env = library.make(game, **({"scenario": levels(level)} if level else {}))

    def step(state: Any, key: Any) -> Any:
        keys = jax.random.split(key, len(env.agents) + 1)
        sizes = {agent: env.action_space(agent).n for agent in env.agents}
        acts = {a: jax.random.randint(k, (worlds,), 0, n) for (a, n), k in zip(sizes.items(), keys[1:], strict=True)}
        return jax.vmap(env.step)(jax.random.split(keys[0], worlds), state, acts)[1]

    state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), worlds))[1]
    return len(env.agents), SCANNED, scan(step, state, SCANNED)


def battlegrounds(game: str, worlds: int) -> Made:
    """Legal random actions of two teams of five; games that ended restart."""
    jax = import_module("jax")
    env = import_module("marl_battlegrounds").make(game, map_id=0, num_envs=worlds, metrics="none")

    def step(state: Any, key: Any) -> Any:
        act, go, reset = jax.random.split(key, 3)
        state = env.step(go, state, env.sample_actions(act, state))[1]
        return env.reset_done(reset, state)[1]

    return 10, 1, scan(step, env.reset(jax.random.key(0))[1], 1)


def scan(step: Callable[[Any, Any], Any], state: Any, steps: int) -> Callable[[int], object]:
    """Return calls of a compiled loop of that many steps, each of which goes on from the state of the one before."""
    jax, kept = import_module("jax"), [state]
    many = jax.jit(
        lambda state, key: jax.lax.scan(lambda s, k: (step(s, k), None), state, jax.random.split(key, steps))[0]
    )

    def call(k: int) -> None:
        kept[0] = jax.block_until_ready(many(kept[0], jax.random.key(k)))

    return call


def parallel(game: str, worlds: int, **options: Any) -> Made:
    """One world of PettingZoo's parallel interface; `game` is the module that has parallel_env."""
    return dictionaries(import_module(game).parallel_env(**options))


def pogema(game: str, worlds: int, **options: Any) -> Made:
    """One world of it, by PettingZoo's interface."""
    library = import_module("pogema")
    return dictionaries(library.pogema_v0(library.GridConfig(integration="PettingZoo", **options)))


def dictionaries(env: Any) -> Made:
    """Actions by agent; the next episode begins when no agent is left."""
    env.reset(seed=0)
    agents = list(env.agents)
    draws = [{agent: env.action_space(agent).sample() for agent in agents} for _ in range(DRAWS)]

    def call(k: int) -> None:
        env.step({agent: draws[k % DRAWS][agent] for agent in env.agents})
        if not env.agents:
            env.reset()

    return len(agents), 1, call


def foraging(game: str, worlds: int) -> Made:
    """One world of Gymnasium's interface, with a tuple of actions."""
    import_module("lbforaging")
    env = import_module("gymnasium").make(game).unwrapped
    env.reset(seed=0)
    draws = [env.action_space.sample() for _ in range(DRAWS)]

    def call(k: int) -> None:
        *_, terminated, truncated, _ = env.step(draws[k % DRAWS])
        if terminated or truncated:
            env.reset()

    return len(draws[0]), 1, call


def main(maker: str, game: str, worlds: str, options: str) -> None:
    """Answer each line of the standard input with a measurement."""
    agents, steps, call = globals()[maker](game, int(worlds), **json.loads(options))
    call(0)
    start = time.process_time()
    call(1)
    calls = max(1, round(SECONDS / max(time.process_time() - start, 1e-6)))
    print(json.dumps({"agents": agents}), file=sys.__stdout__, flush=True)
    for _ in sys.stdin:
        start = time.process_time()
        for k in range(calls):
            call(k)
        seconds = (time.process_time() - start) / calls / steps
        print(json.dumps(seconds), file=sys.__stdout__, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
