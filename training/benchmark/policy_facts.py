"""Facts about a policy in a result, read from the policy's own file."""

from pathlib import Path
from typing import Any

from outlast.envs.rollout.lineup import parse_lineup
from outlast.envs.rollout.saved import is_saved

from ..base import policy_file
from ..base.config import FAST, OPPONENTS, TrainingConfig, parse_warm_start
from ..base.config import SELF as OWN
from ..base.presets import preset
from .matches import digest
from .result import POLICY, Content
from .suite import STYLES, suite
from .tasks import Task, check_training_seed, response_steps

STEPS = "steps"


def described(path: Path, task: Task) -> Content:
    """Describe a policy that plays a task.

    Returns "digest": digest of the file. "steps": agent-steps of its training. "of_task": whether all of its training
    was in the task's game, without chosen levels, numbers that changed, or weights or actions of a saved policy.
    "met": the members of the suite that it was trained against, or that taught it. Raises TrainingError: the file is
    not a policy, or was trained from a seed that evaluation uses.
    """
    header = policy_file.read_header(path, (STEPS, "scenario", "preset"))
    plan = header.get("plan", {})
    check_training_seed(plan.get("seed", 0))
    teacher, _ = parse_warm_start(plan.get("warm_start", ""))
    changed = plan.get("levels") or plan.get("anneal") or is_saved(teacher)
    of_task = not changed and not preset(header["preset"]).difference(header["scenario"], task.scenario)
    known = {Path(name).stem for name in (*_opponents(plan), teacher)}
    met = [member.name for member in suite(task) if {member.name, f"{task.name}-{member.name}"} & known]
    return {"digest": digest(path), STEPS: header[STEPS], "of_task": of_task, "met": met}


def response_config(task: Task, seed: int, budget: int, policy: Path, threads: int = 0) -> TrainingConfig:
    """Return the config for training a best response.

    Raises TrainingError if such a training is impossible.

    policy: File of the policy to beat.
    """
    opponents = {str(policy): 1.0}
    return TrainingConfig(task.scenario, FAST, response_steps(budget), seed, threads=threads, opponents=opponents)


def wrong_with_response(path: Path, task: Task, seed: int, budget: int) -> str:
    """Return the difference of a file's training from that of a best response to a policy; "" if there is none.

    seed: Seed of the entry. budget: Budget of the entry. Raises TrainingError: the file is not a policy.
    """
    header = policy_file.read_header(path, ("plan", "preset", "scenario", STEPS))
    plan, wanted = header["plan"], response_config(task, seed, budget, Path(POLICY)).header()["plan"]
    if [Path(name).name for name in _opponents(plan)] != [POLICY]:
        return f"{path.name} was not trained against {POLICY}, but {plan.get('opponents') or OWN}"
    wanted = {key: value for key, value in wanted.items() if key != "threads"}  # they depend on the machine
    given = {key: plan.get(key, value) for key, value in wanted.items()}  # earlier files lack some
    given |= {"game": not preset(header["preset"]).difference(header["scenario"], task.scenario), "opponents": ""}
    for key, value in (wanted | {"game": True, "opponents": ""}).items():
        if given[key] != value:
            return f"{path.name} was not trained as best responses are: {key} is {given[key]}, not {value}"
    if header[STEPS] < wanted[STEPS]:
        return f"{path.name} was trained for {header[STEPS]:,} agent-steps, not for {wanted[STEPS]:,}"
    return ""


def _opponents(plan: dict[str, Any]) -> dict[str, float]:
    return parse_lineup(plan.get("opponents") or OWN, (*OPPONENTS, *STYLES))
