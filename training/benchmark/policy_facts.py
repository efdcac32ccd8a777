"""Facts about the policies of a result, read from their own files; and the trainings that the protocol prescribes."""

from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.rollout.lineup import parse_lineup
from outlast.envs.rollout.saved import is_saved

from ..base import policy_file
from ..base.config import FAST, IMITATED, OPPONENTS, TrainingConfig, parse_warm_start
from ..base.config import SELF as OWN
from ..base.errors import TrainingError
from ..base.presets import preset
from .agents import Agent
from .games import digest
from .result import Content, is_count
from .suite import suite
from .tasks import Task, check_training_seed

STEPS = "steps"
SAME, LARGE = 0.7, 256  # cosine of two matrices, and their weights at least: one run keeps 0.98, two seeds have 0.2


def described(path: Path, task: Task) -> Content:
    """Describe a policy that plays a task.

    Returns "digest": digest of the file. "steps": agent-steps of its training. "of_task": whether all of its training
    was in the task's game, without chosen levels, numbers that changed, or weights or actions of a saved policy.
    "met": the members of the suite that it was trained against, or that taught it. Raises TrainingError: the file is
    not a policy, or was trained from a seed that evaluation uses.
    """
    header = policy_file.read_header(path, (STEPS, "scenario", "preset"))
    plan = header.get("plan", {})
    if not is_count(seed := plan.get("seed", 0)):
        raise TrainingError(f"{path} says that it was trained with seed {seed!r:.40}: an integer is needed")
    check_training_seed(seed)
    teacher, _ = parse_warm_start(plan.get("warm_start", ""))
    changed = plan.get("levels") or plan.get("anneal") or is_saved(teacher)
    of_task = not changed and not preset(header["preset"]).difference(header["scenario"], task.scenario)
    known = {Path(name).stem for name in (*_opponents(plan), teacher)}
    met = [name for name in suite(task).members if name in known]
    return {"digest": digest(path), STEPS: header[STEPS], "of_task": of_task, "met": met}


def agent_config(task: Task, agent: Agent, seed: int, budget: int, checkpoints: int, threads: int) -> TrainingConfig:
    """Return the config of the training of an agent, with a checkpoint after each share of it. Raises TrainingError."""
    more: dict[str, Any] = {"threads": threads, "every": -(-budget // checkpoints)} | agent.options
    return TrainingConfig(task.scenario, agent.source, budget, seed, **more)


def response_config(task: Task, seed: int, kind: str, steps: int, policy: Path, threads: int = 0) -> TrainingConfig:
    """Return the config for training a best response to a policy. Raises TrainingError if that is impossible.

    It begins with random weights ("scratch"), or with the policy's own ("self"), which is imitated if its file lacks
    the critic, or its networks or memory are not those of preset fast.
    """
    warm = ""
    if kind == "self":
        header, policies = policy_file.read(policy)
        same = header["preset"] == FAST and not header["memory"] and not header["state"] and not header.get("networks")
        critic = len(policies) == 1 and any(name.startswith(policy_file.CRITIC) for name in policies[0])
        warm = str(policy) if same and critic else f"{policy}:{IMITATED}"
    opponents = {str(policy): 1.0}
    more: dict[str, Any] = {"opponents": opponents, "warm_start": warm, "threads": threads, "every": 5_000_000}
    return TrainingConfig(task.scenario, FAST, steps, seed, **more)


def wrong_with_training(path: Path, config: TrainingConfig, steps: int, own: str = "") -> str:
    """Return the difference of a file's training from what the protocol prescribes; "" if there is none.

    config: The config of that training. steps: Its agent-steps, which whole rollouts exceed a little. own: The file of
    the policy that a best response was trained against; "": any opponents. Raises TrainingError: the file is not a
    policy.
    """
    header = policy_file.read_header(path, ("plan", "preset", "scenario", STEPS))
    plan, wanted = dict(header["plan"]), dict(config.header()["plan"])
    for each in (plan, wanted):  # places and machines differ; a longer run has the same checkpoints
        for key in ("threads", "every", "device", "processes", "steps", "asked"):
            each.pop(key, None)
        if own:  # in another folder
            each["opponents"] = {Path(name).name: weight for name, weight in _opponents(each).items()}
            teacher, length = parse_warm_start(each.get("warm_start", ""))
            each["warm_start"] = Path(teacher).name, length
    given = {key: plan.get(key, value) for key, value in wanted.items()}  # earlier files lack some
    given["game"] = not preset(header["preset"]).difference(header["scenario"], config.scenario)
    for key, value in (wanted | {"game": True}).items():
        if given[key] != value:
            return f"{path.name} was not trained as the protocol says: {key} is {given[key]}, not {value}"
    few_or_many = header[STEPS] < steps or header[STEPS] > most_steps(steps)
    return f"{path.name} has {header[STEPS]:,} agent-steps, and {steps:,} are planned" if few_or_many else ""


def most_steps(steps: int) -> int:
    """Return the most agent-steps of a training that is planned with `steps`: only whole rollouts are collected."""
    return int(1.01 * steps) + 2**16


def likeness(one: Path, other: Path) -> float:
    """Return the largest cosine of two matrices in the same place of two policies, of LARGE weights or more; 0 if none.

    Critics do not count, as policies play without them. Raises TrainingError.
    """
    first, second = (
        {
            (k, name): values.ravel().astype(np.float64)
            for k, own in enumerate(policy_file.read(path)[1])
            for name, values in own.items()
            if values.ndim > 1 and values.size >= LARGE and not name.startswith(policy_file.CRITIC)
        }
        for path in (one, other)
    )
    pairs = [(first[key], second[key]) for key in first if key in second and len(first[key]) == len(second[key])]
    return max((float(a @ b / np.sqrt((a @ a) * (b @ b)).clip(1e-30)) for a, b in pairs), default=0.0)


def _opponents(plan: dict[str, Any]) -> dict[str, float]:
    return parse_lineup(plan.get("opponents") or OWN, OPPONENTS)
