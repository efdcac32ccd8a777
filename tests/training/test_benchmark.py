"""The benchmark from end to end, in a short game; and what is found of results that are not what they claim."""

import itertools
import json
import lzma
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import variant
from outlast.distributions import integers
from outlast.envs.cli.main import main
from outlast.envs.errors import ScenarioError, UsageError
from outlast.training.arena.match import Act
from outlast.training.arena.players import Contender
from outlast.training.arena.ratings import anchored
from outlast.training.base import policy_file
from outlast.training.base.config import TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.benchmark import (
    anchors,
    crossplay,
    keeping,
    kept,
    matches,
    policy_facts,
    result,
    scores,
    suite,
    table,
    tasks,
    verify,
)
from outlast.training.benchmark import entry as entries
from outlast.training.benchmark.agents import Agent
from outlast.training.benchmark.entry import Entry, EntryRun
from outlast.training.benchmark.games import Games
from outlast.training.benchmark.matches import digest
from outlast.training.benchmark.result import Content, Result
from outlast.training.benchmark.verify import checks, cross_checks
from outlast.training.policies.player import Player

NAME, BUDGET, GAMES = "quick-v1", 512, 4
SHORT = {"safe_zone_damage": 20, "safe_zone_stand": 20, "safe_zone_shrink": 10}  # episodes of a hundred steps
SMALL = {"worlds": 8, "rollout": 256}
STYLES = ("random", "scripted")
MINE = """
import numpy as np

def make(env, seed):
    return lambda observations: np.broadcast_to([2, 1, seed, 1, 0, 0], (*observations["own"].shape[:2], 6))

def nothing(env, seed):
    return 7
"""


def quick() -> tasks.Task:
    scenario = variant("ffa_2").replace(**SHORT)
    trained, other = scenario.vary(melee_damage=integers(10, 20)), scenario.vary(melee_damage=integers(30, 40))
    return tasks._task("quick", "short episodes", trained, {"strong blows": other})


def small_response(task: tasks.Task, seed: int, budget: int, policy: Path, threads: int = 0) -> TrainingConfig:
    return TrainingConfig(task.scenario, "fast", BUDGET, seed, threads=1, opponents={str(policy): 1.0}, **SMALL)


def entry(out: Path, agent: str = "fast", seed: int = 0) -> Entry:
    chosen = Agent.of(agent, SMALL if agent == "fast" else {})
    return Entry(tasks.task_of(NAME), chosen, seed, BUDGET, GAMES, out, threads=1)


@pytest.fixture(scope="module", autouse=True)
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with anchors, in the place of those that are shipped, beside a suite and a task that are small."""
    folder, known = tmp_path_factory.mktemp("benchmark"), {NAME: quick()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tasks, "tasks", lambda: known)
        patch.setattr(suite, "STYLES", STYLES)
        patch.setattr(anchors, "STYLES", STYLES)
        for module in (entries, policy_facts):
            patch.setattr(module, "response_config", small_response)
        patch.setattr(suite, "FOLDER", folder / "anchors")
        yield folder


@pytest.fixture(scope="module")
def results(place: Path) -> Path:
    """Results of two seeds of a preset and one of a function, with cross-play and scores."""
    before = EntryRun(entry(place / "before", seed=9))
    before._enter()
    anchors.make(tasks.task_of(NAME), [before.entry.folder / "trained"], place / "anchors", GAMES)
    (place / "bench_player.py").write_text(MINE)
    out = place / "results"
    for agent, seed in (("fast", 0), ("fast", 1), (f"mine={place / 'bench_player.py'}:make", 1)):
        EntryRun(entry(out, agent, seed)).run()
    assert main(["benchmark", "score", str(out), "--quiet", "--jobs=2"]) == 0
    return out


@pytest.fixture
def first(results: Path, tmp_path: Path) -> Result:
    """A copy of the first entry, without its training."""
    target = tmp_path / str(BUDGET) / NAME / "fast" / "0"
    shutil.copytree(results / str(BUDGET) / NAME / "fast" / "0", target, ignore=shutil.ignore_patterns("trained", BEST))
    return result.read(target / result.NAME)


BEST = "response"


def test_all_matches_are_played_and_none_again(results: Path, capsys) -> None:
    found = {each.name: each for each in kept.find(results)}
    assert [*found] == ["fast/0", "fast/1", "mine/1"]
    every = {(game, name) for game in ("trained", "strong blows") for name in ("self", *STYLES, "steps_0000000512")}
    assert {*found["fast/0"].against} == every | {("trained", "response")}
    assert {*found["mine/1"].against} == every
    policy = found["fast/0"].content["policy"]
    assert (policy["steps"], policy["of_task"], policy["met"]) == (512, True, [])
    before = times(results)
    EntryRun(entry(results, seed=1), lambda *_: pytest.fail("there was nothing to do")).run()
    assert main(["benchmark", "score", str(results), "--quiet"]) == 0
    assert times(results) == before
    assert main(["benchmark", "verify", str(results), "--quiet", "--jobs=2", "--allow-missing"]) == 0
    total = 9 + 9 + 8 + 3 + 3 + 1 + 1  # matches, entries, cross-play and all of it, scores
    function = 8 + 1 + 2 + 1  # what it played is not asked
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == f"{total} checks: {total - function} as recorded, 0 wrong, {function} not verified"


def times(folder: Path) -> dict[Path, tuple[int, str]]:
    """When files were written, and what is in them; of the scores, which are written anew, the latter alone."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path: (path.stat().st_mtime_ns * (path.name != scores.NAME), digest(path)) for path in files}


def test_what_was_stopped_goes_on_with_the_same_games(results: Path, tmp_path: Path) -> None:
    """One that is killed leaves whole files, perhaps temporary ones, and a recording that is not in the result yet."""
    stopped = []

    def stop(done: int, text: str) -> None:
        stopped.append(text)
        if text == "strong blows against random":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        EntryRun(entry(tmp_path), stop).run()
    folder = entry(tmp_path).folder
    (folder / ".result.json-0123abcd.tmp").write_text("half")
    (folder / result.recording_name("strong blows", "random")).write_text("of a match that was not entered")
    found = EntryRun(entry(tmp_path)).run()
    reference = result.read(results / str(BUDGET) / NAME / "fast/0" / result.NAME)
    assert _outcomes(found) == _outcomes(reference)
    assert not [*folder.glob(".*")]


def test_two_processes_do_not_play_one_entry(tmp_path: Path) -> None:
    """Nor does the second one take what the first is writing for that of a killed process."""
    chosen, program = f"ours={tmp_path}/theirs.py:make", tmp_path / "theirs.py"
    program.write_text(MINE)

    def other(done: int, text: str) -> None:
        half = entry(tmp_path, chosen).folder / ".result.json-0123abcd.tmp"
        half.write_text("half")
        with pytest.raises(TrainingError, match="/ours/0: another process plays this entry; wait until it ends, stop"):
            EntryRun(entry(tmp_path, chosen)).run()
        assert half.exists()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        EntryRun(entry(tmp_path, chosen), other).run()
    whole = entry(tmp_path, chosen)
    assert {*EntryRun(whole).run().against} == {(game.name, name) for game, name in whole.wanted}


def _outcomes(found: Result) -> dict[Any, Any]:
    return {key: {name: match[name] for name in ("won", "figures")} for key, match in found.against.items()}


def wrong(entry: Result, only: tuple[str, str] = ("trained", "scripted")) -> list[str]:
    """What verification finds of the entry itself and of one of its matches."""
    kept = [match for match in entry.matches if (match["game"], match["against"]) == only]
    every = [check() for check in checks(Result(entry.folder, entry.content | {"matches": kept}))]
    return [found.wrong for found in every if found.wrong]


def test_a_true_result_is_as_recorded_and_another_recording_is_found(first: Result) -> None:
    assert wrong(first) == []
    # also where its digest is in the result: it is played by other policies, or of another game
    match, target = first.against["trained", "scripted"], first.folder / "trained-scripted.rec"
    shutil.copy(first.folder / "trained-random.rec", target)
    assert wrong(first) == ["its recording is not the file that was made"]
    match |= {"recording": digest(target)}
    match |= {key: first.against["trained", "random"][key] for key in ("won", "drawn", "lost", "figures")}
    (found,) = wrong(first)
    assert re.match(
        r"scripted did not play this match: in world \d+, tick \d+, agent \d it chooses \[.*\], not \[", found
    )
    shutil.copy(first.folder / "strong-blows-scripted.rec", target)
    match |= {"recording": digest(target)}
    (found,) = wrong(first)
    assert "trained-scripted.rec is of another game" in found
    assert "what numbers are drawn from is" in found


def test_what_cannot_be_verified_is_no_success(first: Result, capsys) -> None:
    """All matches are won, and no recording is there that says otherwise."""
    for match in first.matches:
        match |= {"won": match["games"], "drawn": 0, "lost": 0}
        first.recording(match).unlink()
    first.write()
    words = ["benchmark", "verify", str(first.folder.parents[3]), "--quiet"]
    assert main(words) == 2
    *lines, last = capsys.readouterr().out.splitlines()
    names = [f"quick-v1 fast/0, {match['game']} against {match['against']}" for match in first.matches]
    whole = f"quick-v1 fast/0: of {len(names)} matches, {len(names)} are not verified"
    assert lines == [*(f"{name}: its recording is not here" for name in names), whole]
    assert last == f"{len(names) + 1} checks: 0 as recorded, 0 wrong, {len(names) + 1} not verified"
    assert main([*words, "--allow-missing"]) == 0
    assert capsys.readouterr().out == f"{last}\n"


def test_scores_that_do_not_follow_from_the_results_are_found(first: Result) -> None:
    place = first.folder.parents[3]
    found = scores.scores(place)
    result.write_json(place / scores.NAME, found)
    assert verify._of_scores(place).wrong == ""
    found["budgets"][str(BUDGET)]["tasks"][NAME]["agents"]["fast"]["score"]["mean"] += 0.01
    result.write_json(place / scores.NAME, found)
    assert verify._of_scores(place).wrong == "the results have other scores: run `outlast benchmark score` again"
    first.matches.pop()
    first.write()
    assert verify._of_scores(place).missing.endswith("is missing; run it again to continue")


class Altered(Contender):
    """A policy whose choices are changed: a function of those of a call and the number of the call."""

    def __init__(self, policy: str, change: Callable[[Any, int], Any], slack: float = 0.0) -> None:
        super().__init__(Path(policy).stem, policy)
        self.change, self.slack = change, slack

    def act(self, env: Any, seed: int, *, keyed: bool = False, slack: float = 0.0) -> Act:
        act, calls = super().act(env, seed, keyed=keyed, slack=self.slack), itertools.count()
        return lambda seen, indices: self.change(act(seen, indices), next(calls))


def one_other(actions: Any, call: int) -> Any:
    """One action of the first world changes; so does all that follows in it."""
    actions = np.array(actions)
    actions[:1, 0] = (actions[:1, 0] + (call == 0)) % 3
    return actions


def with_match(first: Result, *pair: Contender, games: int = 64) -> Result:
    """The entry with one match, against scripted, of so many games that each side has more than a thousand actions."""
    path = first.recording(first.against["trained", "scripted"])
    path.unlink(missing_ok=True)
    match = {"game": "trained", "against": "scripted", "opponent": ""}
    match |= matches.play(tasks.task_of(NAME).game("trained"), pair, games, path)
    return Result(first.folder, first.content | {"matches": [match]})


@pytest.mark.parametrize("side", ["policy.safetensors", "scripted"])
def test_one_altered_action_is_found(first: Result, side: str) -> None:
    """So nobody can play a match again until it goes well: of neither side, not even one action of a thousand."""
    names = [str(first.folder / "policy.safetensors"), "scripted"]
    pair = [Altered(name, one_other) if name.endswith(side) else Contender("other", name) for name in names]
    (found,) = [each.wrong for check in checks(with_match(first, *pair)) if (each := check()).wrong]
    assert re.search(
        rf"{side} did not play this match: in world 0, tick 1, agent [01] it chooses \[.*\], not \[", found
    )


@pytest.mark.parametrize("rounded", [1, 1000])
def test_of_networks_what_is_within_rounding_is_counted(first: Result, monkeypatch, rounded: int) -> None:
    """A few actions, as on another machine, but not more."""
    differ = [0]

    def change(choices: Any, call: int) -> Any:
        """The last of three choices, until enough of them differ."""
        _, choice, last = np.swapaxes(np.reshape(choices, (len(choices), 3, -1)), 0, 1)
        if differ[0] >= rounded:
            return choice
        differ[0] += int((choice != last).any(1).sum())
        return last

    altered = Altered(str(first.folder / "policy.safetensors"), change, 2**-8)
    entry = with_match(first, altered, Contender("scripted", "scripted"))
    monkeypatch.setattr(matches, "ROUNDING", 2**-7)
    whole, match = (check() for check in checks(entry))
    assert (match.wrong, match.differing, match.drawn > 1000) == ("", differ[0], True)
    share = f"{differ[0] / match.drawn:.1e}"
    assert str(match).endswith(f"; {differ[0]} of {match.drawn:,} actions differ by rounding ({share})")
    assert not match.missing
    assert whole.of([match]).wrong == ("" if differ[0] <= 3 else "more of its actions differ than rounding explains")
    monkeypatch.setattr(matches, "ROUNDING", 2**-30)
    assert "policy.safetensors did not play this match" in checks(entry)[1]().wrong


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda first, match: match.update(won=4, drawn=0, lost=0), r"\w+ is \d in the result, but \d in"),
        (lambda first, match: match["figures"][0].update(kills=[1.5, 0.1]), "kills is 1.5 in the result, but 0 in the"),
        (lambda first, match: first.content["policy"].update(steps=9), "steps of .* is 9 in the result, but 512"),
        (lambda first, match: first.content["policy"].update(of_task=False), "of_task of .* is False in the"),
        (lambda first, match: first.content["policy"].update(met=["healer"]), "met of .* is .* in the result"),
    ],
)
def test_what_the_result_says_is_what_its_files_say(first: Result, change: Any, found: str) -> None:
    change(first, first.against["trained", "scripted"])
    (wrong_there,) = wrong(first)
    assert re.match(found, wrong_there.removeprefix("policy.safetensors: ")), wrong_there


def test_another_opponent_or_game_is_found(first: Result) -> None:
    """By scores, too, which play nothing."""
    first.against["trained", "steps_0000000512"]["opponent"] = "0" * 64
    assert (
        "its opponent steps_0000000512 is not the one of the suite" in wrong(first, ("trained", "steps_0000000512"))[0]
    )
    with pytest.raises(TrainingError, match="its opponent steps_0000000512 is not the one of the suite"):
        scores._agent(tasks.task_of(NAME), [first])
    first.content["fingerprints"]["trained"]["numbers"]["heals_count"] = 3
    other = "its game 'trained' differs from that of quick-v1 ('ffa_2'): heals_count is 3 there"
    assert other in wrong(first)[0]
    with pytest.raises(TrainingError, match=re.escape(other)):
        scores._agent(tasks.task_of(NAME), [first])


def test_another_response_is_found(first: Result, results: Path, tmp_path: Path) -> None:
    """One that was trained otherwise; the policy itself, which it never beats."""
    shutil.copy(first.folder / "policy.safetensors", first.folder / "response.safetensors")
    first.content["response"] = first.content["policy"]
    assert wrong(first)[0] == "response.safetensors was not trained against policy.safetensors, but self:1"
    shutil.copy(results / str(BUDGET) / NAME / "fast/1/response.safetensors", first.folder)
    first.content["response"] = result.read(results / str(BUDGET) / NAME / "fast/1" / result.NAME).content["response"]
    assert wrong(first)[0] == "response.safetensors was not trained as best responses are: seed is 1, not 0"
    kept = results / str(BUDGET) / NAME / "fast/0/response.safetensors"
    for plan, steps, numbers, words in (
        ({"settings": {"learning_rate": 1e-9}}, {}, {}, "not trained as best responses are: settings is .*, not {}"),
        ({"warm_start": "scripted"}, {}, {}, "not trained as best responses are: warm_start is scripted, not "),
        ({}, {}, {"heals_count": 3}, "not trained as best responses are: game is False, not True"),
        ({}, {"steps": 256}, {}, "trained for 256 agent-steps, not for 512"),
    ):
        _change(kept, first.folder / "response.safetensors", plan, numbers, **steps)
        first.content["response"] = policy_facts.described(first.folder / "response.safetensors", tasks.task_of(NAME))
        assert re.match(f"response.safetensors was {words}", wrong(first)[0])
    # as `--threads` says
    _change(kept, tmp_path / "response.safetensors", {"threads": 3}, {})
    assert policy_facts.wrong_with_response(tmp_path / "response.safetensors", tasks.task_of(NAME), 0, BUDGET) == ""


def test_matches_that_were_not_played_are_missing(first: Result) -> None:
    response = first.against["trained", "response"]
    first.content["matches"].remove(response)
    assert checks(first)[0]().missing == "it has not played response in the game 'trained'"
    first.content["response"] = None
    first.write()
    with pytest.raises(TrainingError, match="fast/0 is not complete: response is missing; run it again"):
        scores.scores(first.folder.parents[3])
    assert main(["benchmark", "score", str(first.folder.parents[3]), "--quiet"]) == 2
    assert not list(first.folder.parents[3].rglob("cross*"))  # nothing is played where there are no scores
    first.content["matches"].remove(first.against["strong blows", "scripted"])
    assert checks(first)[0]().missing == "it has not played scripted in the game 'strong blows'"


def test_cross_play_is_verified(results: Path, tmp_path: Path) -> None:
    folder = tmp_path / NAME
    shutil.copytree(results / str(BUDGET) / NAME, folder, ignore=shutil.ignore_patterns("trained", BEST))
    entries = kept.find(folder)
    path = folder / "cross.json"
    content = json.loads(path.read_text())
    match = content["matches"][0]
    match |= {"won": match["lost"], "lost": match["won"], "drawn": match["drawn"]}
    shutil.copy(folder / "cross" / "fast-0-mine-1.rec", folder / "cross" / "fast-1-mine-1.rec")
    path.write_text(json.dumps(content))
    every = cross_checks(folder, entries, [each.name for each in entries])
    found = [str(each) for check in every if (each := check()).wrong]
    assert len(found) >= 1
    assert found[-1] == "quick-v1 fast/1 against mine/1: its recording is not the file that was made"


def test_cross_play_with_an_entry_that_is_gone_is_missing(results: Path) -> None:
    folder = results / str(BUDGET) / NAME
    entries = [each for each in kept.find(folder) if each.name != "mine/1"]
    found = [check() for check in cross_checks(folder, entries, [each.name for each in entries])]
    missing = {each.what: each.missing for each in found}
    assert missing["quick-v1 fast/0 against fast/1"] == ""
    assert missing["quick-v1 fast/0 against mine/1"] == "the entry mine/1 is not here"


def test_anchors_are_the_policies_that_were_rated(place: Path, results: Path) -> None:
    """Each with its own header and weights; another weight or another training is another anchor."""
    (own,) = [member for member in suite.suite(tasks.task_of(NAME)) if member.file is not None]
    header, (weights,) = policy_file.read(place / "anchors" / "games" / f"{NAME}-{own.name}.safetensors")
    found, stacked = suite.read_anchors(place / "anchors" / f"{NAME}.safetensors")[1][own.name]
    assert found == header
    assert stacked.keys() == weights.keys()
    assert all(np.array_equal(stacked[name], weights[name]) for name in weights)
    assert not own.contender().player.critic
    trained = Player(place / "before" / str(BUDGET) / NAME / "fast/9/trained/steps_0000000512.zip")
    last = [player.policies[0].actor.last.weight for player in (own.contender().player, trained)]
    assert np.allclose(*(each.detach().numpy() for each in last), atol=1e-3)
    assert suite.digest_of(found, stacked) == own.digest
    assert suite.digest_of(found | {"plan": {}}, stacked) != own.digest
    name = next(iter(stacked))
    assert suite.digest_of(found, stacked | {name: stacked[name] + 1}) != own.digest
    with pytest.raises(TrainingError, match="anchors of a task must be of one preset"):
        suite.write_anchors(place / "a", [(found, stacked), (found | {"preset": "paper"}, stacked)], {"members": []})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rated: rated.update(version=2), "invalid version or game"),
        (lambda rated: rated["members"][0].update(elo="1"), "an invalid member: {'name': 'random', 'elo': '1'"),
        (lambda rated: rated["members"][0].update(steps=-1, plan={}), "an invalid anchor: {'name': 'random'"),
        (lambda rated: rated["members"][0].update(steps=1, plan={}), "its weights are not those of 2 anchors"),
        (lambda rated: rated.pop("members"), "KeyError: 'members'"),
        (lambda rated: rated["fingerprint"]["numbers"].update(heals_count=3), "its ratings belong to another game"),
    ],
)
def test_other_anchors_are_refused(
    place: Path, results: Path, tmp_path: Path, monkeypatch, change: Any, message: str
) -> None:
    header, policies = policy_file.read(place / "anchors" / f"{NAME}.safetensors")
    change(header["suite"])
    policy_file.write(tmp_path / f"{NAME}.safetensors", header, policies)
    monkeypatch.setattr(suite, "FOLDER", tmp_path)
    with pytest.raises(TrainingError, match=re.escape(message)):
        suite.suite(tasks.task_of(NAME))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: content.update(version=2), "version 2: must be 1"),
        (lambda content: content.update(agent="../../etc"), "its agent cannot be '../../etc'"),
        (lambda content: content.pop("matches"), "KeyError: 'matches'"),
        (lambda content: content.update(policy=None), "it has matches, but no policy that played them"),
        (lambda content: content["policy"].update(steps=None), "its policy cannot be"),
        (lambda content: content["matches"][0].update(won=400), "do not add up to all games"),
        (
            lambda content: content["matches"][0].update(games=2, won=2, drawn=0, lost=0),
            "a match of 2 games: must be 4",
        ),
        (lambda content: content["matches"][0].update(recording="x"), "invalid digests"),
        (lambda content: content["matches"][0]["figures"][0].update(kills=[1e999, 0]), "invalid figures"),
        (lambda content: content["matches"][0].update(game="a\nb"), "invalid names"),
        (lambda content: content["matches"].append(content["matches"][0]), "and .* occurs twice"),
    ],
)
def test_a_result_that_is_none_is_refused(first: Result, change: Callable[[Content], Any], message: str) -> None:
    change(first.content)
    (first.folder / result.NAME).write_text(json.dumps(first.content))
    with pytest.raises(TrainingError, match="is not a result of the benchmark: .*" + message.replace("'", ".")):
        result.read(first.folder / result.NAME)


def test_results_in_the_wrong_folder_are_refused(first: Result) -> None:
    shutil.move(first.folder, first.folder.with_name("7"))
    with pytest.raises(TrainingError, match="holds the result of 512/quick-v1/fast/0: move it"):
        scores.scores(first.folder.parents[3])
    shutil.move(first.folder.with_name("7"), first.folder)
    places = first.folder.parents[3]
    shutil.copytree(first.folder.parents[1], places / "other" / str(BUDGET) / NAME)
    with pytest.raises(TrainingError, match=f"both hold results of {NAME}: move them into one folder"):
        scores.scores(places)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("run quick-v1", "needs tasks and agents"),
        ("run quick-v1 --agent nobody", "nobody: unknown agent: it must be a preset"),
        ("run quick-v1 --agent fast --keep a", "--keep has no effect on benchmark run"),
        ("run quick-v1 --agent mine=a.zip --memory 4", "memory has no effect on mine=a.zip"),
        ("run quick-v1 --agent fast --seed 4611686018427387904", "reserved for the worlds of tests"),
        ("run quick-v1 quick-v1 --agent fast", "name each task, each agent and each seed once"),
        ("run quick-v1 --agent a/b=fast", "must consist of letters, digits"),
        ("score nowhere", "folder nowhere does not exist"),
        ("tasks ffa_2-v1", "lists all: leave out ffa_2-v1"),
        ("anchors quick-v1", "needs a task, --policies and --out"),
    ],
)
def test_what_the_command_cannot_do_is_refused(words: str, message: str, capsys) -> None:
    assert main(["benchmark", *words.split()]) == 2
    assert message in capsys.readouterr().err


def test_another_program_does_not_go_on_with_the_matches_of_one(tmp_path: Path) -> None:
    """But one that is mended before it has played is taken."""
    chosen, program = f"ours={tmp_path}/{{task}}/ours.py:make", tmp_path / NAME / "ours.py"
    program.parent.mkdir()
    program.write_text(MINE.replace("(*observations", "(3, *observations"))
    with pytest.raises(TrainingError, match="trained against self: the actions that ours returned have shape"):
        EntryRun(entry(tmp_path, chosen)).run()
    sys.modules.pop(program.stem)  # as a new process has not imported it
    program.write_text(MINE)
    run = EntryRun(entry(tmp_path, chosen))
    run._enter()
    assert run.result.content["policy"]["digest"] == digest(program)
    run._play(run.entry.task.games[0], result.SELF, run._contender())
    program.write_text(MINE.replace("[2, 1,", "[1, 1,"))
    with pytest.raises(TrainingError, match="the policy is not the one that played 1 matches there"):
        EntryRun(entry(tmp_path, chosen))._enter()


def test_neither_seeds_nor_numbers_of_games_are_mixed(results: Path, tmp_path: Path, capsys) -> None:
    """Else an interval over seeds would be of no training but that one."""
    own = results / str(BUDGET) / NAME / "fast/1/policy.safetensors"
    words = ["benchmark", "run", NAME, "--agent", f"one={own}", "--seed", "0", "1", "--out", str(tmp_path)]
    assert main(words) == 2
    assert "is one training for all seeds: name one --seed, or put {seed} in it" in capsys.readouterr().err
    one, two, _ = kept.find(results)
    same = replace(one, content=one.content | {"policy": two.content["policy"]})
    with pytest.raises(TrainingError, match="its policy is that of seed 0, not another training: remove it"):
        scores._agent(tasks.task_of(NAME), [same, two])
    # a mean of ten games and one of ten thousand would be of one track
    one, two, _ = kept.find(results)
    other = replace(two, content=two.content | {"games": 2 * GAMES})
    assert scores._budget(BUDGET, [one, two])["games"] == GAMES
    with pytest.raises(TrainingError, match=f"matches of {GAMES} and {2 * GAMES} games cannot be compared"):
        scores._budget(BUDGET, [one, other])


def test_an_agent_that_is_none_is_refused(place: Path, results: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="returned 7: a function"):
        EntryRun(entry(tmp_path, f"mine={place / 'bench_player.py'}:nothing")).run()
    with pytest.raises(ScenarioError, match="absent"):
        EntryRun(entry(tmp_path, f"mine={place / 'bench_player.py'}:absent", 1)).run()
    with pytest.raises(TrainingError, match="has source 'fast', not "):
        EntryRun(entry(results, f"fast={place / 'bench_player.py'}:make"))


def entered(out: Path, source: Path, seed: int = 0) -> Content:
    """What the result says of a policy that exists."""
    run = EntryRun(entry(out, f"mine={source}", seed))
    run._enter()
    return dict(run.result.content["policy"])


def test_policies_that_exist_are_entered_with_what_they_say(results: Path, tmp_path: Path) -> None:
    own = entered(tmp_path, results / str(BUDGET) / "{task}/fast/{seed}/trained", 1)
    known = json.loads((results / str(BUDGET) / NAME / "fast/1" / result.NAME).read_text())["policy"]
    assert own == known
    changed = tmp_path / "changed.safetensors"
    for plan, game, expected in (
        ({"opponents": "self:1,scripted:0.5"}, {}, (["scripted"], True)),
        ({"warm_start": "scripted:2e6"}, {}, (["scripted"], True)),
        ({"opponents": f"anchors/{NAME}-steps_0000000512.zip:1"}, {}, (["steps_0000000512"], True)),
        ({"anneal": "melee_damage=40:10@512"}, {}, ([], False)),
        ({"warm_start": "earlier.zip"}, {}, ([], False)),
        ({"levels": "choose"}, {}, ([], False)),
        ({}, {"heals_count": 3}, ([], False)),
    ):
        _change(results / str(BUDGET) / NAME / "fast/1/policy.safetensors", changed, plan, game)
        found = entered(tmp_path / str(expected) / str(len(plan)) / "-".join(plan), changed)
        assert (found["met"], found["of_task"]) == expected
    _change(results / str(BUDGET) / NAME / "fast/1/policy.safetensors", changed, {"seed": 2**62}, {})
    with pytest.raises(TrainingError, match="reserved for the worlds of tests"):
        entered(tmp_path / "seed", changed)
    with pytest.raises(TrainingError, match=r"mine, quick-v1, seed 0: .*absent does not exist"):
        entered(tmp_path / "gone", tmp_path / "absent")


def _change(source: Path, target: Path, plan: dict[str, Any], numbers: dict[str, Any], **more: Any) -> None:
    """Another file of the same policy, whose run.json says otherwise."""
    header, policies = policy_file.read(source)
    header["plan"] |= plan
    header["scenario"]["numbers"] |= numbers
    policy_file.write(target, header | more, policies)


def test_scores_are_those_of_the_results(results: Path) -> None:
    found = scores.scores(results)["budgets"][str(BUDGET)]
    assert (found["track"], found["games"], found["common"]) == ("", GAMES, [NAME])
    fast = found["tasks"][NAME]["agents"]["fast"]
    one, two = (result.read(results / str(BUDGET) / NAME / "fast" / seed / result.NAME) for seed in "01")
    names = [member.name for member in suite.suite(tasks.task_of(NAME))]
    rates = [
        [np.mean([scores.rate(each.against[game, name]) for name in names]) for each in (one, two)]
        for game in ("trained", "strong blows")
    ]
    assert fast["games"]["trained"]["seeds"] == pytest.approx(rates[0], rel=1e-5)
    assert fast["score"]["seeds"] == pytest.approx(rates[1], rel=1e-5)  # outside of training
    lost = [1 - scores.rate(each.against["trained", "response"]) for each in (one, two)]
    assert fast["exploitability"]["seeds"] == lost
    assert found["tasks"][NAME]["agents"]["mine"]["exploitability"] is None
    members = [member for member in suite.suite(tasks.task_of(NAME)) if member.rating is not None]
    games = [[[one.against["trained", member.name][key] for member in members]] for key in ("won", "drawn", "lost")]
    elo, error = anchored(*map(np.array, games), np.array([member.rating for member in members]))
    assert (fast["rating"]["seeds"][0], fast["rating"]["errors"][0]) == pytest.approx((elo[0], error[0]), rel=1e-5)
    cross = found["tasks"][NAME]["cross_play"]
    assert cross["agents"] == ["fast", "mine"]
    assert cross["wins"][0][1] + cross["wins"][1][0] == pytest.approx(1)
    assert (cross["wins"][1][1], cross["matches"]) == (None, 3)  # one seed meets no other


def test_agents_are_compared_in_tasks_that_all_of_them_have_played() -> None:
    """Those that leave the most results, of all choices of several agents."""
    generator = np.random.default_rng(0)
    for _ in range(200):
        played = {agent: [task for task in "1234" if generator.random() < 0.6] for agent in "abcd"}
        agents, common = scores._compared(played)
        assert agents == [agent for agent in played if {*common} <= {*played[agent]}]
        choices = (chosen for n in (2, 3, 4) for chosen in itertools.combinations(played.values(), n))
        most = max(len(chosen) * len(set.intersection(*map(set, chosen))) for chosen in choices)
        assert len(agents) * len(common) == most
    assert scores._compared({"a": ["2", "1"]}) == (["a"], ["1", "2"])
    assert scores._compared({"a": ["1"], "b": ["2"]})[1] == []


def test_tables_are_the_same_bytes_of_kept_results(results: Path, tmp_path: Path) -> None:
    table.write(results, tmp_path / "one")
    keeping.keep(results, tmp_path / "kept")
    table.write(tmp_path / "kept", tmp_path / "two")
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert files == ["marl_eval-512.json", "profile-512.png", "table.csv", "table.md"]
    assert all((tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes() for name in files)
    names = sorted(path.name for path in (tmp_path / "kept").rglob("*") if path.is_file())
    assert names == ["0.safetensors", kept.NAME, "fast-0.npz"]  # of the first seed, which is no function
    text = (tmp_path / "one" / "table.md").read_text()
    assert "### 512 agent-steps (of no track: 4 games a match)" in text
    assert "mine†" in text


def test_kept_results_are_those_of_the_runs(results: Path, tmp_path: Path) -> None:
    """They are found in a folder of one task, too, which only the file describes; keeping them changes nothing."""
    keeping.keep(results, tmp_path / "one")
    task = tmp_path / "one" / str(BUDGET) / NAME
    assert [entry.name for entry in kept.find(task / "fast")] == ["fast/0", "fast/1"]
    pairs = [*zip(kept.find(results), kept.find(task), strict=True)]
    for run, own in pairs:
        more = {"file": own_file()} if run.name == "fast/0" else {}
        assert own.content == run.content | {"policy": run.content["policy"] | more, "matches": own.matches}
        self_play = run.against["trained", "self"] | {"recording": own.against["trained", "self"]["recording"]}
        assert own.against["trained", "self"] == self_play
    cross = (crossplay.load(place / str(BUDGET) / NAME) for place in (results, tmp_path / "one"))
    one, two = ([[match[key] for key in ("own", *NUMBERS)] for match in played.values()] for played in cross)
    assert one == two
    keeping.keep(tmp_path / "one", tmp_path / "two")
    for name in (kept.NAME, own_file(), f"games/{BUDGET}/{NAME}/fast-0.npz"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    with pytest.raises(TrainingError, match=r"mine/7 and its folders do not hold result.json or entries.json.xz"):
        kept.find(task / "mine/7")


NUMBERS = ("opponent", "games", "won", "drawn", "lost")


def test_policies_beside_kept_results_are_not_copied(results: Path, tmp_path: Path) -> None:
    beside = tmp_path / "policies" / "quick" / "mine-1.safetensors"
    beside.parent.mkdir(parents=True)
    shutil.copy(results / str(BUDGET) / NAME / "fast/1/policy.safetensors", beside)
    written = keeping.keep(results, tmp_path / "benchmark")
    files = {entry.name: entry.content["policy"].get("file") for entry in kept.find(tmp_path / "benchmark")}
    assert files == {"fast/0": own_file(), "fast/1": "../policies/quick/mine-1.safetensors", "mine/1": None}
    games = f"games/{BUDGET}/{NAME}/fast-0.npz"
    assert written == [tmp_path / "benchmark" / name for name in (kept.NAME, own_file(), games)]
    policies = {entry.name: entry.policy for entry in kept.find(tmp_path / "benchmark")}
    assert policies["fast/1"] == beside
    assert crossplay.contender(kept.find(tmp_path / "benchmark")[1]).text == str(beside)


def kept_changed(place: Path, change: Callable[[Content], Any]) -> None:
    """Change what kept results say."""
    content = json.loads(lzma.decompress((place / kept.NAME).read_bytes()))
    change(content)
    (place / kept.NAME).write_bytes(lzma.compress(json.dumps(content).encode()))


def test_kept_games_are_verified(results: Path, tmp_path: Path, capsys) -> None:
    """Each forgery ends with status 1 and says where; what is not kept is no success."""

    def verified(status: int, *words: str) -> str:
        assert main(["benchmark", "verify", str(tmp_path), "--jobs=1", "--quiet", *words]) == status
        return capsys.readouterr().out

    def own(content: Content) -> Content:
        return dict(content["entries"][0])

    keeping.keep(results, tmp_path)
    numbers = (tmp_path / kept.NAME).read_bytes()
    games, policy = tmp_path / "games" / str(BUDGET) / NAME / "fast-0.npz", tmp_path / own_file()
    total = 9 + 9 + 8 + 3 + 3 + 1  # matches, entries, cross-play and all of it
    assert verified(0, "--allow-missing") == f"{total} checks: 1 as recorded, 0 wrong, {total - 1} not verified\n"
    assert "fast/1 against mine/1: its recording is not here" in verified(2)
    kept_changed(tmp_path, lambda content: own(content)["matches"]["trained"].update(self=[0, GAMES, 0]))
    said = "quick-v1 fast/0, trained against self: {}"
    assert re.match(said.format(r"\w+ is \d in the result, but \d in"), verified(1, "--allow-missing"))
    (tmp_path / kept.NAME).write_bytes(numbers)
    whole, digests = games.read_bytes(), np.load(games)["digests"]
    Games(digests ^ (np.arange(len(digests)) == 7).astype("<u4"), np.load(games)["doubtful"]).write(games)
    assert said.format("its recording is not the file that was made") in verified(1, "--allow-missing")
    games.write_bytes(whole)
    shutil.copy(results / str(BUDGET) / NAME / "fast/1/policy.safetensors", policy)
    assert "0.safetensors is not the file that was tested" in verified(1, "--allow-missing")
    policy.unlink()
    assert "against self: a policy that played it is missing, so its choices were not compared" in verified(2)


def own_file() -> str:
    """The path of the policy that is kept."""
    return f"policies/{BUDGET}/{NAME}/fast/0.safetensors"


def test_keeping_replaces_whole_tasks(results: Path, tmp_path: Path, first: Result) -> None:
    target = tmp_path.with_name(f"{tmp_path.name}-kept")
    kept.write(target, kept.find(results), {})
    with pytest.raises(TrainingError, match=rf"{BUDGET}/{NAME}/fast/1 is in .*kept but not in .*: keep these"):
        keeping.keep(first.folder.parents[3], target)
    other = replace(first, content=first.content | {"task": "ffa_4-v1"})
    kept.write(target, [other], {f"{BUDGET}/ffa_4-v1": [["fast/0", "fast/1", 4, 0, 0]]})
    keeping.keep(results, target)
    assert [entry.content["task"] for entry in kept.find(target)] == ["ffa_4-v1", NAME, NAME, NAME]
    assert [*crossplay.load(target / str(BUDGET) / "ffa_4-v1")] == [("fast/0", "fast/1")]
    changed = replace(first, content=first.content | {"fingerprints": {}})
    with pytest.raises(TrainingError, match="other games or opponents than other results of its task"):
        kept.write(tmp_path, [first, changed], {})
    assert not (tmp_path / kept.NAME).exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: content.update(version=2), "version 2: must be 1"),
        (lambda content: content.pop("tasks"), "KeyError: 'tasks'"),
        (lambda content: content["entries"][0]["matches"]["trained"].update(scripted=[4, 1, -1]), "numbers of games"),
        (lambda content: content["entries"][0]["matches"]["trained"].update(nobody=[4, 0, 0]), "KeyError: 'nobody'"),
        (lambda content: content["cross"].update(a=[["fast/0", "fast/1", 1, 0, -1]]), "numbers of games"),
        (lambda content: content["cross"].update(a=[["fast/0"]]), "ValueError: not enough values"),
    ],
)
def test_other_kept_results_are_refused(results: Path, tmp_path: Path, change: Any, message: str) -> None:
    kept.write(tmp_path, kept.find(results), {})
    kept_changed(tmp_path, change)
    with pytest.raises(TrainingError, match="is not a result of the benchmark: .*" + re.escape(message)):
        kept.find(tmp_path)
    (tmp_path / kept.NAME).write_bytes(lzma.compress(b"{}")[:-4])
    with pytest.raises(TrainingError, match="of the benchmark: ValueError: it is not an xz file"):
        kept.find(tmp_path)


def test_what_marl_eval_cannot_take_stops_no_table(results: Path, tmp_path: Path, monkeypatch, caplog) -> None:
    def refuse(*_: object) -> None:
        raise TrainingError("Fast and fast are the same name for marl-eval")

    monkeypatch.setattr(table, "marl_eval_json", refuse)
    written = {path.name for path in table.write(results, tmp_path / "tables")}
    assert written == {"profile-512.png", "table.csv", "table.md"}
    assert "marl_eval-512.json is left out: Fast and fast are the same name for marl-eval" in caplog.text
