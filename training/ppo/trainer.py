"""Training: learners, the worlds that they play in, and their opponents; and its state, with which a run continues."""

import io
import json
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch

import outlast
from outlast.components import Sides
from outlast.components.agent import side_names
from outlast.ecs.kernels.errors import meant
from outlast.envs.core.observations import GlobalState
from outlast.envs.core.spaces import side
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.levels import Level
from outlast.envs.rollout.memory import told
from outlast.envs.rollout.saved import common_scenario, is_saved
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.snapshots.state import State, read

from ..arena.opponent_pool import OpponentPool, plain
from ..base import policy_file
from ..base.config import CODE, IMITATED, TrainingConfig, name_of
from ..base.errors import TrainingError
from ..base.metrics import check_statistics, means
from ..base.observation_layout import field_table, layout_of, scales
from ..base.presets import Preset, preset
from ..policies import checkpoint
from ..policies.checkpoint import HEAVIEST, REST, WORLDS, check_state, policies_content, wrong_weight
from ..policies.player import Player
from ..policies.policy import ActorCritic, Networks, check_outputs
from ..policies.rows import PaddedRows
from .crew import Crew
from .curriculum import Curriculum, TrainingProgress, joined
from .learner import Learner
from .loss import imitation_loss, ppo_loss
from .rollout import Lane, Rollout

Array = np.ndarray[Any, Any]
WORLD_THREADS = 4  # more do not help with the few worlds of a rollout
LAST = 2**53  # maximum updates of an optimiser, which counts them in float32
GENERATOR = 5056, 624  # bytes of the state of PyTorch's generator of random numbers, numbers drawn at once
IMITATION = {"learning_rate": 2e-3, "anneal_lr": True, "batch_size": 1024, "n_epochs": 1, "target_kl": 0.0}
LARGEST = 1e18  # the largest observation: float32 still holds its square
LOSSES = ("train/value_loss", "train/policy_loss", "train/loss", "imitation/value_loss", "imitation/cross_entropy")
IMITATION_FIGURES = "cross_entropy", "value_loss", "entropy", "differs"  # the figures of imitation_loss that are logged


class Trainer:
    """Learners, and the worlds that they play in.

    PyTorch itself runs on one thread, as its own threads slow down networks this small.

    Attributes:
        team: int (agents of a world,), the number of the learner that plays each agent.
        learners: One for all agents, or one for each side or agent.
        state: Numbers of the state of a world, if critics learn from it; otherwise 0.
        state_scale: Divisors of these numbers, float32 (state,).
        steps: Agent-steps collected so far, by all processes.
        played: The value of `steps` when the newest rollout began, which determines its annealed numbers.
        crew: The processes that train together; `env` and `lane` have this one's share of the worlds.
    """

    def __init__(self, config: TrainingConfig, threads: int = 1, crew: Crew | None = None) -> None:
        """Create worlds and networks. Raises ScenarioError or TrainingError if that is impossible.

        threads: Share the worlds, up to WORLD_THREADS, and then the minibatches. crew: As many processes as the config
        has; each creates a trainer of the same config, and calls the same methods in order.
        """
        self.config, self.preset, self.device = config, preset(config.preset), _device(config.device)
        self.crew, self.threads, self.steps, self.played, self.updates = crew or Crew(), threads, 0, 0, 0
        self.worlds, rollout = config.size
        self.rollout_steps = rollout // self.worlds
        players = {name: Player(name) for name in config.opponents if is_saved(name)}
        name, imitated = config.teacher
        self.teacher = Player(name, config.seed) if imitated and is_saved(name) else None
        seeing = [*players.values()] + [self.teacher] * (self.teacher is not None)
        scenario = common_scenario(self.preset.scenario(config.scenario), seeing)
        with self.crew.first_ahead():
            own, at_once = self.crew.share(self.worlds), min(WORLD_THREADS, threads)
            settings: dict[str, Any] = {"autoreset_mode": "Disabled", "copy": False, "check_actions": False}
            settings |= {"seed": config.seed, "threads": at_once, "first_world": own.start}
            self.env = outlast.make_vec(scenario, len(own), **settings)
            self.env.reset(seed=config.seed)
        check_statistics(self.env, "length")
        if not len(self.env.action_sizes):
            raise TrainingError("agents have no actions here: add a mechanic with some, such as Motors")
        if self.teacher is not None:
            self.teacher.check(self.env)
        for done in (config.steps, 0):  # raises an error if a number cannot change
            self._set_numbers(done)
        self.layout = layout_of(self.env)
        self.team, names = teams(self.env, config.policies)
        self.presets = by_name("preset", self.preset.sides or {"": self.preset}, names)
        numbers = by_name("settings", config.numbers_by_policy, names)
        networks = config.networks if isinstance(config.networks, Mapping) else {"": config.networks}
        self.networks = by_name("networks", {"": None, **networks}, names)
        self.state_scale = GlobalState(self.env.worlds).scale if config.critic == "state" else np.empty(0, np.float32)
        self.state = len(self.state_scale)
        with torch.random.fork_rng(devices=[]):
            torch.default_generator.manual_seed(config.seed)  # for initial weights, on the CPU only
            first = [self._policy(*each) for each in zip(self.networks, self.presets, strict=True)]
        shared = self.crew, self.device, config.loss or ppo_loss
        self.learners = [
            Learner(policy, own, torch.Generator().manual_seed(config.seed), number, *shared)
            for number, (policy, own) in enumerate(zip(first, numbers, strict=True))
        ]
        self.opponents = OpponentPool(
            config.opponents, players, self.env, prioritised=config.prioritised, memory=config.memory
        )
        if not self.opponents.alone and self.env.worlds.dims["sides"] < 2:
            raise TrainingError("opponents need a side of their own, but this game has one side: leave them out")
        self.curriculum = config.levels and Curriculum(config.levels, self.env)
        self.lane = Lane(config, self.env, self.presets, self.team, self.opponents, self.curriculum, self.crew)
        for policy, kind in zip(self.policies, self.networks, strict=True):
            if kind is not None:
                check_outputs(policy, self.lane.observe()[policy.preset.form])

    @property
    def policies(self) -> list[Networks]:
        """The policies of the learners."""
        return [learner.policy for learner in self.learners]

    @property
    def network_names(self) -> list[str]:
        """Return the full name of each policy's networks, if they are the user's own; otherwise ""."""
        return [name_of(kind) if kind else "" for kind in self.networks]

    def collect(self) -> Rollout:
        """Continue to play and return the samples. Levels are chosen before the first rollout, and after each one."""
        self.played = self.steps  # the agent-steps that determine this rollout's numbers
        self._set_numbers(self.steps)
        if self.curriculum is not None and not self.steps:
            self._ask(self.curriculum)
            if any(level != Level() for level in self.curriculum.levels):
                self.lane.restart()
        begun = self.steps // (self.worlds * self.env.num_agents)
        rollout = self.lane.collect(self.policies, self.rollout_steps, begun)
        self.opponents.record_all(self._everyones(lambda lane: lane.games))
        self.steps += rollout.learner.size
        if self.curriculum is not None:
            self._ask(self.curriculum)
        return rollout

    def _ask(self, curriculum: Curriculum) -> None:
        """Let the function choose the levels of the next episodes."""
        seeds = self.config.seed, self.steps
        own = int(np.random.SeedSequence(seeds).generate_state(1)[0])
        played, statistics = joined(self.lane.played, self.env)
        progress = TrainingProgress(
            scenario=self.env.scenario,
            steps=self.steps,
            seed=self.config.seed,
            rng=np.random.default_rng(seeds),
            policy=Player(self.policy_files(self.config.header()), own),
            levels=curriculum.levels,
            played=played,
            statistics=statistics,
        )
        curriculum.take(curriculum.choose(progress))

    def policy_files(self, header: Mapping[str, Any]) -> dict[str, bytes]:
        """Return the files of a checkpoint that a Player needs. header: Further entries of run.json."""
        first = {"version": policy_file.VERSION, "steps": self.steps, "preset": self.preset.name}
        last = {
            "scenario": fingerprint(self.env.scenario),
            "observations": self.layout.shapes,
            "fields": field_table(self.env.fields),
            "actions": [int(size) for size in self.env.action_sizes],
            "team": self.team.tolist(),
            "memory": self.config.memory,
            "state": self.state,
            "state_scale": self.state_scale.tolist(),
        }
        if self.preset.sides:
            last["presets"] = [each.name for each in self.presets]
        if self.config.networks is not None:
            own = self.network_names
            last["networks"] = own if isinstance(self.config.networks, Mapping) else own[0]
        return {
            policy_file.RUN_JSON: json.dumps({**first, **header, **last}, indent=1).encode(),
            policy_file.WEIGHTS: policies_content([policy.state_dict() for policy in self.policies]),
        }

    def update(
        self, rollout: Rollout, left: float = 1.0, on_epoch: Callable[[int], None] = lambda epoch: None
    ) -> dict[str, float]:
        """Train all learners on a rollout, and add them to the past selves every config.snapshots updates.

        left: Share of the run that remains, for a learning rate that is annealed. on_epoch: Called with the number of
        each epoch as it begins. Returns the values to log by tag, means over the learners.
        """
        with ThreadPoolExecutor(self.threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            shared = pool.map if self.threads > 1 else map
            logged = [learner.update(rollout, left, on_epoch, shared) for learner in self.learners]
        self.updates += 1
        if self.updates % self.config.snapshots == 0:
            playing = set(self._everyones(lambda lane: np.unique(lane.opponent).tolist()))
            self.opponents.remember(self.policies, self.steps, playing)
        return means({tag: (value, 1.0) for tag, value in tags.items()} for tags in logged)

    def report(self) -> dict[str, float]:
        """Return the values to log about the newest rollout by tag."""
        numbers = {f"anneal/{each.name}": each.value(self.played, self.config.scenario) for each in self.config.anneal}
        return means(self._everyones(lambda lane: [lane.tallies()])) | self.opponents.report() | numbers

    def take_weights(self) -> None:
        """Load the weights of the checkpoint that the config names, if any. Raises TrainingError."""
        name, imitated = self.config.teacher
        if imitated or not name:
            return
        player, cure = Player(name), f"imitate it instead: --warm-start {name}:{IMITATED}"
        player.check(self.env, counts=False)
        found, here = (
            f"of {' and '.join({one or f'preset {chosen.name!r}': 0 for one, chosen in zip(*each, strict=True)})} with "
            f"memory {memory} and state {state}"
            for *each, memory, state in (
                (player.networks, player.presets, player.memory, player.state),
                (self.network_names, self.presets, self.config.memory, self.state),
            )
        )
        its_sides, count = self.config.policies == "side", len(self.learners)
        fits = len(player.policies) in (1, count) or (its_sides and len(player.policies) > count)
        if found != here or not fits:  # of more policies, those of the first sides are taken
            found, here = f"{len(player.policies)} {found}", f"{len(self.learners)} {here}"
            raise TrainingError(f"the policies in {name} are {found}, but those to be trained {here}; {cure}")
        if not player.critic:
            raise TrainingError(f"{name} has no critic, which a run needs to start from weights; {cure}")
        its = np.array(player.header.get("state_scale", []), np.float32)
        if len(its) != self.state:
            raise TrainingError(f"{name} has no record of how the state of its critic was scaled; {cure}")
        for k, policy in enumerate(self.policies):
            policy.take(player.policies[k % len(player.policies)], self.state_scale / its)

    def imitate(self, on_rollout: Callable[[int, dict[str, float]], None]) -> dict[str, float]:
        """Train the policies to imitate the teacher, if the config names one, while they play as in the run.

        They learn the teacher's actions in the situations that they get into themselves (Ross, Gordon and Bagnell,
        arXiv:1011.0686), and their critics the returns of that play. Afterwards, only the optimisers are reset;
        learners and worlds have moved on. Games against opponents do not count.

        on_rollout: Called after each rollout with the agent-steps done so far, and measurements by tag. Returns the
        last measurements.
        """
        name, steps = self.config.teacher
        if not steps:
            return {}
        shared = self.crew, self.device, imitation_loss
        imitators = [
            Learner(own.policy, own.numbers.changed(IMITATION), own.generator, own.number, *shared)
            for own in self.learners
        ]
        tags = dict[str, float]()
        if self.teacher is None:
            self.lane.teacher = plain(name, self.env)
        else:
            play = told(self.teacher, self.env)  # it plays all agents at once, since it may have a memory
            self.lane.teacher = lambda seen, uniform: np.asarray(play(self.env.observe())).reshape(uniform.shape)
        each = self.rollout_steps * self.worlds * self.env.num_agents
        for done in range(0, steps, each):
            rollout = self.lane.collect(self.policies, self.rollout_steps, done // each * self.rollout_steps)
            logged = [imitator.update(rollout, 1 - done / steps) for imitator in imitators]
            found = means({tag: (value, 1.0) for tag, value in own.items()} for own in logged)
            tags = {f"imitation/{name}": found[f"train/{name}"] for name in IMITATION_FIGURES if found}
            on_rollout(done + each, tags | self.report())
        self.lane.teacher, self.lane.played = None, []  # since a resumed run lacks these episodes
        return tags | {"imitation/agent_steps": float(done + each)}

    def _set_numbers(self, done: int) -> None:
        """Set annealed numbers to their values after `done` agent-steps."""
        if numbers := {each.name: each.value(done, self.config.scenario) for each in self.config.anneal}:
            self.env.set_numbers(**numbers)

    def captured(self) -> tuple[State, dict[str, Array]]:
        """Return the worlds of all processes, and the states of their lanes, (worlds, ...) by name."""
        state = self.env.get_state()
        return State(state.scenario, self.merged(state.arrays)), self.merged(self.lane.state())

    def merged(self, own: Mapping[str, Array]) -> dict[str, Array]:
        """Return arrays of all processes, by name, in order of the worlds."""
        return {name: self.crew.gather(np.ascontiguousarray(values)) for name, values in own.items()}

    def _everyones(self, get: Callable[[Lane], list[Any]]) -> list[Any]:
        return [each for part in self.crew.gather_values(get(self.lane)) for each in part]

    def _policy(self, kind: Any, chosen: Preset) -> Networks:
        kind = kind or ActorCritic
        if not (isinstance(kind, type) and issubclass(kind, Networks)):
            raise TrainingError(f"networks = {kind!r:.200}: {CODE['networks']}")
        return kind(
            [int(size) for size in self.env.action_sizes],
            layout=self.layout,
            preset=chosen,
            scales=scales(self.layout, field_table(self.env.fields)),
            memory=self.config.memory,
            state=self.state,
        )


def teams(env: SurvivalVectorEnv, policies: str) -> tuple[Array, Sequence[str]]:
    """Return the number of each agent's learner, int (agents,), and the learners' names."""
    if policies == "side" and env.worlds[Sides].teams[0, 0]:
        found = side(env.worlds, 0)
        return found, side_names(env.worlds.layout)[: found.max() + 1]
    each = np.arange(env.num_agents)
    return (0 * each, [""]) if policies == "shared" else (each, [f"agent {i}" for i in each])


def by_name(what: str, given: Mapping[str, Any], names: Sequence[str]) -> list[Any]:
    """Return the entry of `given` of each of these policies, or else that under ""; TrainingError for other names."""
    if unknown := [name for name in given if name and name not in names]:
        raise TrainingError(f"{what}: unknown policy '{unknown[0]}'; {meant(unknown[0], names)}")
    return [given.get(name, given[""]) for name in names]


def _device(name: Any) -> torch.device:
    """Return the device of that name. Raises TrainingError if it does not exist."""
    try:
        device = torch.device(name)
        torch.empty(0, dtype=torch.float32, device=device)
    except (RuntimeError, AssertionError) as error:
        raise TrainingError(f"device {name} does not exist here; take cpu") from error
    return device


def check_learned(trainer: Trainer, tags: Mapping[str, float], what: str, cure: str) -> None:
    """Raise TrainingError if weights or a loss are not finite. what, cure: Parts of the message."""
    weights = (wrong_weight(policy.state_dict()) for policy in trainer.policies)
    wrong = [f"{name} has numbers that are NaN or beyond {HEAVIEST}" for name in weights if name]
    wrong += [f"{tag} is {tags[tag]}" for tag in LOSSES if not math.isfinite(tags.get(tag, 0.0))]
    if not wrong:
        return
    for name in strange_observations(trainer.lane):
        raise TrainingError(
            f"observations have numbers that are not finite, or beyond {LARGEST:g}: {name}. A mechanic "
            "computes them, as by 0 / 0 or the root of a negative number; outlast check looks for them"
        )
    raise TrainingError(f"{what} {wrong[0]}; begin again {cure}")


def strange_observations(lane: Lane) -> Iterator[str]:
    """Yield keys, with fields where known, of observations that networks cannot use; an agent's own come first."""
    layout, samples, now = lane.packer.layout, lane.samples, lane.env.observe()
    views = [layout.own_views(samples.own), layout.own_views(lane.packer.own(now))]
    last = {form: packer(now) for form, packer in lane.packers.items()}  # what gives the values after the last step
    for seen in (each for step in (*lane.seen, last) for each in step.values()):
        if isinstance(seen, PaddedRows):
            views.append(layout.views(seen.packed.numpy()))
        else:
            ends = np.cumsum([kind.features for kind in layout.kinds])
            parts = np.split(seen.entities.numpy(), ends, 1)  # the last part marks the kind of each entity
            views.append({kind.key: part for kind, part in zip(layout.kinds, parts, strict=False)})
    for each in views:
        for key, values in each.items():
            columns = ~(np.abs(values) <= LARGEST).reshape(-1, values.shape[-1]).all(0)
            names = [name for name, (size, _) in layout.fields.get(key, {}).items() for _ in range(int(size))]
            for column in np.flatnonzero(columns):
                yield f"{key}.{names[column % len(names)]}" if names else key
    states = (each.state for step in lane.seen for each in step.values())
    if any(state is not None and not state.isfinite().all() for state in states):
        yield "the state of the worlds, which critics see"
    if not np.isfinite(samples.later).all():
        yield "those where an episode was cut off"


def capture(trainer: Trainer, header: dict[str, Any]) -> dict[str, bytes]:
    """Return the files of a checkpoint. All processes must call it. header: Further entries of run.json."""
    worlds, lanes = trainer.captured()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, WORLDS)
        worlds.save(path)
        state = path.read_bytes()
    return {**trainer.policy_files(header), REST: checkpoint.tree_content(_rest(trainer, lanes)), WORLDS: state}


def _rest(trainer: Trainer, lanes: dict[str, Any]) -> dict[str, Any]:
    """Return the state of a run besides its policies and worlds, as a tree. lanes: See Trainer.captured."""
    rest = {
        "learners": [
            {
                "optimiser": {str(k): moments for k, moments in enumerate(learner.optimizer.moments)},
                "minibatches": learner.generator.get_state(),
                "epochs": learner.epochs,
            }
            for learner in trainer.learners
        ],
        "updates": trainer.updates,
        "rewards": trainer.lane.scale.state(),
        "lane": {name: torch.from_numpy(values) for name, values in lanes.items()},
        "opponents": trainer.opponents.state(),
    }
    return rest if trainer.curriculum is None else rest | {"levels": trainer.curriculum.state()}


def restore(trainer: Trainer, files: dict[str, bytes]) -> None:
    """Restore a new trainer of the same config. Raises StateError: of another scenario, or TrainingError."""
    header, rest = checkpoint.header_of(files), checkpoint.load_tree(files, REST)
    weights = checkpoint.policies_in(files)
    checkpoint.check_fields(header, trainer.env)
    factors = scales(trainer.layout, header["fields"])
    if len(weights) != len(trainer.learners):
        raise TrainingError(f"the checkpoint has {len(weights)} policies, but the run {len(trainer.learners)}")
    check_state(rest, _rest(trainer, trainer.merged(trainer.lane.state())) | {"opponents": None})  # checked by the pool
    for learner, given in zip(trainer.learners, rest["learners"], strict=True):
        _check_learner(learner, given)
    worlds, env = read(io.BytesIO(files[WORLDS]), f"{WORLDS} of the checkpoint"), trainer.env
    mine = slice(env.first_world, env.first_world + env.num_worlds)
    env.set_state(worlds[mine] if len(worlds) == trainer.worlds else worlds)
    for learner, given, own in zip(trainer.learners, rest["learners"], weights, strict=True):
        checkpoint.load_weights(learner.policy, own)
        learner.policy.rescale(factors)
        learner.optimizer.restore([given["optimiser"][str(k)] for k in range(len(learner.parameters))])
        learner.generator.set_state(given["minibatches"].clone())
        learner.epochs = given["epochs"]
    trainer.updates = rest["updates"]
    trainer.lane.scale.restore(rest["rewards"])
    past = rest["opponents"].get("past") if isinstance(rest["opponents"], dict) else None
    each = sum(weight.nbytes for policy in trainer.policies for weight in policy.state_dict().values())
    if isinstance(past, dict) and len(past) * each > len(files[REST]):
        raise TrainingError(
            f"{REST} of the checkpoint does not fit the run: it is too small for {len(past)} past selves"
        )
    trainer.opponents.restore(rest["opponents"], trainer.policies, header["plan"].get("opponents", ""))
    if trainer.curriculum is not None:
        trainer.curriculum.restore(rest["levels"])
    trainer.lane.restore({name: values.numpy()[mine] for name, values in rest["lane"].items()})
    trainer.steps = header["steps"]


def _check_learner(learner: Learner, given: dict[str, Any]) -> None:
    """Check the steps of the optimiser, and the generator's place in its table, both unchecked by PyTorch."""
    for k, moments in given["optimiser"].items():
        if not 0 <= float(moments["step"]) <= LAST:
            raise TrainingError(f"step of parameter {k} in {REST} of the checkpoint is {float(moments['step'])}")
    size, count = GENERATOR
    if len(found := bytes(given["minibatches"].tolist())) == size:
        left, place = (int.from_bytes(found[a:b], "little") for a, b in ((8, 12), (16, 24)))
        if not 1 <= left <= count or place + left > count + 1:
            raise TrainingError(f"a random generator in {REST} of the checkpoint is in an invalid state")
