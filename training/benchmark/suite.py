"""The suite: opponents that no agent is trained against, the same for all agents, with fixed ratings.

These are scripted styles, and anchors: frozen policies of rising strength, of which the strongest beats every style.
`outlast benchmark anchors` makes the file of a task, anchors/TASK.safetensors, with all its anchors and ratings.
"""

import contextlib
import csv
import functools
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.rollout.saved import RESULTS, kept_file
from outlast.envs.scenarios.fingerprint import difference, fingerprint, is_fingerprint, is_word
from outlast.envs.storage import inputs

from ..arena.evaluation import Evaluation
from ..arena.players import Contender, labels
from ..base import policy_file
from ..base.errors import TrainingError
from ..policies.player import Player, weights_of
from .games import digest
from .result import Content, fault, is_finite, made
from .tasks import PROTOCOL, Task

FOLDER = RESULTS / "anchors"
TABLE = Path(__file__).with_name("anchors.csv")  # checksums of the suite's files
RATED = "suite"  # the part of an anchors' file about the suite
OWN = ("steps", "plan", "scenario")  # parts of run.json that differ between anchors
MEMBER = {"name": is_word, "elo": is_finite, "error": is_finite}
SUITE = {"version": PROTOCOL, "fingerprint": is_fingerprint, "members": [MEMBER]}
Weights = dict[str, np.ndarray[Any, Any]]
Anchor = tuple[policy_file.Header, list[Weights]]  # run.json, and the weights of each of its policies


@dataclass(frozen=True)
class SuiteOpponent:
    """An opponent of the suite: a style, or an anchor.

    rating: Fixed Elo rating in the task; None: not rated yet. error: Its standard error, over games. anchor: run.json
    and weights of an anchor; None for a style.
    """

    name: str
    rating: float | None = None
    error: float = 0.0
    anchor: Anchor | None = None

    def contender(self) -> Contender:
        """Return the opponent as a policy. Raises TrainingError."""
        if self.anchor is None:
            return Contender(self.name, self.name)
        header, weights = self.anchor
        content = {policy_file.RUN_JSON: json.dumps(header).encode()}
        content[policy_file.WEIGHTS] = policy_file.weights_content(weights)
        found = Contender(self.name, Player(content))
        found.text = self.name
        return found


@dataclass(frozen=True)
class Suite:
    """The suite of a task.

    members: By name: styles, then anchors. digest: SHA-256 of the anchors' file; for styles alone, of their names.
    """

    members: dict[str, SuiteOpponent]
    digest: str

    def strongest(self, anchors: bool) -> list[str]:
        """Return the names of all styles, or of all anchors, the strongest first; of equal ones the last."""
        names = [name for name, member in self.members.items() if (member.anchor is not None) == anchors]
        return sorted(names, key=lambda name: self.members[name].rating or 0.0)[::-1]

    @property
    def validators(self) -> list[str]:
        """The opponents in validations: the strongest style, the strongest anchor, and the middle one."""
        anchors = self.strongest(True)
        return [self.strongest(False)[0], *dict.fromkeys([*anchors[:1], *anchors[len(anchors) // 2 :][:1]])]

    @property
    def mates(self) -> list[str]:
        """The team-mates of tests with others: the strongest style and the strongest anchor."""
        return [*self.strongest(False)[:1], *self.strongest(True)[:1]]


def suite(task: Task) -> Suite:
    """Return the suite of a task. Raises TrainingError: its file is invalid; UsageError: it cannot be fetched."""
    place = FOLDER / f"{task.name}{policy_file.SUFFIX}"
    if not FOLDER.parent.is_dir():
        with TABLE.open(encoding="utf-8", newline="") as file:
            known = {row["task"]: row["sha256"] for row in csv.DictReader(file)}
        place = kept_file(f"anchors/{place.name}", known[task.name], f"the anchors of {task.name}")
    if not place.exists():
        names = " ".join(task.styles).encode()
        return Suite({name: SuiteOpponent(name) for name in task.styles}, hashlib.sha256(names).hexdigest())
    return _read(task, place, place.stat().st_mtime_ns)


@functools.lru_cache
def _read(task: Task, place: Path, changed: int) -> Suite:
    """Return the suite in a file, which is read again when it has changed."""
    header, policies = policy_file.read(place)
    rated, own = header.pop(RATED, None), dict[str, policy_file.Header]()
    try:
        own = {each["name"]: {key: each[key] for key in OWN} for each in rated["members"] if "plan" in each}
        wrong = fault(rated, SUITE) or fault([*own.values()], [{key: policy_file.VALIDATORS[key] for key in OWN}])
    except inputs.BROKEN_JSON as error:
        wrong = f"{type(error).__name__}: {error}"
    if not wrong and any(len(values) != len(own) for weights in policies for values in weights.values()):
        wrong = f"its weights are not those of {len(own)} anchors"
    if wrong:
        raise TrainingError(f"{place} does not hold the anchors of a task: {wrong:.200}")
    if other := difference(rated["fingerprint"], fingerprint(task.tests[0].scenario)):
        raise TrainingError(f"{place}: its ratings belong to another game {other}")
    weights = [[{key: values[k] for key, values in one.items()} for one in policies] for k in range(len(own))]
    anchors = {name: (header | own[name], each) for name, each in zip(own, weights, strict=True)}
    rows = [(each["name"], float(each["elo"]), float(each["error"])) for each in rated["members"]]
    return Suite({row[0]: SuiteOpponent(*row, anchors.get(row[0])) for row in rows}, digest(place))


def make(
    task: Task, sources: Sequence[Path], folder: Path, games: int, progress: Callable[..., None] = lambda *_: None
) -> Path:
    """Rate checkpoints and styles by a round robin, and write TASK.safetensors, the file of the suite, into a folder.

    Returns its path. progress: Called with the numbers of matches done and of all matches. Raises TrainingError.
    """
    labels([str(source.resolve()) for source in sources])  # none twice
    anchors = list[Anchor]()
    for source in sources:  # weights are kept in half precision
        header, policies = weights_of(source, critic=False)
        halves = [{name: values.astype(np.float16) for name, values in one.items()} for one in policies]
        anchors.append((header, [{name: half.astype(np.float32) for name, half in one.items()} for one in halves]))
    if any(_kind(each) != _kind(anchors[0]) for each in anchors):
        raise TrainingError("anchors of a task must be of one preset and one kind of game: leave out the others")
    players = [*map(SuiteOpponent, task.styles), *(SuiteOpponent("", anchor=anchor) for anchor in anchors)]
    rated, chosen = task.tests[0], [each.contender() for each in players]
    evaluation = Evaluation(rated.scenario, chosen, episodes=games, worlds=games, seed=rated.seed)
    with contextlib.closing(evaluation):
        pairs = [(i, j) for i, j in evaluation.pairs if i != j]
        for k, pair in enumerate(pairs):
            progress(k, len(pairs))
            evaluation.play_pair(pair)
        ratings, errors = (np.round(each, 1) for each in evaluation.ratings() or ())
    styles = len(task.styles)
    order = [*range(styles), *(styles + np.argsort(ratings[styles:])).tolist()]  # anchors of rising strength
    members = [{"name": players[k].name, "elo": float(ratings[k]), "error": float(errors[k])} for k in order]
    anchors = [anchors[k - styles] for k in order[styles:]]
    for number, (member, (header, _)) in enumerate(zip(members[styles:], anchors, strict=True), 1):
        member |= {"name": f"anchor-{number}"} | {key: header[key] for key in OWN}
    own = {"version": PROTOCOL, "fingerprint": fingerprint(rated.scenario), "games": games, "made": made()}
    header = anchors[-1][0] | {"steps": 0, RATED: own | {"members": members}}
    every = [policies for _, policies in anchors]
    stacked = [{name: np.stack([own[k][name] for own in every]) for name in one} for k, one in enumerate(every[0])]
    path = folder / f"{task.name}{policy_file.SUFFIX}"
    policy_file.write(path, header, stacked)
    return path


def _kind(anchor: Anchor) -> tuple[Content, list[dict[str, tuple[int, ...]]]]:
    """Return what all anchors of a task have in common: parts of run.json, and shapes of weights."""
    header, policies = anchor
    common = {key: value for key, value in header.items() if key not in (*OWN, "modules")}
    return common, [{name: values.shape for name, values in one.items()} for one in policies]
