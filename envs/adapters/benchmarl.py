"""BenchMARL: scenarios as tasks, with all worlds of a batch in one environment.

>>> from outlast.envs.adapters.benchmarl import OutlastTask, task
>>> Experiment(task=OutlastTask.TEAMS_2.get_task(), algorithm_config=MappoConfig.get_from_yaml(), ...)
>>> Experiment(task=task("teams_2+bounty", melee_damage=20), ...)
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from ..errors import needed
from ..scenarios.parse import resolve
from ..scenarios.scenario import Scenario
from .torchrl import SurvivalTorchEnv, make_torchrl

with needed("benchmarl", "this needs BenchMARL"):
    from benchmarl.environments.common import Task, TaskClass
    from torchrl.data import Composite
    from torchrl.envs import EnvBase

DEFAULTS = {"groups": "sides", "scaled": True}  # defaults for arguments of make_torchrl
EVALUATION = 1 << 32  # evaluations play the worlds from this number on, which training never reaches
LONGEST = 10_000  # ticks of an evaluation's episodes if the scenario has no time limit
TAKEN = {  # arguments of make_torchrl that a task does not take, and what to use instead
    "seed": "take seed= of BenchMARL's Experiment",
    "device": "take sampling_device of BenchMARL's ExperimentConfig",
    "num_worlds": "take on_policy_n_envs_per_worker or off_policy_n_envs_per_worker of BenchMARL's ExperimentConfig",
    "actions": "BenchMARL's algorithms take joint actions, which a task has, or continuous ones",
}


class OutlastClass(TaskClass):  # type: ignore[misc]  # untyped
    """A scenario as a task of BenchMARL; vectorised, with a state, and with discrete actions and masks.

    name: The name of the scenario. config: Arguments of `make_torchrl`, but for those in TAKEN, and numbers of the
    scenario; by default, sides are groups and observations are scaled. With actions="continuous" there are only
    continuous actions, and no masks. scenario: The scenario, if it cannot be found by its name.
    """

    def __init__(self, name: str, config: dict[str, Any], scenario: Scenario | None = None) -> None:
        for argument in TAKEN.keys() & config.keys():
            if argument != "actions" or config[argument] not in ("joint", "continuous"):
                raise ValueError(f"{argument} = {config[argument]!r} of a task: {TAKEN[argument]}; leave it out")
        super().__init__(name, config)
        self.scenario = scenario

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        # BenchMARL calls this with the same seed for evaluation and for training; see max_steps
        options = {**DEFAULTS, **self.config, "seed": seed, "device": device}
        return partial(make_torchrl, self.scenario or self.name.lower(), num_envs, **options)

    def supports_continuous_actions(self) -> bool:
        return bool(self.config.get("actions") == "continuous")

    def supports_discrete_actions(self) -> bool:
        return not self.supports_continuous_actions()

    def max_steps(self, env: SurvivalTorchEnv) -> int:
        """Return the ticks of an evaluation: the scenario's limit (the longest, if it varies), or LONGEST without one.

        BenchMARL asks this of the environment that evaluates, and of no other. So from its next seeded reset on, `env`
        plays the worlds of evaluation, which have other numbers than those of training.
        """
        env.vector_env.first_world = EVALUATION
        scenario, name = env.vector_env.scenario, "ending_limit"
        drawn = dict(scenario.varied).get(name)
        limits = drawn.extremes() if drawn else (scenario.numbers()[name],)
        return int(max(limits)) if all(limits) else LONGEST

    def has_render(self, env: SurvivalTorchEnv) -> bool:
        return False  # `outlast frames` makes films

    def group_map(self, env: SurvivalTorchEnv) -> dict[str, list[str]]:
        return env.group_map

    def observation_spec(self, env: SurvivalTorchEnv) -> Composite:
        return _entries(env, "observation")

    def action_mask_spec(self, env: SurvivalTorchEnv) -> Composite | None:
        return None if self.supports_continuous_actions() else _entries(env, "action_mask")

    def action_spec(self, env: SurvivalTorchEnv) -> Composite:
        return env.full_action_spec_unbatched

    def state_spec(self, env: SurvivalTorchEnv) -> Composite:
        return Composite({"state": env.full_observation_spec_unbatched["state"].clone()})

    def info_spec(self, env: SurvivalTorchEnv) -> None:
        return None

    @staticmethod
    def env_name() -> str:
        return "outlast"


class OutlastTask(Task):  # type: ignore[misc]  # untyped
    """The paper's eight variants."""

    FFA_1 = FFA_2 = FFA_3 = FFA_4 = None
    TEAMS_1 = TEAMS_2 = TEAMS_3 = TEAMS_4 = None

    @staticmethod
    def associated_class() -> type[TaskClass]:
        return OutlastClass

    def get_from_yaml(self, path: str | None = None) -> TaskClass:
        """Return the task with DEFAULTS, or with the settings of the YAML file at `path`."""
        return super().get_from_yaml(path) if path else OutlastClass(self.name, {})


def task(scenario: str | Scenario, **config: Any) -> OutlastClass:
    """Return any scenario as a task.

    config: Arguments of `outlast.adapters.make_torchrl`, and numbers of the scenario. ValueError for those in TAKEN.
    """
    found = resolve(scenario)
    return OutlastClass(found.name, config, found)


def _entries(env: SurvivalTorchEnv, name: str) -> Composite:
    """Return the specs of the entry `name` of every group, for one world."""
    groups = {group: env.full_observation_spec_unbatched[group] for group in env.group_map}
    parts = {group: Composite({name: own[name].clone()}, shape=own.shape) for group, own in groups.items()}
    return Composite(parts)
