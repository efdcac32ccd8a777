"""Training in one call: `outlast train`, and outlast.train."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from outlast.envs.api.options import options_of
from outlast.envs.errors import needed
from outlast.envs.rollout.saved import newest
from outlast.envs.scenarios.known_numbers import Numbers
from outlast.envs.scenarios.parse import checks_keywords, resolve
from outlast.envs.scenarios.parse import options_of as arguments_of
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.storage.interrupts import children_awaited

from ..base.config import FAST, SELF, Choose, RunOptions, TrainingConfig
from ..base.curves import LOG, read_log
from ..base.errors import TrainingError
from ..base.presets import KINDS
from ..base.quantities import LiveView

if TYPE_CHECKING:
    from .run import TrainingRun


@dataclass(frozen=True)
class TrainedRun:
    """A run that is complete.

    Attributes:
        folder: Folder with run.json, log.csv, TensorBoard's events and checkpoints, for `outlast.evaluate` and
            `outlast.plot`.
        policy: The newest checkpoint, for `outlast.load_policy`.
        steps: Agent-steps of training of the newest checkpoint.
        logged: The last logged numbers, by tag.
    """

    folder: Path
    policy: Path
    steps: int
    logged: dict[str, float]


@checks_keywords
def train(
    scenario: str | Scenario,
    folder: str | Path | None = None,
    *,
    resume: bool = False,
    film: bool = False,
    quiet: bool = False,
    cluster: str | None = None,
    callbacks: Sequence[Any] = (),
    preset: str = FAST,
    steps: int = 10_000_000,
    seed: int = 0,
    worlds: int = 0,
    rollout: int = 0,
    dead: str = "keep",
    device: str = "cpu",
    threads: int = 0,
    every: int = 1_000_000,
    settings: Mapping[str, Any] | None = None,
    policies: str = "shared",
    opponents: str | Mapping[str | os.PathLike[str], float] = SELF,
    prioritised: bool = False,
    snapshots: int = 10,
    processes: int = 1,
    memory: int = 0,
    critic: str = "own",
    warm_start: str | os.PathLike[str] = "",
    anneal: str | Sequence[str] = (),
    levels: Choose | None = None,
    loss: Callable[[Any], Any] | None = None,
    networks: type | Mapping[str, type] | None = None,
    **numbers: Unpack[Numbers],
) -> TrainedRun:
    """Train the agents of a scenario with PPO; `outlast train` does the same. Ctrl-C saves the run, and is then raised.

    >>> run = outlast.train("ffa_2", steps=2_000_000, opponents="self:0.8,scripted:0.2", melee_damage=20)
    >>> print(outlast.evaluate("ffa_2", [run.folder, "scripted"], melee_damage=20))

    Args:
        scenario: A Scenario or the name of one: "ffa_2", "mygame.py:arena".
        folder: Folder of the run, or the folder around those of several runs (default runs/VARIANT-PRESET-SEED).
        resume: Whether to resume from the newest checkpoint in the folder of the run.
        film: Whether to make a short film of each checkpoint, a .webm file beside it.
        quiet: Whether to show no progress bar.
        cluster: Have all processes but the first on the Ray cluster at ADDRESS; without ADDRESS, on that of
            $RAY_ADDRESS, the one on this machine, or a new one here (default: no cluster). "" stands for no ADDRESS.
        callbacks: Objects with some of the methods of outlast.training.runs.run.Callbacks, called during the run.
        preset: Networks, numbers of PPO and size of a rollout: fast; original, what the paper's authors ran; paper,
            what the paper's text says; scaled, which is paper with inputs of about -1 to 1; with policies=side, one
            side can have another one, as in fast,seeker:paper.
        steps: Agent-steps to train for, rounded up to whole rollouts.
        seed: The same seed gives the same numbers.
        worlds: Worlds that are stepped together (default: 0, as in the preset; fast has 512 agents in all, others 64
            worlds, the paper 1).
        rollout: Environment steps of all worlds together between two updates (default: 0, as in the preset; fast has
            128 of each world, others 16384, as the paper).
        dead: Learn also from the steps of dead agents (keep), or leave them out (drop).
        device: PyTorch's device on which policies are updated, such as cuda; they always play on the CPU.
        threads: Threads of each process, with the same results (default: 0, which is cores / processes; of several runs
            1).
        every: Agent-steps between two checkpoints.
        settings: Numbers of PPO that differ from the preset's, as in gamma=0.999, or with policies=side for one side,
            as in seeker:ent_coef=0.01: learning_rate, anneal_lr, batch_size, n_epochs, gamma, gae_lambda, clip_range,
            ent_coef, vf_coef, max_grad_norm, target_kl, scale_rewards. As a dict: {"gamma": 0.999}.
        policies: Train one policy for all agents (shared), one for each side, or one for each agent.
        opponents: The opponents of the agents, with weights, as in self:0.5,past:0.5. self is the policy itself, past
            one of its earlier selves; also random, noop, scripted, camper, hunter, hoarder, healer, a model's name,
            FILE.zip, FILE.safetensors or the folder of a run (default self). Also as a dict: {"self": 0.5, "past":
            0.5}.
        prioritised: Whether to draw an opponent the more often, the more games it wins.
        snapshots: With opponent past: number of updates until another earlier self is kept.
        processes: Processes that share the worlds of a run, with the same results up to rounding.
        memory: Size of each agent's memory, in numbers kept from step to step (default 0: no memory).
        critic: Learn values from what the agent observes (own), or from that and the state of the world (state).
        warm_start: Begin by imitating scripted, camper, hunter, hoarder, healer (for STEPS agent-steps, by default
            1.5e6) or FILE.zip:STEPS, or begin with the weights of FILE.zip; the folder of a run stands for its newest
            file (default: no such start).
        anneal: Change a number of the game linearly during training: rewards_kill=10:0@5e6 goes from 10 to 0 in the
            first 5 million agent-steps, and without @5e6 over the length of the run. As a text, or a list of several.
        levels: A function that chooses the levels to train in, called before each rollout with an
            outlast.training.ppo.curriculum.TrainingProgress; None: worlds draw their own.
        loss: The loss: a function of an outlast.training.ppo.minibatches.Batch; None: PPO's loss.
        networks: The class of the networks, an outlast.training.policies.policy.Networks, or a dict of classes by side;
            None: those of the preset.
        **numbers: Numbers of the scenario to change, as in melee_damage=20.

    Returns:
        The run: its folder, its newest checkpoint, and its last logged numbers.

    Raises:
        ScenarioError: The scenario or preset is unknown.
        NumberError: The scenario lacks a number (perhaps one of the arguments was meant).
        TrainingError: Another value is not allowed, or the run cannot begin or resume in the folder.
    """
    given, own = locals(), options_of(TrainingConfig)
    for name, value in numbers.items():
        if name in KINDS:
            raise TrainingError(f"{name} is a number of PPO: settings={{{name!r}: {value!r}}}")
    config = TrainingConfig(resolve(scenario, numbers, arguments_of(train)), **{name: given[name] for name in own})
    with needed("train", "outlast.train needs {}"):
        from .run import TrainingRun, check_callbacks
    check_callbacks(callbacks)
    place = Path(folder or Path("runs", config.folder_name()))
    with children_awaited():
        run = TrainingRun(config, place, resume=resume, film=film, cluster=cluster, callbacks=callbacks)
        shown(run, quiet=quiet)
    points = {} if run.tags else read_log(place / LOG)  # a run that was already complete
    last = max((steps for own in points.values() for steps, _ in own), default=0)
    logged = {tag: own[-1][1] for tag, own in points.items() if own[-1][0] == last}
    return TrainedRun(place, newest(place), run.saved, run.tags or logged)


TrainingConfig.described = RunOptions.described = train


def shown(run: "TrainingRun", *, quiet: bool) -> None:
    """Train, and show a summary, the progress and the remaining time of the run; see LiveView."""
    config, total = run.config, run.config.total
    about = f"{config.scenario.name}, preset {config.preset}, seed {config.seed}: {config.workload}"
    about += ", with an update after each"
    if run.anew:
        about += f"\nno checkpoint in {run.folder} yet: begins at 0"
    view = LiveView(run.done, total, quiet=quiet, about=about)

    def progress(run: "TrainingRun") -> None:
        ended = run.done >= config.steps
        view.update(run.done, run.done if ended else total, run.tags)
        view.now(run.now)

    try:
        run.train(progress)
    finally:
        view.close()
