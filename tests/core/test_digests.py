"""What is written down of behaviour, by platform and version, and what guards it."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from outlast import VARIANTS
from tests import digests
from tests.conftest import COMPILED, slow_compiled
from tests.digests import FILE, MARKS, behaviour_digests, environment, golden, platform_name

ROOT = Path(__file__).parents[2]


@pytest.mark.skipif(not COMPILED, reason="its sines are others: see tests/core/test_determinism.py")
@pytest.mark.parametrize(
    ("name", "ticks"),
    [
        *(("ffa_4", 200), ("teams_4", 200)),
        *(pytest.param(name, MARKS[-1], marks=pytest.mark.nightly) for name in VARIANTS),
    ],
)
def test_behaviour_is_as_written(name: str, ticks: int) -> None:
    if environment(name) not in golden().get(platform_name(), {}):
        pytest.skip(
            f"no digests of {environment(name)} on {platform_name()}; python -m tests.digests --write adds them"
        )
    assert digests.changed(name, behaviour_digests(name, ticks)) == ""


@pytest.mark.parametrize("name", VARIANTS)
def test_worlds_begin_alike_on_every_platform(name: str) -> None:
    """Chance is integer arithmetic, and its few floats are rounded once: so also in plain Python."""
    written = {
        key: entries[environment(name)]["0"] for key, entries in golden().items() if environment(name) in entries
    }
    assert written
    assert set(written.values()) == {behaviour_digests(name, 0)["0"]}, f"{digests.NEW_VERSION.format(name=name)}"


def test_all_names_of_a_variant_are_of_one_version() -> None:
    zoo = pytest.importorskip("pettingzoo")
    if not hasattr(zoo, "parallel_registry"):
        pytest.skip("a PettingZoo without a registry")
    for name in VARIANTS:
        known = {str(key) for key in (*zoo.parallel_registry, *zoo.aec_registry) if f"/{name}-v" in str(key)}
        assert known == {f"outlast/{environment(name)}"}


def test_what_was_written_once_is_written_still() -> None:
    """In every revision of the repository: a digest is never changed under an old version, nor taken away."""
    path = FILE.relative_to(ROOT).as_posix()
    log = subprocess.run(["git", "log", "--format=%H", "--", path], cwd=ROOT, capture_output=True, text=True)
    if log.returncode:
        pytest.skip("not a git repository")
    for revision in log.stdout.split():
        shown = subprocess.run(["git", "show", f"{revision}:{path}"], cwd=ROOT, capture_output=True, text=True)
        for platform, entries in json.loads(shown.stdout or "{}").items():
            for key, found in entries.items():
                now = golden().get(platform, {}).get(key, {})
                assert found.items() <= now.items(), f"{key} on {platform} is not what {revision[:8]} says"


@slow_compiled
def test_a_change_of_behaviour_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = behaviour_digests("ffa_4", 10, 2)
    assert expected == behaviour_digests("ffa_4", 10, 2, threads=2)
    for number, value in (("agents_health", 99), ("motors_ahead", 0.25025), ("rewards_alive", 1.5)):
        scenario: Any = VARIANTS["ffa_4"].replace(**{number: value})
        where = digests.first_difference(expected, behaviour_digests(scenario, 10, 2))
        assert where == f"between {'the start and tick 0' if number == 'agents_health' else 'tick 0 and tick 1'}"
