"""What a result says of a policy, read from the policy's own file."""

from pathlib import Path
from typing import Any

from outlast.envs.rollout.mixture import parse_mixture

from .. import run_header
from ..config import FAST, OPPONENTS, parse_warm_start
from ..config import SELF as OWN
from ..presets import preset
from .matches import digest
from .result import POLICY, Content
from .suite import STYLES, suite
from .tasks import Task, check_training_seed, response_steps

STEPS = "steps"


def described(path: Path, task: Task) -> Content:
    """What is said of a policy that plays a task.

    Args:
        path: Of the policy.
        task: The task.

    Returns:
        "digest": of the file. "steps": agent-steps of its training. "of_task": whether that was in the task's game, and
        neither in levels that somebody chose nor in numbers that changed. "met": who of the suite it was trained
        against, or by.

    Raises:
        TrainingError: It is no policy, or was trained from a seed that evaluation uses.
    """
    header, _ = run_header.read_checkpoint(path, (), (STEPS, "scenario", "preset"))
    plan = header.get("plan", {})
    check_training_seed(plan.get("seed", 0))
    changed = plan.get("levels") or plan.get("anneal")
    of_task = not changed and not preset(header["preset"]).difference(header["scenario"], task.scenario)
    teacher, _ = parse_warm_start(plan.get("warm_start", ""))
    known = {Path(name).name for name in (*_opponents(plan), teacher)}
    met = [member.name for member in suite(task) if (member.file.name if member.file else member.name) in known]
    return {"digest": digest(path), STEPS: header[STEPS], "of_task": of_task, "met": met}


def wrong_with_response(path: Path, seed: int, budget: int) -> str:
    """What a file says of a training that was not that of the best response to a policy; empty if there is nothing.

    Args:
        path: Of the file.
        seed: Of the entry.
        budget: Of the entry.

    Raises:
        TrainingError: It is no policy.
    """
    header, _ = run_header.read_checkpoint(path, (), ("plan", "preset"))
    plan, steps = header["plan"], response_steps(budget)
    wanted = {"preset": FAST, "seed": seed, STEPS: steps}
    if wrong := [f"{key} is {plan.get(key)}, not {value}" for key, value in wanted.items() if plan.get(key) != value]:
        return f"{path.name} was trained otherwise than best responses are: {wrong[0]}"
    if [Path(name).name for name in _opponents(plan)] != [POLICY]:
        return f"{path.name} was not trained against {POLICY}, but {plan.get('opponents') or OWN}"
    return ""


def _opponents(plan: dict[str, Any]) -> dict[str, float]:
    return parse_mixture(plan.get("opponents") or OWN, (*OPPONENTS, *STYLES))
