"""What a result says of a policy, read from the policy's own file."""

from pathlib import Path

from outlast.envs.rollout.mixture import parse_mixture

from .. import run_header
from ..config import OPPONENTS, parse_warm_start
from ..config import SELF as OWN
from ..presets import preset
from .matches import digest
from .result import Content
from .suite import STYLES
from .tasks import Task, check_training_seed

STEPS = "steps"


def described(path: Path, task: Task) -> Content:
    """What is said of a policy that plays a task.

    Args:
        path: Of the policy.
        task: The task.

    Returns:
        "digest": of the file. "steps": agent-steps of its training. "of_task": whether that was in the task's game.
        "met": which styles of the suite it was trained against, or by.

    Raises:
        TrainingError: It is no policy, or was trained from a seed that evaluation uses.
    """
    header, _ = run_header.read_checkpoint(path, (), (STEPS, "scenario", "preset"))
    plan = header.get("plan", {})
    check_training_seed(plan.get("seed", 0))
    of_task = not preset(header["preset"]).difference(header["scenario"], task.scenario)
    opponents = parse_mixture(plan.get("opponents") or OWN, (*OPPONENTS, *STYLES))
    teacher, _ = parse_warm_start(plan.get("warm_start", ""))
    met = [name for name in STYLES if name in (*opponents, teacher)]
    return {"digest": digest(path), STEPS: header[STEPS], "of_task": of_task, "met": met}
