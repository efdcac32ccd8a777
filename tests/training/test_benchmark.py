"""The benchmark from end to end, in a short game; and what is found of results that are not what they claim."""

import json
import re
import shutil
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import variant
from outlast.distributions import integers
from outlast.envs.cli.main import main
from outlast.envs.errors import ScenarioError, UsageError
from outlast.envs.web.game import Game
from outlast.training.arena.ratings import anchored
from outlast.training.base import policy_file
from outlast.training.base.config import TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.benchmark import entry as entries
from outlast.training.benchmark import manifest, people, result, scores, suite, table, tasks, verify
from outlast.training.benchmark.entry import Entry, EntryRun
from outlast.training.benchmark.games import Moves, digest, play
from outlast.training.benchmark.manifest import Agent, Manifest
from outlast.training.benchmark.result import NUMBERS, Content, Pairing
from outlast.training.benchmark.situations import passed
from outlast.training.benchmark.verify import opened, pack
from outlast.training.policies.player import Player
from tests.fuzz.mutations import zipped

NAME, BUDGET, GAMES = "quick-v2", 2048, 4
SHORT = {"safe_zone_damage": 20, "safe_zone_stand": 20, "safe_zone_shrink": 10}  # episodes of a hundred steps
SMALL = {"worlds": 8, "rollout": 256}
RESPONSES = [1024, 2048]
RESPONSE = entries.response_config
MINE = """
import numpy as np

def make(env, seed):
    return lambda observations: np.broadcast_to([2, 1, seed, 1, 0, 0], (*observations["own"].shape[:2], 6))

def nothing(env, seed):
    return 7

def broken(env, seed):
    return lambda observations: observations["own"].shape[0] // 0
"""
FUNCTION = "a function of the user's is not executed"


def quick() -> tasks.Task:
    scenario = variant("teams_2").replace(**SHORT)
    trained, other = scenario.vary(melee_damage=integers(10, 20)), scenario.vary(melee_damage=integers(30, 40))
    between = scenario.vary(melee_damage=integers(21, 29))
    return tasks._task("quick", "short episodes", trained, {"strong blows": other}, between, ("random", "scripted"))


def small_response(
    task: tasks.Task, seed: int, kind: str, steps: int, policy: Path, threads: int = 0
) -> TrainingConfig:
    config = RESPONSE(task, seed, kind, steps, policy, 1)
    more: dict[str, Any] = {"opponents": config.opponents, "warm_start": config.warm_start, "every": 1024, "threads": 1}
    return TrainingConfig(task.scenario, "fast", steps, seed, **more, **SMALL)


@pytest.fixture(scope="module", autouse=True)
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with anchors, in the place of those that are shipped, beside a suite and a task that are small."""
    folder, known = tmp_path_factory.mktemp("benchmark"), {NAME: quick()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tasks, "tasks", lambda: known)
        patch.setattr(people, "tasks", lambda: known)
        patch.setattr(manifest, "CHECKPOINTS", 2)
        patch.setattr(entries, "response_config", small_response)
        patch.setattr(verify, "response_config", small_response)
        patch.setattr(suite, "FOLDER", folder / "anchors")
        (folder / "bench_player.py").write_text(MINE)
        patch.syspath_prepend(str(folder))
        yield folder


def planned(folder: Path, *agents: str, seeds: tuple[int, ...] = (0, 1), **more: Any) -> Manifest:
    chosen = [Agent.of(text, SMALL if text == "fast" else {}) for text in agents or ("fast",)]
    numbers = {"budget": BUDGET, "games": GAMES, "effect": 0.05, "responses": RESPONSES} | more
    pairs = [(chosen[0].name, chosen[1].name)] if len(chosen) > 1 else []
    return manifest.write(folder, [tasks.task_of(NAME)], chosen, seeds, pairs, **numbers)


def entry(made: Manifest, agent: str = "fast", seed: int = 0) -> Entry:
    return Entry(made, agent, tasks.task_of(NAME), seed, 1)


@pytest.fixture(scope="module")
def results(place: Path) -> Path:
    """Results of two seeds of a preset and a function, which are compared; in a suite with anchors."""
    before = EntryRun(entry(planned(place / "before", seeds=(9,)), seed=9))
    before._enter()
    checkpoints = sorted((before.entry.folder / "training").glob("*.zip"))
    suite.make(tasks.task_of(NAME), checkpoints, place / "anchors", GAMES)
    made = planned(place / "results", "fast", f"mine={place / 'bench_player.py'}:make")
    for _ in range(2):  # agents are met when they have been run
        for agent, seed in (("fast", 0), ("fast", 1), ("mine", 0), ("mine", 1)):
            EntryRun(entry(made, agent, seed)).run()
    assert main(["benchmark", "score", str(place / "results")]) == 0
    return place / "results"


@pytest.fixture
def copy(results: Path, tmp_path: Path) -> Manifest:
    """A copy of the results, without trainings."""
    ignored = shutil.ignore_patterns("training", "responding-*", scores.NAME)
    return manifest.read(shutil.copytree(results, tmp_path / "copy", ignore=ignored))


@pytest.fixture
def first(copy: Manifest) -> Entry:
    return entry(copy)


def test_all_planned_matches_are_played_and_none_again(results: Path, capsys) -> None:
    made = manifest.read(results)
    fast, other, mine = (entry(made, agent, seed) for agent, seed in (("fast", 0), ("fast", 1), ("mine", 0)))
    names = ("self", "random", "scripted", "anchor-1", "anchor-2")
    tests = {Pairing(game, name) for game in ("trained", "strong blows") for name in names}
    members = suite.suite(tasks.task_of(NAME)).members
    best = max(("scripted", "random"), key=lambda name: members[name].rating or 0)
    tests |= {Pairing("trained", other, mate) for mate in (best, "anchor-2") for other in (best, "anchor-2")}
    validations = {Pairing("validation", name, candidate=k) for name in (best, "anchor-1", "anchor-2") for k in (0, 1)}
    responses = {Pairing("trained", f"{kind} {steps}") for kind in ("scratch", "self") for steps in RESPONSES}
    rival = Pairing("trained", "agent:mine")
    assert {*fast.matches} == tests | validations | responses | {rival}
    assert {*other.matches} == tests | validations | {rival}  # only the first seed gets best responses
    assert {*mine.matches} == tests
    assert [each["steps"] for each in fast.content["candidates"]] == [1024, 2048]
    assert {name: each["steps"] for name, each in fast.content["responses"].items()} == {
        f"{kind} {steps}": steps for kind in ("scratch", "self") for steps in RESPONSES
    }
    before = times(results)
    assert main(["benchmark", "run", str(results), "--only=fast quick-v2 1", "--quiet"]) == 0
    assert main(["benchmark", "score", str(results)]) == 0
    assert times(results) == before
    capsys.readouterr()
    assert main(["benchmark", "verify", str(results), "--quiet", "--jobs=1", "--allow-missing"]) == 0
    function = 2 * (len(tests) + 1) + 1 + 2 + 2  # what it played and how it passed situations; whom it met
    total = len(fast.matches) + len(other.matches) + 2 * len(tests) + 4 + 2 + 1  # matches, entries, situations, scores
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == f"{total} checks: {total - function} as recorded, 0 wrong, {function} not verified"


def times(folder: Path) -> dict[Path, tuple[int, str]]:
    """When files were written, and what is in them; of the scores, which are written anew, the latter alone."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path: (path.stat().st_mtime_ns * (path.name != scores.NAME), digest(path)) for path in files}


def test_what_was_stopped_goes_on_with_the_same_games(results: Path, copy: Manifest) -> None:
    """One that is killed leaves whole files, perhaps temporary ones, and a match that is not in the result yet."""
    made = manifest.read(results)
    shutil.rmtree(copy.folder / "fast" / NAME / "1")

    def stop(done: int, text: str) -> None:
        if text == "strong blows against random":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        EntryRun(entry(copy, seed=1), stop).run()
    folder = entry(copy, seed=1).folder
    (folder / ".result.json-0123abcd.tmp").write_text("half")
    (folder / Pairing("strong blows", "random").file).write_text("of a match that was not entered")
    found = EntryRun(entry(copy, seed=1)).run()
    reference = entry(made, seed=1)
    assert found.matches == reference.matches
    assert not [*folder.glob(".*")]


def test_two_processes_do_not_play_one_entry(place: Path, tmp_path: Path) -> None:
    """Nor does the second one take what the first is writing for that of a killed process."""
    made = planned(tmp_path, f"ours={place}/bench_player.py:make")

    def other(done: int, text: str) -> None:
        half = entry(made, "ours").folder / ".result.json-0123abcd.tmp"
        half.write_text("half")
        with pytest.raises(TrainingError, match="/0: another process plays this entry; wait until it ends, stop"):
            EntryRun(entry(made, "ours")).run()
        assert half.exists()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        EntryRun(entry(made, "ours"), other).run()


def test_a_plan_never_changes(results: Path, copy: Manifest, first: Entry, tmp_path: Path) -> None:
    """Neither the file, nor what is run by it, nor what is counted afterwards."""
    with pytest.raises(TrainingError, match="exists, and a plan never changes"):
        planned(copy.folder, "fast", seeds=(0, 1, 2))
    content = json.loads((copy.folder / manifest.NAME).read_text())
    result.write_json(copy.folder / manifest.NAME, content | {"effect": 0.5})
    with pytest.raises(TrainingError, match=r"result.json has manifest .* it belongs to another manifest.json"):
        scores.scores([manifest.read(copy.folder)])
    result.write_json(copy.folder / manifest.NAME, content)
    luckier = first.content["matches"][0] | {"against": "camper", "candidate": -1}
    first.content["matches"].append(luckier)
    first.write()
    with pytest.raises(TrainingError, match="fast quick-v2 0: validation against camper is not in the manifest"):
        scores.scores([copy])
    first.content["matches"].pop()
    first.content["matches"][-1]["won"] += 2
    first.write()
    with pytest.raises(TrainingError, match="has 6 games, and 4 are planned"):
        scores.scores([copy])


def test_a_manifest_of_other_games_or_another_suite_is_refused(copy: Manifest) -> None:
    for change, words in (
        (lambda own: own["games"]["trained"]["numbers"].update(heals_count=3), "heals_count is 3 there"),
        (lambda own: own.update(suite="0" * 64), "the suite of the manifest is not that of quick-v2"),
    ):
        other = json.loads(json.dumps(copy.content))
        change(other["tasks"][NAME])
        result.write_json(copy.folder / manifest.NAME, other)
        with pytest.raises(TrainingError, match=words):
            _ = manifest.read(copy.folder).tasks


def test_the_validation_alone_chooses(results: Path, first: Entry) -> None:
    """The last of equal candidates; tests do not count."""
    shares = {0: 0.0, 1: 0.0}
    for pairing, match in first.matches.items():
        if pairing.candidate >= 0:
            shares[pairing.candidate] += result.share(match)
    best = 1 if shares[1] >= shares[0] else 0
    assert first.content["policy"] == first.content["candidates"][best]
    assert first.chosen() == best
    for pairing, match in first.matches.items():
        if pairing.candidate == 0:
            match |= {"won": sum(match[name] for name in NUMBERS), "drawn": 0, "lost": 0}
        elif pairing.candidate < 0:
            match |= {"won": 0, "drawn": 0, "lost": sum(match[name] for name in NUMBERS)}
    assert first.chosen() == 0


def wrong(made: Manifest, agent: str, only: Pairing) -> list[str]:
    """What verification finds of an entry itself and of one of its matches."""
    whole, *parts = verify.checks(entry(made, agent))
    own = [check for check in parts if getattr(check, "args", ("",))[-1] == only]
    return [found.wrong for check in (whole, *own) if (found := check()).wrong]


OWN, MET, OTHER = (Pairing("trained", name) for name in ("self", "scripted", "random"))
TAMED = {"settings": {"learning_rate": 1e-9}}
NOT_AS_PLANNED = "was not trained as the protocol says: "
OTHER_GAMES = r"tick \d+ is the first that differs when the match is played again"


def other_choice(first: Entry) -> None:
    for match in first.content["matches"]:
        if match["candidate"] >= 0:
            match |= {"won": 0, "drawn": 0, "lost": 2} if match["candidate"] else {"won": 2, "drawn": 0, "lost": 0}


def trained(first: Entry, plan: dict[str, Any], **more: Any) -> None:
    """Every candidate is of another training, and entered as what it is."""
    for k, own in enumerate(first.content["candidates"]):
        change(first.policy(k), first.policy(k), plan, {}, **more)
        own |= more | {"digest": digest(first.policy(k))}
    first.content["policy"] = first.content["candidates"][first.chosen()]
    shutil.copy(first.policy(first.chosen()), first.policy())


def responded(first: Entry, name: str, plan: dict[str, Any], source: Path | None = None) -> None:
    """Another response, which is entered as what it is."""
    path = first.response(name)
    change(source or path, path, plan, {})
    first.content["responses"][name] |= entries.described(path, tasks.task_of(NAME))


def weak_response(first: Entry) -> None:
    """Trained against what plays at random, and now and then against the policy."""
    responded(first, "scratch 1024", {"opponents": f"random:1000,{first.policy()}:1"})


def unplanned_response(first: Entry) -> None:
    """A weak one, with the name of an opponent, whose games it would play."""
    first.content["responses"]["scripted"] = first.content["responses"]["scratch 1024"]
    shutil.copy(first.response("scratch 1024"), first.response("scripted"))


def forged_actions(first: Entry) -> None:
    """A whole match of a stronger policy, with its own file and its own numbers."""
    pair = [suite.SuiteOpponent(name).contender() for name in ("hunter", "scripted")]
    played = play(tasks.task_of(NAME).tests[0], pair, GAMES)
    first.matches[MET].update({name: played.outcome[name] for name in NUMBERS})
    first.matches[MET]["moves"] = played.moves.write(first.folder / MET.file)


def other_file(first: Entry) -> str:
    """The games of another match."""
    shutil.copy(first.folder / OTHER.file, first.folder / MET.file)
    return digest(first.folder / MET.file)


def foreign(first: Entry, change: Callable[[Any], Any]) -> None:
    """Other actions of a function, which cannot be asked for them again."""
    moves = Moves.read(first.folder / MET.file)
    changed = Moves(moves.digests, moves.doubtful, change(moves.foreign).astype(moves.foreign.dtype))
    first.matches[MET]["moves"] = changed.write(first.folder / MET.file)


@pytest.mark.parametrize(
    ("agent", "forge", "found"),
    [
        ("fast", lambda e: e.matches[MET].update(won=4, drawn=0, lost=0), r"(won|lost|drawn) is \d in .*, but \d"),
        ("fast", lambda e: e.matches[OWN]["figures"].update(length=[9999, 0.1]), r"length is \[9999.*\] in .* \[\d"),
        ("fast", lambda e: shutil.copy(entry(e.manifest, seed=1).policy(), e.policy()), "policy.* is not the file"),
        ("fast", other_choice, "its policy is not candidate 0, which won most games in the validation"),
        ("fast", lambda e: trained(e, {}, steps=99), "policy.safetensors has 99 agent-steps, and [12],0.. are planned"),
        ("fast", lambda e: trained(e, {}, steps=10**6), "policy.safetensors has 1,000,000 agent-steps, and "),
        ("fast", lambda e: trained(e, {"seed": 7}), f"policy.safetensors {NOT_AS_PLANNED}seed is 7, not 0"),
        ("fast", weak_response, f"response-scratch-1024.safetensors {NOT_AS_PLANNED}opponents is"),
        ("fast", unplanned_response, "fast quick-v2 0: scripted is not in the manifest"),
        ("fast", lambda e: e.content.update(policy=None), "fast quick-v2 0 has tests, but no policy that"),
        ("fast", lambda e: responded(e, "scratch 1024", {}, e.policy()), f".*scratch.* {NOT_AS_PLANNED}opponents is"),
        ("fast", lambda e: responded(e, "self 1024", TAMED), f"response-self-1024.* {NOT_AS_PLANNED}settings is"),
        ("fast", forged_actions, OTHER_GAMES),
        ("fast", lambda e: e.matches[MET].update(moves=other_file(e)), OTHER_GAMES),
        ("fast", other_file, "its file is not the one that was made"),
        ("mine", lambda e: e.content["policy"].update(steps=BUDGET, of_task=True), "it is a function, of whose"),
        ("mine", lambda e: foreign(e, lambda own: own[:-1]), ".*its file lacks actions of a function"),
        ("mine", lambda e: foreign(e, lambda own: np.full_like(own, 255)), ".*its file lacks actions of a function"),
        ("mine", lambda e: foreign(e, lambda own: np.append(own, own[:1])), ".*its file holds ticks or actions"),
    ],
)
def test_forgeries_are_found(copy: Manifest, agent: str, forge: Callable[[Entry], Any], found: str) -> None:
    own, only = entry(copy, agent), OWN if found.startswith("length") else MET
    assert agent == "mine" or wrong(copy, agent, only) == []
    forge(own)
    own.write()
    every = wrong(copy, agent, only)
    assert any(re.match(found, each) for each in every), every


def test_one_training_is_not_two_seeds(copy: Manifest, first: Entry) -> None:
    """Neither a copy, nor one with a little noise, without a critic, or with other biases that change nothing."""
    twin = entry(copy, seed=1)
    pair = [entry(copy, seed=seed) for seed in (0, 1)]
    verify.check_seeds(pair)
    header, policies = policy_file.read(first.policy())
    generator = np.random.default_rng(0)
    noisy = [{name: w + 0.02 * generator.normal(size=w.shape) for name, w in own.items()} for own in policies]
    bare = [{name: w for name, w in own.items() if not name.startswith(policy_file.CRITIC)} for own in policies]
    shifted = [{name: w + 200 * (w.ndim == 1) for name, w in own.items()} for own in policies]
    for weights in (policies, noisy, bare, shifted):
        policy_file.write(twin.policy(), header, weights)
        with pytest.raises(TrainingError, match="seeds 0 and 1 are one training"):
            verify.check_seeds(pair)


def test_what_cannot_be_verified_is_no_success(copy: Manifest, first: Entry, capsys) -> None:
    """All matches are won, and no file is there that says otherwise."""
    for match in first.content["matches"]:
        match |= {"won": sum(match[name] for name in NUMBERS), "drawn": 0, "lost": 0}
        (first.folder / Pairing.of(match).file).unlink()
    first.content["policy"] = first.content["candidates"][1]
    shutil.copy(first.policy(1), first.policy())
    first.content["situations"] = passed(tasks.task_of(NAME).scenario, entry(copy).contender())
    first.write()
    words = ["benchmark", "verify", str(copy.folder), "--quiet", "--jobs=1", "--only=fast quick-v2 0"]
    assert main(words) == 2
    *lines, last = capsys.readouterr().out.splitlines()
    count = len(first.matches)
    assert lines[0] == f"fast quick-v2 0, {next(iter(first.matches))}: its file is not here"
    assert lines[-1].startswith(f"fast quick-v2 0: of {count + 1} matches, {count} are not verified")
    assert last == f"{count + 2} checks: 1 as recorded, 0 wrong, {count + 1} not verified"
    assert main([*words, "--allow-missing"]) == 0
    first.policy().unlink()
    assert main(words) == 2
    assert "situations: policy.safetensors is missing, so its choices were not compared" in capsys.readouterr().out


def test_situations_are_tried_again(copy: Manifest, first: Entry) -> None:
    """None is left out, and none is better than it was."""
    known = first.content["situations"]
    assert verify.checks(entry(copy))[-1]() == verify.Verification("fast quick-v2 0, situations")
    for situations, words in (({}, "it has none: the game has "), (dict.fromkeys(known, 0.95), "is 0.95 in the")):
        first.content["situations"] = situations
        first.write()
        assert words in verify.checks(entry(copy))[-1]().wrong
    first.content["situations"] = None
    first.write()
    assert verify.checks(entry(copy))[-1]().missing == "it has not been tried in situations"


def test_entries_are_named_by_whole_words(tmp_path: Path) -> None:
    """Seed 1 is not seed 10."""
    made = planned(tmp_path, "fast", seeds=(1, 10))
    assert [str(each) for each in entries.entries_of(made, "fast quick-v2 1")] == ["fast quick-v2 1"]
    assert len(entries.entries_of(made, "fast")) == len(entries.entries_of(made)) == 2
    with pytest.raises(TrainingError, match="no entry begins with the words 'fas': they are fast quick-v2 1, fast"):
        entries.entries_of(made, "fas")


def test_scores_that_do_not_follow_from_the_results_are_found(copy: Manifest) -> None:
    found = scores.scores([copy])
    result.write_json(copy.folder / scores.NAME, found)
    verify.check_scores(copy)
    found["budgets"][str(BUDGET)]["tasks"][NAME]["fast"]["score"]["mean"] += 0.01
    result.write_json(copy.folder / scores.NAME, found)
    with pytest.raises(TrainingError, match="the results have other scores: run `outlast benchmark score` again"):
        verify.check_scores(copy)


def test_scores_are_those_of_the_results(results: Path) -> None:
    found = scores.scores([manifest.read(results)])["budgets"][str(BUDGET)]
    assert (found["track"], found["games"], found["common"]) == ("", GAMES, [NAME])
    fast, mine = (found["tasks"][NAME][agent] for agent in ("fast", "mine"))
    one, two = (entry(manifest.read(results), seed=seed) for seed in (0, 1))
    known = suite.suite(tasks.task_of(NAME))
    rates = [
        [np.mean([result.share(each.matches[Pairing(game, name)]) for name in known.members]) for each in (one, two)]
        for game in ("trained", "strong blows")
    ]
    assert fast["games"]["trained"]["seeds"] == pytest.approx(rates[0], rel=1e-5)
    assert fast["score"]["seeds"] == pytest.approx(rates[1], rel=1e-5)  # outside of training
    assert fast["score"]["status"] == "few seeds"
    lost = 1 - result.share(one.matches[Pairing("trained", "self 2048")])
    assert fast["exploitability"]["self 2048"] == {"status": "few seeds", "mean": lost, "seeds": [lost]}
    assert mine["exploitability"] == {"best response": {"status": "not possible"}}
    games = [[[one.matches[Pairing("trained", name)][key] for name in known.members]] for key in NUMBERS]
    elo, error = anchored(*map(np.array, games), np.array([member.rating for member in known.members.values()]))
    assert (fast["rating"]["seeds"][0], fast["rating"]["errors"][0]) == pytest.approx((elo[0], error[0]), rel=1e-5)
    assert fast["rating"]["status"] == "few seeds"
    assert "mean" not in fast["rating"]  # a rating takes five seeds
    mates = {mate: [Pairing("trained", other, mate) for other in known.mates] for mate in ("self", *known.mates)}
    for mate, pairings in mates.items():
        each = [np.mean([result.share(own.matches[pairing]) for pairing in pairings]) for own in (one, two)]
        assert fast["mates"][mate]["seeds"] == pytest.approx(each)
    assert [point["steps"] for point in fast["curve"]] == [1024, 2048]
    assert fast["situations"] == one.content["situations"]
    (pair,) = found["pairs"]
    assert (pair["one"], pair["other"], pair["verdict"]) == ("fast", "mine", "open")
    both = [result.share(own.matches[Pairing("trained", "agent:mine")]) for own in (one, two)]
    assert pair["direct"]["seeds"] == both


def test_what_was_not_measured_has_a_status_and_no_number(copy: Manifest, first: Entry, capsys) -> None:
    first.content["matches"].remove(first.matches[Pairing("strong blows", "scripted")])
    first.matches[Pairing("trained", "self")]["figures"].update(kills=None)
    first.write()
    other = entry(copy, seed=1)
    other.matches[Pairing("trained", "self")]["figures"].update(kills=None)
    other.write()
    shutil.rmtree(copy.folder / "mine")
    found = scores.scores([copy])["budgets"][str(BUDGET)]["tasks"][NAME]
    fast, mine = found["fast"], found["mine"]
    assert (fast["score"]["status"], len(fast["score"]["seeds"])) == ("incomplete", 1)
    assert "mean" not in fast["score"]  # the seeds that are left could be the lucky ones
    assert fast["games"]["trained"]["status"] == "few seeds"
    assert fast["self_play"]["kills"] == {"status": "no occasion"}
    assert mine["score"] == mine["rating"] == {"status": "missing"}
    assert (mine["steps"], mine["of_task"]) == ([], False)
    assert main(["benchmark", "score", str(copy.folder)]) == 2
    assert "planned values are missing: run" in capsys.readouterr().err
    text = table.markdown(scores.scores([copy]))
    assert "| quick-v2 | mine† | missing |" in text


@pytest.mark.parametrize(
    ("ours", "theirs", "verdict", "status"),
    [
        ([0.8, 0.82, 0.81, 0.8, 0.83], [0.5, 0.52, 0.5, 0.51, 0.5], "more", "measured"),
        ([0.5, 0.52, 0.5, 0.51, 0.5], [0.8, 0.82, 0.81, 0.8, 0.83], "less", "measured"),
        ([0.5, 0.51, 0.5, 0.51, 0.5], [0.51, 0.5, 0.51, 0.5, 0.5], "equal", "measured"),
        ([0.5, 0.7, 0.4, 0.6, 0.5], [0.45, 0.6, 0.5, 0.4, 0.5], "open", "measured"),
        ([0.8, 0.82], [0.5, 0.52], "open", "few seeds"),
        ([0.8], [0.5], "open", "few seeds"),
        ([], [0.5], "open", "missing"),
    ],
)
def test_a_verdict_takes_seeds_and_an_effect(
    copy: Manifest, ours: list[float], theirs: list[float], verdict: str, status: str
) -> None:
    values = [{"score": {"seeds": own, "mean": 0.5} if own else {"status": "missing"}} for own in (ours, theirs)]
    (pair,) = scores._pairs(copy, {NAME: dict(zip(("fast", "mine"), values, strict=True))})
    assert (pair["verdict"], pair["difference"]["status"]) == (verdict, status)


def test_agents_are_compared_in_tasks_that_all_of_them_have_played() -> None:
    """The choice that leaves the most results, of all choices of several agents."""
    played = {"a": ["1", "2", "3"], "b": ["1", "2"], "c": ["3"]}
    assert scores._compared(played) == (["a", "b"], ["1", "2"])
    assert scores._compared({"a": ["2", "1"]}) == (["a"], ["1", "2"])
    assert scores._compared({"a": ["1"], "b": ["2"]})[1] == []


def test_archives_hold_what_is_handed_in(results: Path, tmp_path: Path, capsys) -> None:
    """All of it is verified; of a small one, what a publication needs."""
    made = manifest.read(results)
    assert main(["benchmark", "pack", str(results), "--out", str(tmp_path / "a.zip")]) == 0
    pack(results, tmp_path / "small.zip", small=True)
    with opened(tmp_path / "a.zip") as folder:
        assert scores.scores([manifest.read(folder)]) == scores.scores([made])
        kept = {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}
    there = {path.relative_to(results) for path in results.rglob("*") if path.is_file()}
    runs = {"training", "responding-self", "responding-scratch"}
    assert kept == {path for path in there if not runs & {*path.parts}}
    names = zipfile.ZipFile(tmp_path / "small.zip").namelist()
    assert "fast/quick-v2/0/policy.safetensors" in names
    assert not [name for name in names if re.search(r"candidate|response|1/policy\.safetensors$", name)]
    capsys.readouterr()
    assert main(["benchmark", "check", str(tmp_path / "a.zip"), "--quiet", "--jobs=1"]) == 2
    printed = capsys.readouterr().out
    assert "MB, track none" in printed
    assert FUNCTION in printed
    assert " 0 wrong, " in printed
    assert main(["benchmark", "pack", str(results), "--out", str(tmp_path / "b.zip")]) == 0
    assert main(["benchmark", "pack", str(results), "--out", str(tmp_path / "b.zip")]) == 0  # again, in its place
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("../../escape", b"x", "which no result is called"),
        ("/absolute", b"x", "which no result is called"),
        ("a/b/c/d/e", b"x", "which no result is called"),
        ("people.json", b"{}", "which no result is called"),
        ("scores.json", bytes(2**21), "holds more than"),
        ("scores.json", b"{}", "does not hold manifest.json"),
        ("", b"no archive", "is not an archive of results"),
    ],
)
def test_hostile_archives_are_refused(tmp_path: Path, monkeypatch, name: str, content: bytes, message: str) -> None:
    monkeypatch.setattr("outlast.training.benchmark.verify.MOST", 2**20)
    path = tmp_path / "a.zip"
    path.write_bytes(zipped({name: content}, zipfile.ZIP_DEFLATED) if name else content)
    with pytest.raises(TrainingError, match=message), opened(path):
        pass
    assert not (tmp_path.parent.parent / "escape").exists()


def test_agents_that_marl_eval_cannot_tell_apart_stop_no_table(results: Path, tmp_path: Path, caplog) -> None:
    found = scores.scores([manifest.read(results)])
    for own in found["budgets"].values():
        own["compared"] = ["fast", "Fast"]
        own["tasks"] = {task: each | {"Fast": each["fast"]} for task, each in own["tasks"].items()}
    assert "marl_eval-2048.json" not in {path.name for path in table.write(found, [], tmp_path / "tables")}
    assert "marl_eval-2048.json is left out: " in caplog.text


def test_tables_are_the_same_bytes_of_an_archive(results: Path, tmp_path: Path) -> None:
    pack(results, tmp_path / "a.zip", small=True)
    for source, out in ((results, "one"), (tmp_path / "a.zip", "two")):
        assert main(["benchmark", "table", str(source), "--out", str(tmp_path / out)]) == 0
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert files == ["curves-2048.png", "marl_eval-2048.json", "profile-2048.png", "table.csv", "table.md"]
    assert all((tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes() for name in files)
    text = (tmp_path / "one" / "table.md").read_text()
    assert "### 2,048 agent-steps (of no track: 4 games a test)" in text
    assert "mine†" in text


def test_agents_of_several_manifests_are_compared(place: Path, results: Path, tmp_path: Path) -> None:
    made = planned(tmp_path, f"other={place}/bench_player.py:make")
    EntryRun(entry(made, "other")).run()
    found = scores.scores([manifest.read(results), made])["budgets"][str(BUDGET)]
    assert {*found["tasks"][NAME]} == {"fast", "mine", "other"}
    assert found["compared"] == ["fast", "mine"]
    assert found["tasks"][NAME]["other"]["score"]["status"] == "incomplete"  # of one seed of two
    with pytest.raises(TrainingError, match="fast has results in quick-v2 twice"):
        scores.scores([manifest.read(results), manifest.read(results)])
    more = planned(tmp_path / "more", f"other={place}/bench_player.py:make", games=8)
    with pytest.raises(TrainingError, match="tests of 4 and 8 games cannot be compared"):
        scores.scores([manifest.read(results), more])


def test_people_stand_where_their_games_put_them(results: Path, tmp_path: Path, capsys) -> None:
    """By recordings of `outlast play`; once each, and only of tasks and of opponents of the suite."""
    for name, others, agent in (("a", "scripted", 1), ("b", "noop", 0), ("c", "scripted", 0)):
        scenario = variant("ffa_1") if name == "c" else tasks.task_of(NAME).scenario
        game = Game(scenario, agent=agent, others=others, name=others, record=tmp_path / f"{name}.rec")
        game.begin()
        while game.tick():
            pass
        game.env.close()

    def added(name: str) -> int:
        words = ["benchmark", "people", str(tmp_path / f"{name}.rec"), "--agent=you"]
        return main([*words, "--out", str(tmp_path / "people")])

    assert added("a") == 0
    (only,) = people.read(tmp_path / "people")
    assert (only["task"], only["opponent"], only["won"] + only["drawn"] + only["lost"]) == (NAME, "scripted", 1)
    assert re.search(r"you +quick-v2 +scripted +1 +[01].[05]0 +\d+ ± \d+", capsys.readouterr().out)
    text = table.markdown(scores.scores([manifest.read(results)]), people.read(tmp_path / "people"))
    assert "| you | quick-v2 | scripted | 1 |" in text
    for name, message in (("a", "been added already"), ("b", "noop is not in the suite"), ("c", "which is no task")):
        assert added(name) == 2
        assert message in capsys.readouterr().err


def change(source: Path, target: Path, plan: dict[str, Any], numbers: dict[str, Any], **more: Any) -> None:
    """Write another file of the same policy, whose run.json says otherwise."""
    header, policies = policy_file.read(source)
    header["plan"] |= plan
    header["scenario"]["numbers"] |= numbers
    policy_file.write(target, header | more, policies)


def entered(out: Path, source: Path | str, seed: int = 0) -> Content:
    """What the result says of a policy that exists."""
    run = EntryRun(entry(planned(out, f"mine={source}", seeds=(seed,)), "mine", seed))
    run._enter()
    return dict(run.entry.content["candidates"][0])


def test_policies_that_exist_are_entered_with_what_they_say(results: Path, tmp_path: Path) -> None:
    fast = results / "fast" / NAME / "1"
    own = entered(tmp_path / "own", f"{results}/fast/{{task}}/{{seed}}/training", 1)
    assert own == entry(manifest.read(results), seed=1).content["candidates"][1]
    changed = tmp_path / "changed.safetensors"
    for k, (plan, game, expected) in enumerate(
        (
            ({"opponents": "self:1,scripted:0.5"}, {}, (["scripted"], True)),
            ({"warm_start": "scripted:2e6"}, {}, (["scripted"], True)),
            ({"anneal": "melee_damage=40:10@1024"}, {}, ([], False)),
            ({"warm_start": "earlier.zip"}, {}, ([], False)),
            ({"levels": "choose"}, {}, ([], False)),
            ({}, {"heals_count": 3}, ([], False)),
        )
    ):
        change(fast / "policy.safetensors", changed, plan, game)
        found = entered(tmp_path / str(k), changed)
        assert (found["met"], found["of_task"]) == expected
    change(fast / "policy.safetensors", changed, {"seed": 2**62}, {})
    with pytest.raises(TrainingError, match="reserved for the worlds of tests"):
        entered(tmp_path / "seed", changed)
    with pytest.raises(TrainingError, match=r"mine, quick-v2, seed 0: .*absent does not exist"):
        entered(tmp_path / "gone", tmp_path / "absent")


def test_another_program_does_not_go_on_with_the_matches_of_one(tmp_path: Path) -> None:
    """But one that is mended before it has played is taken."""
    program = tmp_path / "quick" / "ours.py"
    program.parent.mkdir()
    program.write_text(MINE.replace("(*observations", "(3, *observations"))
    made = planned(tmp_path / "out", f"ours={tmp_path}/{{game}}/ours.py:make")
    with pytest.raises(TrainingError, match="trained against self: the actions that ours returned have shape"):
        EntryRun(entry(made, "ours")).run()
    sys.modules.pop(program.stem)  # as a new process has not imported it
    program.write_text(MINE)
    run = EntryRun(entry(made, "ours"))
    run._enter()
    assert run.entry.content["policy"]["digest"] == digest(program)
    run._play(Pairing("trained", result.SELF))
    program.write_text(MINE.replace("[2, 1,", "[1, 1,"))
    with pytest.raises(TrainingError, match=r"ours\.py is not the function of 1 matches"):
        EntryRun(entry(made, "ours"))._enter()


def test_an_agent_that_is_none_is_refused(place: Path, tmp_path: Path) -> None:
    names = {"mine": "nothing", "gone": "absent", "broken": "broken"}
    made = planned(tmp_path, *(f"{agent}={place}/bench_player.py:{name}" for agent, name in names.items()))
    with pytest.raises(UsageError, match="returned 7: a function"):
        EntryRun(entry(made, "mine")).run()
    with pytest.raises(ScenarioError, match="absent"):
        EntryRun(entry(made, "gone")).run()
    where = r"broken quick-v2 0, trained against self: .*bench_player\.py, line 11: ZeroDivisionError: "
    with pytest.raises(TrainingError, match=where) as found:
        EntryRun(entry(made, "broken")).run()
    assert isinstance(found.value.__cause__, ZeroDivisionError)


def test_anchors_are_the_policies_that_were_rated(place: Path, results: Path) -> None:
    """In half precision, the strongest last; of other kinds of game they are refused."""
    known = suite.suite(tasks.task_of(NAME))
    ratings = [known.members[f"anchor-{k}"].rating or 0.0 for k in (1, 2)]
    assert ratings == sorted(ratings)
    folder = place / "before" / "fast" / NAME / "9" / "training"
    trained = {path.stem: Player(path).policies[0].actor.last.weight for path in folder.glob("*.zip")}
    for k in (1, 2):
        player = known.members[f"anchor-{k}"].contender().player
        weight = player.policies[0].actor.last.weight
        assert not player.critic
        assert min(float((weight - own).abs().max().detach()) for own in trained.values()) < 1e-3
    other = place / "other.safetensors"
    change(results / "fast" / NAME / "0" / "policy.safetensors", other, {}, {}, memory=0, state=0, preset="paper")
    with pytest.raises(TrainingError, match=r"one preset|broken"):
        suite.make(tasks.task_of(NAME), [*folder.glob("*.zip"), other], place / "elsewhere", 2)


@pytest.mark.parametrize(
    ("alter", "message"),
    [
        (lambda rated: rated.update(version=1), "its version cannot be 1"),
        (lambda rated: rated["members"][0].update(elo="1"), "its members 0 elo cannot be '1'"),
        (lambda rated: rated["members"][0].update(steps=-1, plan={}, scenario={}), "its 0 steps cannot be -1"),
        (lambda rated: rated["members"].pop(), "its weights are not those of 1 anchors"),
        (lambda rated: rated.pop("members"), "KeyError: 'members'"),
        (lambda rated: rated["fingerprint"]["numbers"].update(heals_count=3), "its ratings belong to another game"),
    ],
)
@pytest.mark.usefixtures("results")
def test_other_anchors_are_refused(place: Path, tmp_path: Path, monkeypatch, alter: Any, message: str) -> None:
    header, policies = policy_file.read(place / "anchors" / f"{NAME}.safetensors")
    alter(header["suite"])
    policy_file.write(tmp_path / f"{NAME}.safetensors", header, policies)
    monkeypatch.setattr(suite, "FOLDER", tmp_path)
    with pytest.raises(TrainingError, match=re.escape(message)):
        suite.suite(tasks.task_of(NAME))


@pytest.mark.parametrize(
    ("alter", "message"),
    [
        (lambda content: content.update(version=1), "its version cannot be 1"),
        (lambda content: content.update(agent="../../etc"), "its agent cannot be '../../etc'"),
        (lambda content: content.pop("matches"), "KeyError: 'matches'"),
        (lambda content: content["policy"].update(steps=None), "its policy cannot be"),
        (lambda content: content["matches"][0].update(won=-4), "its matches 0 won cannot be -4"),
        (lambda content: content["matches"][0].update(moves="x"), "its matches 0 moves cannot be 'x'"),
        (lambda content: content["matches"][0]["figures"].update(kills=[1e999, 0]), "its matches 0 figures kills "),
        (lambda content: content["matches"][0].update(against="a\nb"), "its matches 0 against cannot be 'a"),
        (lambda content: content["matches"].append(content["matches"][0]), "a match occurs twice"),
    ],
)
def test_a_result_that_is_none_is_refused(first: Entry, alter: Callable[[Content], Any], message: str) -> None:
    alter(first.content)
    (first.folder / result.NAME).write_text(json.dumps(first.content))
    with pytest.raises(TrainingError, match="is not a result of the benchmark: .*" + message.replace("'", ".")):
        result.read(first.folder / result.NAME)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("plan quick-v2", "needs tasks and agents"),
        ("plan quick-v2 --agent nobody", "nobody: unknown agent: it must be a preset"),
        ("plan quick-v2 --agent fast --small", "--small has no effect on benchmark plan"),
        ("plan quick-v2 --agent mine=a.zip --memory 4 --seed 0", "memory has no effect on mine=a.zip"),
        ("plan quick-v2 --agent mine=a.zip", "is one training for all seeds: name one --seed, or put {seed} in it"),
        ("plan quick-v2 --agent fast --seed 4611686018427387904", "reserved for the worlds of tests"),
        ("plan quick-v2 quick-v2 --agent fast", "name each task once"),
        ("plan quick-v2 --agent fast --agent fast", "name each agent once"),
        ("plan quick-v2 --agent fast --seed 0 0", "name each seed once"),
        ("plan quick-v2 --agent mine=a.zip --seed 0", "mine, quick-v2, seed 0: a.zip does not exist"),
        ("plan quick-v2 --agent mine=a.py:make", "mine, quick-v2, seed 0: a.py:make does not exist"),
        ("plan quick-v2 --agent mine=runs/{tsk}-{seed}", "{tsk} is not replaced; {task}, {game} and {seed} are"),
        ("plan quick-v2 --agent fast --effect 2", "the plan is not possible: its effect cannot be 2.0"),
        ("plan quick-v2 --agent fast --agent Fast=fast", "name each agent once"),
        ("plan quick-v2 --agent fast --ppo gamma=2", "gamma"),
        ("plan quick-v2 --agent fast --pair fast,mine", "fast and mine: a pair needs two of the agents fast"),
        ("plan quick-v2 --agent a/b=fast", "must consist of letters, digits"),
        ("run nowhere", "nowhere does not hold manifest.json: make one by `outlast benchmark plan`"),
        ("verify nowhere", "nowhere does not exist: name a folder of results, or an archive"),
        ("check", "needs archives"),
        ("tasks ffa_2-v2", "lists all: leave out ffa_2-v2"),
        ("anchors quick-v2", "needs a task, --policies and --out"),
        ("people a.rec", "needs recordings and a name"),
    ],
)
def test_what_the_command_cannot_do_is_refused(words: str, message: str, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["benchmark", *words.split()]) == 2
    assert message in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]
