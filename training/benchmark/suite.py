"""The suite: opponents that no agent is trained against, the same for all agents, with fixed ratings.

These are scripted styles, and anchors: frozen policies of rising strength, of which the strongest beats every style.
For each task, `outlast benchmark anchors` makes a file anchors/TASK.safetensors with all its anchors and the ratings of
the suite in that task.
"""

import csv
import functools
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.scenarios.fingerprint import difference, fingerprint, is_fingerprint, is_word
from outlast.envs.storage.kept_results import RESULTS, kept_file

from ..arena.players import Contender, labels
from ..arena.ratings import elo
from ..base import policy_file, run_header
from ..base.errors import TrainingError
from ..policies.player import Player, weights_of
from .games import digest, play
from .result import Content, are_finite, made, read_json, write_json
from .tasks import PROTOCOL, Task

FOLDER = RESULTS / "anchors"
TABLE = Path(__file__).with_name("anchors.csv")  # checksums of the suite's files
RATED = "suite"  # the part of an anchors' file about the suite
OWN = ("steps", "plan", "scenario")  # parts of run.json that differ between anchors
Weights = dict[str, np.ndarray[Any, Any]]
Anchor = tuple[run_header.Header, list[Weights]]  # run.json, and the weights of each of its policies


@dataclass(frozen=True)
class SuiteOpponent:
    """An opponent of the suite.

    Attributes:
        name: A style, or the name of an anchor.
        rating: Fixed Elo rating in the task; None: not rated yet.
        error: Standard error of the rating, over games.
        anchor: run.json and weights of an anchor; None for a style.
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
        content = {
            run_header.NAME: json.dumps(header).encode(),
            run_header.WEIGHTS: policy_file.weights_content(weights),
        }
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

    @functools.cached_property
    def _by_rating(self) -> tuple[list[str], list[str]]:
        """Styles and anchors, the strongest first."""
        names = sorted(self.members, key=lambda name: self.members[name].rating or 0.0)[::-1]  # of equal ones the last
        anchors = [name for name in names if self.members[name].anchor is not None]
        return [name for name in names if name not in anchors], anchors

    @property
    def validators(self) -> list[str]:
        """The opponents in validations: the strongest style, the strongest anchor, and the middle one."""
        styles, anchors = self._by_rating
        return [styles[0], *dict.fromkeys((anchors[0], anchors[len(anchors) // 2]) if anchors else ())]

    @property
    def mates(self) -> list[str]:
        """The team-mates of tests with others: the strongest style and the strongest anchor."""
        return [each[0] for each in self._by_rating if each]


def suite(task: Task) -> Suite:
    """Return the suite of a task.

    Raises TrainingError if its file is invalid, or was made in another game; UsageError if it cannot be fetched.
    """
    place = _place(task)
    if not place.exists():
        names = " ".join(task.styles).encode()
        return Suite({name: SuiteOpponent(name) for name in task.styles}, hashlib.sha256(names).hexdigest())
    return _read(task, place, place.stat().st_mtime_ns)


@functools.lru_cache
def _read(task: Task, place: Path, changed: int) -> Suite:
    """Return the suite in a file, which is read again when it has changed."""
    rated, anchors = read_anchors(place)
    if other := difference(rated["fingerprint"], fingerprint(task.tests[0].scenario)):
        raise TrainingError(f"{place}: its ratings belong to another game {other}")
    members = [
        SuiteOpponent(entry["name"], float(entry["elo"]), float(entry["error"]), anchors.get(entry["name"]))
        for entry in rated["members"]
    ]
    return Suite({member.name: member for member in members}, digest(place))


def _place(task: Task) -> Path:
    """Return the file of a task's anchors; fetched if results/ is missing. Raises UsageError."""
    place = FOLDER / f"{task.name}{policy_file.SUFFIX}"
    if FOLDER.parent.is_dir():
        return place
    with TABLE.open(encoding="utf-8", newline="") as file:
        known = {row["task"]: row["sha256"] for row in csv.DictReader(file)}
    return kept_file(f"anchors/{place.name}", known[task.name], f"the anchors of {task.name}")


def read_anchors(path: Path) -> tuple[Content, dict[str, Anchor]]:
    """Return the description of the suite in a file of anchors, and the anchors by name. Raises TrainingError."""
    header, policies = policy_file.read(path)
    rated = header.pop(RATED, None)
    try:
        fault = _wrong(rated)
    except (KeyError, TypeError, AttributeError) as error:
        fault = f"{type(error).__name__}: {error}"
    own = (
        {} if fault else {each["name"]: {key: each[key] for key in OWN} for each in rated["members"] if "plan" in each}
    )
    if not fault and any(len(values) != len(own) for weights in policies for values in weights.values()):
        fault = f"its weights are not those of {len(own)} anchors"
    if fault:
        raise TrainingError(f"{path} does not hold the anchors of a task: {fault:.200}")
    each = [[{name: values[k] for name, values in one.items()} for one in policies] for k in range(len(own))]
    return rated, {name: (header | own[name], weights) for name, weights in zip(own, each, strict=True)}


def _wrong(rated: Content) -> str:
    """Return the fault in a file's description of the suite; empty if it is valid."""
    if rated["version"] != PROTOCOL or not is_fingerprint(rated["fingerprint"]):
        return "invalid version or game"
    for entry in rated["members"]:
        if not is_word(entry["name"]) or not are_finite((entry["elo"], entry["error"])):
            return f"an invalid member: {entry!r:.80}"
        if "plan" in entry and not all(run_header.VALIDATORS[key](entry[key]) for key in OWN):
            return f"an invalid anchor: {entry!r:.80}"
    return ""


def make(
    task: Task,
    sources: Sequence[Path],
    folder: Path,
    games: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Rate checkpoints and styles by a round robin, and write the file of the suite. A stopped run can be continued.

    Returns the path of TASK.safetensors. Raises TrainingError: a file is not a checkpoint, or is named twice; presets
    differ; the folder cannot be written.

    task: The task of the anchors. sources: Checkpoints. folder: Folder for TASK.safetensors, and for TASK-games.json,
    which need not be kept. progress: Called with the number of matches done, and that of all matches.
    """
    names = labels([str(source.resolve()) for source in sources])
    anchors = [_rounded(source) for source in sources]
    known = [SuiteOpponent(name, anchor=anchor) for name, anchor in zip(names, anchors, strict=True)]
    players = [*map(SuiteOpponent, task.styles), *known]
    wins, draws = _round_robin(task, players, folder / f"{task.name}-games.json", games, progress)
    ratings, errors = elo(wins, draws)
    count = len(task.styles)
    order = [*range(count), *(count + np.argsort(ratings[count:])).tolist()]  # anchors of rising strength
    anchors = [anchor for k in order if (anchor := players[k].anchor) is not None]
    members = [
        {"name": players[k].name, "elo": round(float(ratings[k]), 1), "error": round(float(errors[k]), 1)}
        for k in order
    ]
    for number, (member, (header, _)) in enumerate(zip(members[count:], anchors, strict=True), 1):
        member |= {"name": f"anchor-{number}"} | {key: header[key] for key in OWN}
    common = [{key: value for key, value in header.items() if key not in (*OWN, "modules")} for header, _ in anchors]
    shapes = [[{name: values.shape for name, values in one.items()} for one in policies] for _, policies in anchors]
    if any(each != common[0] for each in common) or any(each != shapes[0] for each in shapes):
        raise TrainingError("anchors of a task must be of one preset and one kind of game: leave out the others")
    own = {"version": PROTOCOL, "fingerprint": fingerprint(task.tests[0].scenario), "games": games, "made": made()}
    header = anchors[-1][0] | {"steps": 0, RATED: own | {"members": members}}
    stacked = [
        {name: np.stack([policies[k][name] for _, policies in anchors]) for name in one}
        for k, one in enumerate(shapes[0])
    ]
    path = folder / f"{task.name}{policy_file.SUFFIX}"
    policy_file.write(path, header, stacked)
    return path


def _rounded(source: Path) -> Anchor:
    """Return the header and the weights of a policy, in half precision as they are kept. Raises TrainingError."""
    header, policies = weights_of(source, critic=False)
    return header, [
        {name: values.astype(np.float16).astype(np.float32) for name, values in one.items()} for one in policies
    ]


def _round_robin(
    task: Task, players: Sequence[SuiteOpponent], place: Path, games: int, progress: Callable[[int, int], None]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the games that each player won against each other, and draws: float64 (players, players) both."""
    pairs = [(i, j) for j in range(len(players)) for i in range(j)]
    known: Content = read_json(place, lambda content: "") if place.exists() else {}
    wins, draws = np.zeros((2, len(players), len(players)))
    for k, (i, j) in enumerate(pairs):
        progress(k, len(pairs))
        key = " ".join((str(games), *(name for n in (i, j) for name in (players[n].name, _digest(players[n])))))
        if key not in known:
            found = play(task.tests[0], [players[i].contender(), players[j].contender()], games).outcome
            known[key] = [found["won"], found["drawn"], found["lost"]]
            write_json(place, known)
        wins[i, j], draws[i, j], wins[j, i] = known[key]
        draws[j, i] = draws[i, j]
    return wins, draws


def _digest(player: SuiteOpponent) -> str:
    """Return a hash of the weights of an anchor; "" for a style."""
    policies = player.anchor[1] if player.anchor else []
    joined = b"".join(values.tobytes() for weights in policies for _, values in sorted(weights.items()))
    return hashlib.sha256(joined).hexdigest()[:16] if joined else ""
