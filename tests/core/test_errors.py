"""The errors: all of them in outlast.errors, of one base, and caught as Gymnasium's or Python's."""

import ast
import pickle
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import outlast
from outlast import errors, make_vec
from outlast.errors import OutlastError

FOLDERS = ("ecs", "components", "systems", "envs", "training", ".src/outlast")
ROOT = Path(__file__).parents[2]
ALL = {name: getattr(errors, name) for name in errors.__all__}
GYMNASIUM = {
    "ActionError": [gymnasium.error.InvalidAction],
    "ClosedError": [gymnasium.error.ClosedEnvironmentError],
    "NotResetError": [gymnasium.error.ResetNeeded],
    "PendingError": [gymnasium.error.AlreadyPendingCallError, gymnasium.error.NoAsyncCallError],
}


def test_every_error_class_of_the_tree_is_in_outlast_errors() -> None:
    ends = ("Error", "Exception", "Warning")
    defined = {
        node.name
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef) and any(ast.unparse(base).endswith(ends) for base in node.bases)
    }
    assert defined - {"Refused", "_TooLong"} == set(ALL)  # these are caught where a trial raises them


@pytest.mark.parametrize("name", ALL)
def test_an_error_has_one_base_and_one_that_is_caught_already(name: str) -> None:
    error = ALL[name]
    assert issubclass(error, OutlastError)
    assert error.__doc__
    if error is not OutlastError:
        assert issubclass(error, (ValueError, RuntimeError))
        assert [base for base in error.__mro__ if base.__module__ == "gymnasium.error"][:2] == [
            each for base in GYMNASIUM.get(name, []) for each in base.__mro__ if each.__module__ == "gymnasium.error"
        ][:2]
    raised = error("what, and the cure")
    assert str(raised) == "what, and the cure"
    assert str(pickle.loads(pickle.dumps(raised))) == "what, and the cure"  # as worker processes send it


def test_errors_of_environments_are_caught_as_gymnasium_s() -> None:
    env = make_vec("ffa_1", 2, seed=0)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.tile(env.noop, (2, 2, 1)))
    env.reset()
    env.send(np.tile(env.noop, (2, 2, 1)))
    with pytest.raises(gymnasium.error.AlreadyPendingCallError) as raised:
        env.send(np.tile(env.noop, (2, 2, 1)))
    assert raised.value.name == "step"
    env.recv()
    with pytest.raises(OutlastError):
        outlast.variant("ffa_9")
