"""BenchMARL: scenarios as tasks, with all worlds of a batch in one environment.

>>> from outlast.envs.adapters.benchmarl import OutlastTask, task
>>> Experiment(task=OutlastTask.TEAMS_2.get_task(), algorithm_config=MappoConfig.get_from_yaml(), ...)
>>> Experiment(task=task("teams_2+bounty", melee_damage=20), ...)
"""

from collections.abc import Callable
from typing import Any

from ..errors import install
from ..scenarios.naming import resolve
from ..scenarios.scenario import Scenario
from .torchrl import SurvivalTorchEnv, make_torchrl

try:
    from benchmarl.environments.common import Task, TaskClass
    from torchrl.data import Composite
    from torchrl.envs import EnvBase
except ImportError as error:
    raise ModuleNotFoundError(f"this needs BenchMARL: {install('benchmarl')}", name="benchmarl") from error

DEFAULTS = {"groups": "sides", "scaled": True}  # arguments of make_torchrl
EVALUATION = 1 << 32  # number of the first world of evaluation
LONGEST = 10_000  # ticks of an evaluation, where the scenario has no limit
TAKEN = {  # arguments of make_torchrl that a task cannot have, and where else they are
    "seed": "take seed= of BenchMARL's Experiment",
    "device": "take sampling_device of BenchMARL's ExperimentConfig",
    "num_worlds": "take on_policy_n_envs_per_worker or off_policy_n_envs_per_worker of BenchMARL's ExperimentConfig",
    "actions": "BenchMARL's algorithms take joint actions, which a task has, or continuous ones",
}


class OutlastClass(TaskClass):  # type: ignore[misc]  # untyped
    """A scenario as a task of BenchMARL; vectorised, with a state, and with discrete actions and masks.

    name: That of the scenario. config: Arguments of `outlast.make_torchrl` and numbers of the scenario. Sides are
    groups, and observations scaled, unless it says otherwise. With actions="continuous" there are continuous actions
    only, and no masks. scenario: It, if it is not found by its name.

    Raises:
        ValueError: An argument of make_torchrl that BenchMARL sets by itself, see TAKEN.
    """

    _evaluates = False  # whether the worlds that were asked for last are those of evaluation

    def __init__(self, name: str, config: dict[str, Any], scenario: Scenario | None = None) -> None:
        for argument in TAKEN.keys() & config.keys():
            if argument != "actions" or config[argument] not in ("joint", "continuous"):
                raise ValueError(f"{argument} = {config[argument]!r} of a task: {TAKEN[argument]}; leave it out")
        super().__init__(name, config)
        self.scenario = scenario

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """What makes an environment of so many worlds.

        BenchMARL asks twice, with the same seed: for the worlds of evaluation and then for those of training, which are
        others: they have other numbers.
        """
        options = {**DEFAULTS, **self.config}
        scenario, self._evaluates = self.scenario or self.name.lower(), not self._evaluates
        first_world = EVALUATION if self._evaluates else 0

        def make() -> EnvBase:
            env = make_torchrl(scenario, num_envs, seed=seed, device=device, **options)
            env.vector_env.first_world = first_world
            return env

        return make

    def supports_continuous_actions(self) -> bool:
        """If the task has actions="continuous"."""
        return bool(self.config.get("actions") == "continuous")

    def supports_discrete_actions(self) -> bool:
        """Yes, joint ones, if they are not continuous."""
        return not self.supports_continuous_actions()

    def max_steps(self, env: SurvivalTorchEnv) -> int:
        """Ticks of an evaluation: the scenario's limit, where it varies the longest; LONGEST where there is none.

        BenchMARL goes on for as many ticks, also where all episodes have ended: take max_episode_steps for the task.
        """
        scenario, name = env.vector_env.scenario, "ending_limit"
        drawn = dict(scenario.varied).get(name)
        limits = drawn.extremes() if drawn else (scenario.numbers()[name],)
        return int(max(limits)) if all(limits) else LONGEST

    def has_render(self, env: SurvivalTorchEnv) -> bool:
        """No: films are made by `outlast frames`."""
        return False

    def group_map(self, env: SurvivalTorchEnv) -> dict[str, list[str]]:
        """Names of agents by group."""
        return env.group_map

    def observation_spec(self, env: SurvivalTorchEnv) -> Composite:
        """Of what agents observe, by group."""
        return _entries(env, "observation")

    def action_mask_spec(self, env: SurvivalTorchEnv) -> Composite | None:
        """Of action masks, by group; None of continuous actions."""
        return None if self.supports_continuous_actions() else _entries(env, "action_mask")

    def action_spec(self, env: SurvivalTorchEnv) -> Composite:
        """Of actions, by group."""
        return env.full_action_spec_unbatched

    def state_spec(self, env: SurvivalTorchEnv) -> Composite:
        """Of the state."""
        return Composite({"state": env.full_observation_spec_unbatched["state"].clone()})

    def info_spec(self, env: SurvivalTorchEnv) -> None:
        """There is none."""
        return None

    @staticmethod
    def env_name() -> str:
        """As in BenchMARL's own names of tasks: "outlast/teams_2"."""
        return "outlast"


class OutlastTask(Task):  # type: ignore[misc]  # untyped
    """The paper's eight variants."""

    FFA_1 = None
    FFA_2 = None
    FFA_3 = None
    FFA_4 = None
    TEAMS_1 = None
    TEAMS_2 = None
    TEAMS_3 = None
    TEAMS_4 = None

    @staticmethod
    def associated_class() -> type[TaskClass]:
        """Of all of them."""
        return OutlastClass

    def get_from_yaml(self, path: str | None = None) -> TaskClass:
        """The task as DEFAULTS has it; with a path, as that YAML file says."""
        return super().get_from_yaml(path) if path else OutlastClass(self.name, {})


def task(scenario: str | Scenario, **config: Any) -> OutlastClass:
    """Any scenario as a task.

    Args:
        scenario: It, or the name of one: "teams_2+bounty", "mygame.py:arena".
        config: Arguments of `outlast.make_torchrl`, but for those of TAKEN, and numbers of the scenario.

    Raises:
        ScenarioError: There is none of that name.
        ValueError: An argument of TAKEN.
    """
    found = resolve(scenario)
    return OutlastClass(found.name, config, found)


def _entries(env: SurvivalTorchEnv, name: str) -> Composite:
    """The specs of one entry of all groups, for one world."""
    groups = {group: env.full_observation_spec_unbatched[group] for group in env.group_map}
    parts = {group: Composite({name: own[name].clone()}, shape=own.shape) for group, own in groups.items()}
    return Composite(parts)
