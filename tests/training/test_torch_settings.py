"""Callers' settings of PyTorch, numpy and Python, which change no number of a training or of a policy's play."""

import ast
import contextlib
import logging
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import outlast
from outlast import make_vec, variant

SOURCES = Path(outlast.__file__).parent / "training"
MAKERS = re.compile("arange|as_tensor|empty|eye|full|linspace|ones|rand|randn|randperm|tensor|zeros")
LAYERS = re.compile("GRUCell|Linear|MultiheadAttention")
SHORT = {"safe_zone_damage": 20, "safe_zone_stand": 20, "safe_zone_shrink": 10}


def restored(get: Callable[[], Any], change: Callable[[Any], Any], value: Any) -> Any:
    @contextlib.contextmanager
    def set_for_a_while() -> Iterator[None]:
        before = get()
        change(value)
        try:
            yield
        finally:
            change(before)

    return set_for_a_while


SETTINGS: dict[str, Callable[[], Any]] = {
    "dtype": restored(torch.get_default_dtype, torch.set_default_dtype, torch.float64),
    "device": lambda: torch.device("meta"),
    "no grad": torch.no_grad,
    "inference": torch.inference_mode,
    "autocast": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    "precision": restored(torch.get_float32_matmul_precision, torch.set_float32_matmul_precision, "medium"),
    "deterministic": restored(torch.are_deterministic_algorithms_enabled, torch.use_deterministic_algorithms, True),
    "denormals": restored(lambda: False, torch.set_flush_denormal, True),
    "threads": restored(torch.get_num_threads, torch.set_num_threads, 3),
    "seed": restored(lambda: 0, torch.manual_seed, 99),
    "numpy's errors": lambda: np.errstate(all="raise"),
    "numpy's printing": lambda: np.printoptions(precision=1, threshold=1, suppress=True, legacy="1.13"),
    "warnings": lambda: warnings.catch_warnings(action="error"),
    "logging": restored(lambda: 0, logging.disable, logging.CRITICAL),
}


def outcome(folder: Path, preset: str, memory: int) -> dict[str, Any]:
    """What is logged of a short run against itself, a past self and a style, and how its policy plays and explains."""
    game = variant("ffa_2").replace(**SHORT)
    sizes = {"memory": memory, "steps": 1024, "worlds": 8, "rollout": 256, "threads": 1}
    others = {"opponents": "self:1,past:1,scripted:1", "snapshots": 1}
    run = outlast.train(game, folder, preset=preset, seed=3, quiet=True, **sizes, **others)
    found: dict[str, Any] = {name: value for name, value in run.logged.items() if not name.startswith("time/")}
    policy = outlast.load_policy(run.folder, seed=0)
    env, explainer = make_vec(policy.scenario(game), 2, seed=0), policy.explainer()
    observations, _ = env.reset()
    for each in (policy, explainer):
        if each.reset is not None:
            each.reset(np.ones(2, bool))
    for tick in range(3):
        found[f"explained {tick}"] = [array.tolist() for array in explainer(observations)]
        found[f"chosen {tick}"] = (actions := policy(observations)).tolist()
        observations = env.step(actions)[0]
    return found


@pytest.fixture(scope="module", params=[("fast", 4), ("original", 0)])
def plain(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[tuple[str, int], Any]:
    return request.param, outcome(tmp_path_factory.mktemp("plain") / "run", *request.param)


def here() -> list[Any]:
    """The caller's settings that code could leave changed."""
    modes = torch.is_grad_enabled(), torch.is_inference_mode_enabled(), torch.is_autocast_enabled("cpu")
    makes = torch.get_default_dtype(), torch.get_default_device(), torch.get_float32_matmul_precision()
    return [modes, makes, torch.get_num_threads(), torch.get_rng_state().tolist()]


@pytest.mark.parametrize("names", [tuple(SETTINGS), *((name,) for name in SETTINGS)], ids="-".join)
@pytest.mark.by_day(1)
def test_no_setting_changes_a_number_and_none_is_changed(plain: Any, tmp_path: Path, names: Any) -> None:
    chosen, expected = plain
    with contextlib.ExitStack() as stack:
        for name in names:
            stack.enter_context(SETTINGS[name]())
        before = here()
        found = outcome(tmp_path / "run", *chosen)
        assert here() == before
    assert found == expected


def test_every_tensor_that_is_made_names_its_type_and_device() -> None:
    """Else the caller's defaults decide."""
    wrong = []
    for path in SOURCES.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            of = node.func.value
            names = {"torch": MAKERS, "nn": LAYERS}.get(of.id) if isinstance(of, ast.Name) else None
            made = names is not None and names.fullmatch(node.func.attr)
            given = {keyword.arg for keyword in node.keywords}
            if made and None not in given and not {"dtype", "device"} <= given:  # None: **FLOAT or **INDEX
                wrong.append(f"{path.name}:{node.lineno}: {ast.unparse(node)}")
    assert wrong == []
