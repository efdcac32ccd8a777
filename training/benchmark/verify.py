"""Verification: what a result claims is compared with its files, and every match is played again, action by action."""

import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from outlast.envs.errors import RecordingError, ScenarioError, UsageError

from ..arena.players import Contender
from ..base.errors import TrainingError
from ..base.processes import results
from . import scores
from .entry import Entry, chosen, entries_of, game_of, seats
from .games import Moves, digest, play
from .manifest import Manifest, read
from .policy_facts import SAME, agent_config, described, likeness, response_config, wrong_with_training
from .result import NUMBERS, SELF, Content, Pairing, Result, read_json
from .situations import passed

NEAR = 1e-4  # relative: smaller differences of figures are equal, since machines round sums differently
# Share of a saved policy's actions that may differ where another machine rounds otherwise, beside a few. For the
# policies of games.ROUNDING it is at most 1.3e-6; a search for actions to alter finds 5e-5.
SHARE, FEW = 5e-6, 3
ROUNDED = 2 / 64  # of situations: two of their 64 worlds may end otherwise on another machine


@dataclass(frozen=True)
class Verification:
    """A finding about a match, an entry, or scores.

    Attributes:
        what: "fast ffa_2-v2 0, trained against scripted".
        wrong: Contradiction with the result; empty if it has none.
        missing: Parts that could not be verified, since files are missing; empty if all were.
        differing: Number of actions within rounding of the choices of saved policies.
        drawn: Number of actions that saved policies chose.
    """

    what: str
    wrong: str = ""
    missing: str = ""
    differing: int = 0
    drawn: int = 0

    def __str__(self) -> str:
        text = f"{self.what}: {self.wrong or self.missing or 'as recorded'}"
        if not self.drawn:
            return text
        share = f" ({self.differing / self.drawn:.1e})" if self.differing else ""
        return f"{text}; {self.differing:,} of {self.drawn:,} actions differ by rounding{share}"

    def of(self, matches: Sequence["Verification"]) -> "Verification":
        """Return the joint finding of these matches; more actions may differ in them than rounding explains."""
        differing, drawn = (sum(getattr(match, name) for match in matches) for name in ("differing", "drawn"))
        wrong, missing = (sum(bool(getattr(match, name)) for match in matches) for name in ("wrong", "missing"))
        rest = "more of its actions differ than rounding explains" if differing > FEW + SHARE * drawn else ""
        return Verification(
            self.what,
            self.wrong or (f"of {len(matches)} matches, {wrong} are wrong" if wrong else rest),
            self.missing or (f"of {len(matches)} matches, {missing} are not verified" if missing else ""),
            differing,
            drawn,
        )


Check = Callable[[], Verification]  # can be pickled


def verify(folder: Path, at_once: int = 1, only: str = "") -> Iterator[Verification]:
    """Verify the results of a manifest, and yield the findings: of matches, and then of their entries; and of scores.

    folder: A folder of results. at_once: Number of processes. only: See `entries_of`. Raises TrainingError: the
    manifest cannot be read, or belongs to other games.
    """
    manifest = read(folder)
    entries = entries_of(manifest, only)
    plans = [checks(entry) for entry in entries]
    found = results([check for plan in plans for check in plan], at_once)
    for plan in plans:
        first, matches = next(found), []
        for match in itertools.islice(found, len(plan) - 1):
            matches.append(match)
            yield match
        yield first.of(matches)
    for (agent, task), group in itertools.groupby(entries, key=lambda entry: (entry.name, entry.task.name)):
        if (twins := _found(f"{agent} {task}", _of_seeds, [*group])).wrong:
            yield twins
    if (folder / scores.NAME).exists():
        yield _found(str(folder / scores.NAME), _of_scores, manifest)


def _found(what: str, judge: Callable[..., Verification], *arguments: Any) -> Verification:
    """Return a finding; what cannot be read, or played, is wrong. judge: Returns it without `what`."""
    try:
        return replace(judge(*arguments), what=what)
    except (RecordingError, ScenarioError, TrainingError, UsageError) as error:
        return Verification(what, str(error))


def _of_seeds(entries: Sequence[Entry]) -> Verification:
    """Find seeds of an agent in a task that are one training: their interval would not cover other trainings."""
    of_seed = {entry.seed: entry.manifest.result(entry.name, entry.task, entry.seed) for entry in entries}
    trained = {seed: own for seed, own in of_seed.items() if own.content["candidates"] and own.content["policy"]}
    for one, other in itertools.combinations(trained, 2):
        digests = {trained[seed].content["policy"]["digest"] for seed in (one, other)}
        paths = [trained[seed].policy() for seed in (one, other)]
        if len(digests) < 2 or (all(path.exists() for path in paths) and likeness(*paths) > SAME):
            return Verification("", f"seeds {one} and {other} are one training")
    return Verification("")


def _of_scores(manifest: Manifest) -> Verification:
    """Compare the scores beside the results with those that follow from the results."""
    path = manifest.folder / scores.NAME
    same = json.loads(json.dumps(scores.scores([manifest]))) == read_json(path, lambda content: "")
    return Verification("", "" if same else "the results have other scores: run `outlast benchmark score` again")


def checks(entry: Entry) -> list[Check]:
    """Return the checks of an entry, each with one finding: the entry itself first, then matches, and situations."""
    try:
        result = entry.manifest.result(entry.name, entry.task, entry.seed)
    except TrainingError as error:
        return [partial(Verification, str(entry), str(error))]
    found: list[Check] = [partial(_found, str(entry), _of_entry, entry, result)]
    found += [partial(_found, f"{entry}, {pairing}", _of_match, entry, result, pairing) for pairing in result.matches]
    if entry.first and result.content["policy"] is not None:
        found.append(partial(_found, f"{entry}, situations", _of_situations, entry, result))
    return found


def _of_entry(entry: Entry, result: Result) -> Verification:
    return Verification("", _wrong_with_entry(entry, result), _missing_of_entry(entry, result))


def _missing_of_entry(entry: Entry, result: Result) -> str:
    """Return the parts of an entry that are missing; empty if it is complete."""
    content = result.content
    if content["policy"] is None:
        return "it has not been run"
    if absent := [pairing for pairing in entry.planned if pairing not in result.matches]:
        return f"{absent[0]} has not been played"
    if entry.agent.function:
        return "a function of the user's is not executed: nobody can tell whether it chose these actions"
    candidates = range(len(content["candidates"]) if len(content["candidates"]) > 1 else 0)
    files = [result.policy(), *map(result.policy, candidates), *map(result.response, content["responses"])]
    gone = [path.name for path in files if not path.exists()]
    return f"{gone[0]} is missing" if gone else ""


def _wrong_with_entry(entry: Entry, result: Result) -> str:
    """Return the fault in the policies and the plan of an entry; empty if they are valid."""
    content, task = result.content, entry.task
    scores.check_planned(entry.manifest, result, task)
    count, policy, own = len(content["candidates"]), content["policy"], entry.manifest.content
    if entry.agent.function:
        known = policy is None or (policy["steps"], policy["of_task"], policy["met"]) == (None, False, [])
        return "" if known and not count else "it is a function, of whose training nothing can be known"
    if policy is None:
        return ""
    if count != entry.manifest.candidates(entry.agent):
        return f"it has {count} candidates: {entry.manifest.candidates(entry.agent)} are planned"
    best = chosen(result)
    if policy != content["candidates"][best]:
        return f"its policy is not candidate {best}, which won most games in the validation"
    facts = [(result.policy(), policy)]
    facts += [(result.policy(k), each) for k, each in enumerate(content["candidates"])]
    facts += [(result.response(name), each) for name, each in content["responses"].items()]
    for path, given in facts:
        if not path.exists():
            continue
        if digest(path) != given["digest"]:
            return f"{path.name} is not the file that was tested"
        for what, found in described(path, task).items():
            if given[what] != found:
                return f"{what} of {path.name} is {given[what]} in the result, but {found} in the file"
    if entry.agent.trained:
        config = agent_config(task, entry.agent, entry.seed, own["budget"], own["checkpoints"], 1)
        for path, k in [(result.policy(), best), *((result.policy(k), k) for k in range(count))]:
            steps = min(config.steps, config.every * (k + 1))
            if path.exists() and (fault := wrong_with_training(path, config, steps)):
                return fault
    for name in content["responses"]:
        kind, steps = name.split()
        if (path := result.response(name)).exists() and result.policy().exists():
            config = response_config(task, entry.seed, kind, int(steps), result.policy())
            if fault := wrong_with_training(path, config, int(steps), str(result.policy())):
                return fault
    return ""


def _of_situations(entry: Entry, result: Result) -> Verification:
    own, absent = _agent(entry, result, -1)
    given = result.content["situations"]
    if given is None:
        return Verification("", missing="it has not been tried in situations")
    if own is None:
        return Verification("", missing=absent)
    found = passed(entry.task.scenario, own)
    if given.keys() != found.keys():
        return Verification("", f"it has {', '.join(given) or 'none'}: the game has {', '.join(found) or 'none'}")
    for name, value in found.items():
        if abs(given[name] - value) > ROUNDED:
            return Verification("", f"{name} is {given[name]} in the result, but {value} here")
    return Verification("")


def _of_match(entry: Entry, result: Result, pairing: Pairing) -> Verification:
    """Return the finding about a match, which is played again."""
    path, match = result.folder / pairing.file, result.matches[pairing]
    if not path.exists():
        return Verification("", missing="its file is not here")
    if digest(path) != match["moves"]:
        return Verification("", "its file is not the one that was made")
    if pairing.against in result.content["responses"] and not (response := result.response(pairing.against)).exists():
        return Verification("", missing=f"{response.name} is missing")
    own, absent = _agent(entry, result, pairing.candidate)
    rivals = dict[str, str]()

    def rival(name: str) -> Contender | None:
        other = Entry(entry.manifest, name, entry.task, entry.seed)
        its = entry.manifest.result(name, entry.task, entry.seed)
        if its.content["policy"] is None or its.content["policy"]["digest"] != match["opponent"]:
            raise RecordingError(f"its opponent is not the {name} of this seed")
        policy, rivals[name] = _agent(other, its, -1)
        return policy

    policies = seats(result, entry.task, pairing, own, rival)
    functions = [name for name in rivals if entry.manifest.agents[name].function]
    absent = absent or next((fault for fault in rivals.values() if fault), "")
    if absent and not (entry.agent.function or functions):
        return Verification("", missing=absent)
    game = game_of(entry.task, pairing.game)
    played = play(game, policies, entry.manifest.games(pairing), Moves.read(path))
    wrong = _wrong_with_outcome(match, played.outcome, pairing.against == SELF)
    return Verification("", wrong, absent, played.differing, played.drawn)


def _agent(entry: Entry, result: Result, candidate: int) -> tuple[Contender | None, str]:
    """Return the policy of an entry, and what is missing of it; None for a function, which is not executed."""
    if entry.agent.function:
        return None, "a function of the user's is not executed, so its choices were not compared"
    path = result.policy(candidate)
    if not path.exists():
        return None, f"{path.name} is missing, so its choices were not compared"
    return Contender(path.stem, str(path)), ""


def _wrong_with_outcome(match: Content, outcome: Content, figures: bool) -> str:
    """Return the contradiction between a match that was played again and the result; empty without one."""
    for key in NUMBERS:
        if outcome[key] != match[key]:
            return f"{key} is {match[key]} in the result, but {outcome[key]} in its games"
    found = outcome["figures"] if figures else {}
    for name in sorted(match["figures"].keys() | found.keys()):
        one, two = (own.get(name, "nothing") for own in (match["figures"], found))
        if one != two and not (isinstance(one, list) and isinstance(two, list) and _near(one, two)):
            return f"{name} is {one} in the result, but {two} in its games"
    return ""


def _near(given: Sequence[float], found: Sequence[float]) -> bool:
    return all(abs(a - b) <= max(1e-9, NEAR * max(abs(a), abs(b))) for a, b in zip(given, found, strict=True))
