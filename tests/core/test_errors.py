"""The errors: all of them in outlast.errors, of one base, and caught as Gymnasium's or Python's."""

import ast
import pickle
from pathlib import Path

import gymnasium
import pytest

from outlast import errors
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
    assert defined - {"Refused", "_Missing", "_TooLong"} == set(ALL)  # these are caught where they are raised


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
