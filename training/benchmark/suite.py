"""The held-out suite: opponents that no agent is trained against, the same for all agents, with fixed ratings.

These are scripted styles, and anchors: frozen policies. For each task, `outlast benchmark anchors` makes a file
anchors/TASK.safetensors with all its anchors and the ratings of the suite in that task.
"""

import csv
import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.policies import STYLES as SCRIPTS
from outlast.envs.rollout.styles import follow
from outlast.envs.scenarios.fingerprint import difference, fingerprint, is_fingerprint, is_word
from outlast.envs.storage.kept_results import RESULTS, kept_file

from ..arena.match import Act
from ..arena.players import Contender
from ..base import policy_file, run_header
from ..base.errors import TrainingError
from ..policies.player import Player
from .result import BEST, SELF, Content, Result, are_finite
from .tasks import PROTOCOL, Task

STYLES = ("random", "noop", "scripted", "camper", "hunter", "hoarder", "healer")
FOLDER = RESULTS / "anchors"
TABLE = Path(__file__).with_name("anchors.csv")  # checksums of the suite's files
RATED = "suite"  # the part of an anchors' file about the suite
OWN = ("steps", "plan")  # parts of run.json that differ between anchors
Weights = dict[str, np.ndarray[Any, Any]]
Anchor = tuple[run_header.Header, Weights]  # run.json and the weights


@dataclass(frozen=True)
class SuiteOpponent:
    """An opponent of the suite.

    Attributes:
        name: A style, or the name of an anchor.
        file: File of the task's anchors; None for a style.
        digest: See `digest_of`; empty for a style.
        rating: Fixed Elo rating in the task; None: not rated yet.
    """

    name: str
    file: Path | None = None
    digest: str = ""
    rating: float | None = None

    def contender(self) -> Contender:
        """Return the opponent as a policy. Raises TrainingError."""
        if self.file is None:
            return style(self.name)
        header, weights = read_anchors(self.file)[1][self.name]
        content = {
            run_header.NAME: json.dumps(header).encode(),
            run_header.WEIGHTS: policy_file.weights_content([weights]),
        }
        found = Contender(self.name, Player(content))
        found.text = self.name
        return found


class RatedStyle(Contender):
    """A style as its ratings have it: in games with Steering it turns to and fro, and sees little."""

    def act(self, env: SurvivalVectorEnv, seed: int, *, keyed: bool = False, slack: float = 0.0) -> Act:
        """Return the function that plays the style, which draws nothing."""
        play = follow(SCRIPTS[self.text], env, pushed=True)
        return lambda seen, indices: np.asarray(play(seen)[indices])


def style(name: str) -> Contender:
    """Return the member of STYLES of that name."""
    return (RatedStyle if name in SCRIPTS else Contender)(name, name)


def suite(task: Task) -> list[SuiteOpponent]:
    """Return the suite of a task: styles, then anchors.

    Raises TrainingError if its file is invalid, or was made in another game; UsageError if it cannot be fetched.
    """
    place = _place(task)
    if not place.exists():
        return [SuiteOpponent(name) for name in STYLES]
    rated, anchors = read_anchors(place)
    if other := difference(rated["fingerprint"], fingerprint(task.games[0].scenario)):
        raise TrainingError(f"{place}: its ratings belong to another game {other}")
    return [_member(entry, place, anchors.get(entry["name"])) for entry in rated["members"]]


def _place(task: Task) -> Path:
    """Return the file of a task's anchors; fetched if results/ is missing. Raises UsageError."""
    place = FOLDER / f"{task.name}{policy_file.SUFFIX}"
    if FOLDER.parent.is_dir():
        return place
    with TABLE.open(encoding="utf-8", newline="") as file:
        known = {row["task"]: row["sha256"] for row in csv.DictReader(file)}
    return kept_file(f"anchors/{place.name}", known[task.name], f"the anchors of {task.name}")


def _member(entry: Content, place: Path, anchor: Anchor | None) -> SuiteOpponent:
    """Return a member of a suite. entry: Its part of the file. anchor: None for a style."""
    name, rating = entry["name"], float(entry["elo"])
    return (
        SuiteOpponent(name, rating=rating) if anchor is None else SuiteOpponent(name, place, digest_of(*anchor), rating)
    )


def digest_of(header: run_header.Header, weights: Weights) -> str:
    """Return the SHA-256 of an anchor, hexadecimal: of its run.json and its weights."""
    found = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name, values in sorted(weights.items()):
        found.update(f"{name} {values.shape}".encode() + values.astype("<f4").tobytes())
    return found.hexdigest()


def write_anchors(path: Path, anchors: Sequence[Anchor], rated: Content) -> None:
    """Write the file of a task's anchors, completely or not at all.

    Raises TrainingError: anchors differ in more than their weights and OWN, such as in their presets.

    anchors: In the order of `rated`. rated: The description of the suite: "members" has "name", "elo" and "error" of
    each, styles first.
    """
    common = [{key: value for key, value in header.items() if key not in OWN} for header, _ in anchors]
    shapes = [{name: values.shape for name, values in weights.items()} for _, weights in anchors]
    if any(each != common[0] for each in common) or any(each != shapes[0] for each in shapes):
        raise TrainingError("anchors of a task must be of one preset and one version of its game: leave out the others")
    members = [dict(member) for member in rated["members"]]
    for member, (header, _) in zip(members[len(members) - len(anchors) :], anchors, strict=True):
        member |= {key: header[key] for key in OWN}
    stacked = {name: np.stack([weights[name] for _, weights in anchors]) for name in shapes[0]}
    header = common[0] | {"steps": 0, RATED: rated | {"members": members}}
    policy_file.write(path, header, [stacked])


def read_anchors(path: Path) -> tuple[Content, dict[str, Anchor]]:
    """Return the description of the suite in a file of anchors, and the anchors by name. Raises TrainingError."""
    header, policies = policy_file.read(path)
    rated = header.pop(RATED, None)
    try:
        fault = _wrong(rated)
    except (KeyError, TypeError, AttributeError) as error:
        fault = f"{type(error).__name__}: {error}"
    names = [] if fault else [member["name"] for member in rated["members"] if OWN[0] in member]
    if not fault and any(len(values) != len(names) for own in policies for values in own.values()):
        fault = f"its weights are not those of {len(names)} anchors"
    if fault:
        raise TrainingError(f"{path} does not hold the anchors of a task: {fault:.200}")
    own = {member["name"]: {key: member[key] for key in OWN} for member in rated["members"] if OWN[0] in member}
    (stacked,) = policies
    weights = [{name: values[k] for name, values in stacked.items()} for k in range(len(names))]
    return rated, {name: (header | own[name], each) for name, each in zip(names, weights, strict=True)}


def missing(entry: Result, task: Task, members: Iterable[str]) -> list[tuple[str, str]]:
    """Return the games and opponents that an entry has not played: itself, the suite, the best response.

    members: Names of the suite.
    """
    wanted = [(game.name, name) for game in task.games for name in (SELF, *members)]
    if (entry.content["policy"] or {}).get("steps") is not None:  # unknown for functions
        wanted.append((task.games[0].name, BEST))
    return [each for each in wanted if each not in entry.against]


def other_games(content: Content, task: Task) -> str:
    """Describe a game of a result that differs from its task's; empty if none does."""
    for game in task.games:
        if other := difference(content["fingerprints"].get(game.name), fingerprint(game.scenario)):
            return f"its game '{game.name}' differs from that of {task.name} {other}"
    return ""


def _wrong(rated: Content) -> str:
    """Return the fault in a file's description of the suite; empty if it is valid."""
    if rated["version"] != PROTOCOL or not is_fingerprint(rated["fingerprint"]):
        return "invalid version or game"
    for entry in rated["members"]:
        if not is_word(entry["name"]) or not are_finite((entry["elo"], entry["error"])):
            return f"an invalid member: {entry!r:.80}"
        if OWN[0] in entry and not all(run_header.VALIDATORS[key](entry[key]) for key in OWN):
            return f"an invalid anchor: {entry!r:.80}"
    return ""
