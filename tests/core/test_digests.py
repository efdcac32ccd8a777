"""What is written down of behaviour, by platform and version, and what guards it."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from outlast import VARIANTS
from tests import digests
from tests.conftest import COMPILED, slow_compiled
from tests.digests import FILE, MARKS, WORLDS, behaviour_digests, environment, golden, platform_name

COMMAND = "python -m tests.digests --write"
ROOT = Path(__file__).parents[2]


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the file, in its place."""
    monkeypatch.setattr(digests, "FILE", tmp_path / FILE.name)
    shutil.copy(FILE, tmp_path)
    return tmp_path / FILE.name


def check(name: str, ticks: int) -> None:
    if environment(name) not in golden().get(platform_name(), {}):
        pytest.skip(f"no digests of {environment(name)} on {platform_name()}; {COMMAND} adds them")
    assert digests.changed(name, behaviour_digests(name, ticks)) == ""


@pytest.mark.skipif(not COMPILED, reason="its sines are others: see tests/core/test_determinism.py")
@pytest.mark.parametrize("name", ["ffa_4", "teams_4"])
def test_behaviour_is_as_written(name: str) -> None:
    check(name, 200)


@pytest.mark.nightly
@pytest.mark.skipif(not COMPILED, reason="its sines are others: see tests/core/test_determinism.py")
@pytest.mark.parametrize("name", VARIANTS)
def test_behaviour_is_as_written_for_two_thousand_ticks(name: str) -> None:
    check(name, MARKS[-1])


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


def test_the_file_has_earlier_versions() -> None:
    """Those of today and older ones; each with the ticks of MARKS."""
    for entries in golden().values():
        for key, found in entries.items():
            name, _, number = key.rpartition("-v")
            assert 0 <= int(number) <= int(environment(name).rpartition("-v")[2])
            assert set(map(int, found)) <= set(MARKS)


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


def test_writing_adds_and_keeps(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before, found = golden(), {name: {"0": f"{name} at first"} for name in ("ffa_1", "teams_4")}
    monkeypatch.setattr(digests, "platform_name", lambda: "abacus")
    for each in (found, {"ffa_1": {"0": "otherwise", "2000": "later"}}):
        digests.write(each)
    assert golden()["abacus"][environment("ffa_1")] == found["ffa_1"] | {"2000": "later"}
    assert golden() == before | {"abacus": golden()["abacus"]}
    assert digests.changed("ffa_1", found["ffa_1"]) == ""
    reason = digests.changed("teams_4", {"0": "otherwise"})
    assert reason.startswith(f"{environment('teams_4')} differs between the start and tick 0; behaviour changed: raise")


@slow_compiled
def test_a_change_of_behaviour_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """One hit point more or less, or a motor that is a thousandth stronger, in one of the variants."""
    expected = behaviour_digests("ffa_4", 10, 2)
    assert expected == behaviour_digests("ffa_4", 10, 2, threads=2)
    for number, value in (("agents_health", 99), ("motors_ahead", 0.25025), ("rewards_alive", 1.5)):
        scenario: Any = VARIANTS["ffa_4"].replace(**{number: value})
        where = digests.first_difference(expected, behaviour_digests(scenario, 10, 2))
        assert where == f"between {'the start and tick 0' if number == 'agents_health' else 'tick 0 and tick 1'}"


def test_the_command(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert digests.main(["ffa_1", "--ticks", "1"]) == 0
    assert json.loads(capsys.readouterr().out) == {"ffa_1": behaviour_digests("ffa_1", 1, WORLDS)}
    assert digests.main(["ffa_1", "--ticks", "0", "--write"]) == 0
    assert capsys.readouterr().out == f"digests.json: 1 environments on {platform_name()}\n"
