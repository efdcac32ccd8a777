"""Entries that are handed in: packed into one file, and verified.

What a result claims is compared with its files, and every match is played again, action by action.
"""

import contextlib
import io
import itertools
import json
import lzma
import re
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.errors import RecordingError, ScenarioError, UsageError

from ..arena.players import Contender
from ..base import policy_file
from ..base.config import TrainingConfig, parse_warm_start
from ..base.errors import TrainingError
from ..base.files import read_bytes, write_files
from ..base.presets import preset
from ..base.processes import results
from . import manifest, result, scores
from .entry import STEPS, Entry, described, entries_of, most_steps, opponents_in, response_config
from .games import SUFFIX, Moves, digest, play
from .manifest import Manifest
from .result import NUMBERS, SELF, Pairing
from .situations import passed

PART = r"\w[\w.+-]*"
NAMES = re.compile(rf"manifest\.json|scores\.json|{PART}/{PART}/\d+/(result\.json|{PART}\.(safetensors|npz))")
LARGEST, MOST, MANY = 2**28, 2**30, 100_000  # maximum bytes of an archive and of all it holds, maximum files
BROKEN = zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, RuntimeError, EOFError, OSError
FIRST = (1980, 1, 1, 0, 0, 0)  # the date of all files: equal results give equal bytes
NEAR = 1e-4  # relative: smaller differences of figures are equal, since machines round sums differently
# Share of a saved policy's actions that may differ where another machine rounds otherwise, beside a few. For the
# policies of games.ROUNDING it is at most 1.3e-6; a search for actions to alter finds 5e-5.
SHARE, FEW = 5e-6, 3
ROUNDED = 2 / 64  # of situations: two of their 64 worlds may end otherwise on another machine
SAME, LARGE = 0.7, 256  # cosine of two matrices, and their weights at least: one run keeps 0.98, two seeds have 0.2
FOREIGN = "a function of the user's is not executed"
UNCOMPARED = f"{FOREIGN}, so its choices were not compared"


def pack(folder: Path, path: Path, small: bool = False) -> int:
    """Write the results in a folder to an archive, and return its bytes. Raises TrainingError.

    small: Whether to leave out candidates, best responses, actions of functions, and files of seeds but the first.
    """
    own = manifest.read(folder)
    names = [manifest.NAME, *([scores.NAME] if (folder / scores.NAME).exists() else [])]
    functions = {result.AGENT + name for name, agent in own.agents.items() if agent.function}
    for entry in entries_of(own):
        files = [each for suffix in (policy_file.SUFFIX, SUFFIX) for each in sorted(entry.folder.glob(f"*{suffix}"))]
        if small:
            kept = {each.file for each in entry.matches if each.candidate < 0 and each.against not in functions}
            first = entry.first and not entry.agent.function
            files = [each for each in files if first and each.name in kept | {entry.policy().name}]
        if entry.content["policy"] is not None:
            names += [str(each.relative_to(folder)) for each in (entry.folder / result.NAME, *files)]
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in names:
            archive.writestr(zipfile.ZipInfo(name, FIRST), read_bytes(folder / name), zipfile.ZIP_DEFLATED, 9)
    write_files({path: content.getvalue()})
    return len(content.getvalue())


@contextlib.contextmanager
def opened(place: Path) -> Iterator[Path]:
    """Yield a folder of results: `place` itself, or the content of an archive. Raises TrainingError: it is neither."""
    if place.is_dir():
        yield place
        return
    if not place.is_file():
        raise TrainingError(f"{place} does not exist: name a folder of results, or an archive ENTRY.zip")
    with tempfile.TemporaryDirectory() as folder:
        try:
            with zipfile.ZipFile(io.BytesIO(read_bytes(place, LARGEST))) as archive:
                infos = archive.infolist()
                if len(infos) > MANY or sum(info.file_size for info in infos) > MOST:
                    raise TrainingError(f"{place} holds more than {MANY:,} files or {MOST:,} bytes")
                for info in infos:
                    if NAMES.fullmatch(info.filename) is None or Path(folder, info.filename).exists():
                        raise TrainingError(f"{place} holds {info.filename!r:.80}, which no result is called, or twice")
                    write_files({Path(folder, info.filename): archive.read(info)})
        except BROKEN as error:
            raise TrainingError(f"{place} is not an archive of results: {error}") from error
        if not Path(folder, manifest.NAME).exists():
            raise TrainingError(f"{place} does not hold {manifest.NAME}: make an archive by `outlast benchmark pack`")
        yield Path(folder)


@dataclass(frozen=True)
class Verification:
    """A finding about a match, an entry, or scores, called "fast ffa_2-v2 0, trained against scripted".

    wrong: Contradiction with the result; empty if it has none. missing: Parts that could not be verified, since files
    are missing; empty if all were. differing: Number of actions within rounding of the choices of saved policies.
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


class _Missing(UsageError):
    """Something cannot be verified."""


def verify(folder: Path, at_once: int = 1, only: str = "") -> Iterator[Verification]:
    """Verify the results in a folder, and yield the findings: of matches, and then of their entries; and of scores.

    at_once: Number of processes. only: See `entries_of`. Raises TrainingError for a manifest of other games, or none.
    """
    made = manifest.read(folder)
    entries = entries_of(made, only)
    plans = [checks(entry) for entry in entries]
    found = results([check for plan in plans for check in plan], at_once)
    for plan in plans:
        first, matches = next(found), list[Verification]()
        for match in itertools.islice(found, len(plan) - 1):
            matches.append(match)
            yield match
        yield first.of(matches)
    for name, group in itertools.groupby(entries, key=lambda entry: f"{entry.name} {entry.task.name}"):
        if (twins := _found(name, check_seeds, [*group])).wrong:
            yield twins
    if (folder / scores.NAME).exists():
        yield _found(str(folder / scores.NAME), check_scores, made)


def checks(entry: Entry) -> list[partial[Verification]]:
    """Return the checks of an entry, each with one finding: the entry itself first, then matches, and situations."""
    found = [partial(_found, str(entry), check_entry, entry)]
    with contextlib.suppress(TrainingError):  # which the first check reports
        matches = [pairing for pairing in entry.matches if pairing in entry.planned]
        found += [partial(_found, f"{entry}, {pairing}", check_match, entry, pairing) for pairing in matches]
        if entry.first and entry.content["policy"] is not None:
            found.append(partial(_found, f"{entry}, situations", check_situations, entry))
    return found


def _found(what: str, check: Callable[..., Any], *arguments: Any) -> Verification:
    """Return a finding: what a check raises is wrong or missing; it may return what is missing, differing and drawn."""
    try:
        return Verification(what, "", *(check(*arguments) or ()))
    except _Missing as error:
        return Verification(what, missing=str(error))
    except (RecordingError, ScenarioError, UsageError) as error:
        return Verification(what, str(error))


def check_seeds(entries: Sequence[Entry]) -> None:
    """Find seeds of an agent in a task that are one training: their interval would not cover other trainings."""
    trained = [own for own in entries if own.content["candidates"] and own.content["policy"]]
    for one, other in itertools.combinations(trained, 2):
        paths = [one.policy(), other.policy()]
        same = one.content["policy"]["digest"] == other.content["policy"]["digest"]
        if same or (all(path.exists() for path in paths) and likeness(*paths) > SAME):
            raise TrainingError(f"seeds {one.seed} and {other.seed} are one training")


def check_scores(made: Manifest) -> None:
    """Compare the scores beside the results with those that follow from the results."""
    if json.loads(json.dumps(scores.scores([made]))) != result.read_json(made.folder / scores.NAME, {}):
        raise TrainingError("the results have other scores: run `outlast benchmark score` again")


def check_entry(entry: Entry) -> None:
    """Check the policies and the plan of an entry, and that nothing of it is missing."""
    entry.check_planned()
    content, count, policy = entry.content, len(entry.content["candidates"]), entry.content["policy"]
    if entry.agent.function:
        if count or (policy and (policy["steps"], policy["of_task"], policy["met"]) != (None, False, [])):
            raise TrainingError("it is a function, of whose training nothing can be known")
    elif policy is not None:
        if count != entry.candidates:
            raise TrainingError(f"it has {count} candidates: {entry.candidates} are planned")
        if policy != content["candidates"][best := entry.chosen()]:
            raise TrainingError(f"its policy is not candidate {best}, which won most games in the validation")
        _check_files(entry, best)
    if policy is None:
        raise _Missing("it has not been run")
    if absent := [pairing for pairing in entry.planned if pairing not in entry.matches]:
        raise _Missing(f"{absent[0]} has not been played")
    if entry.agent.function:
        raise _Missing(f"{FOREIGN}: nobody can tell whether it chose these actions")
    needed = [entry.policy(), *(entry.policy(k) for k in range(count) if count > 1)]
    if gone := [path for path in (*needed, *map(entry.response, content["responses"])) if not path.exists()]:
        raise _Missing(f"{gone[0].name} is missing")


def _check_files(entry: Entry, best: int) -> None:
    """Check the files of policies that are there: what the result says of them, and how they were trained."""
    content, own = entry.content, entry.policy()
    facts = [(own, content["policy"], best)]
    facts += [(entry.policy(k), given, k) for k, given in enumerate(content["candidates"])]
    facts += [(entry.response(name), given, -1) for name, given in content["responses"].items()]
    for path, given, k in (fact for fact in facts if fact[0].exists()):
        if digest(path) != given["digest"]:
            raise TrainingError(f"{path.name} is not the file that was tested")
        for what, found in described(path, entry.task).items():
            if given[what] != found:
                raise TrainingError(f"{what} of {path.name} is {given[what]} in the result, but {found} in the file")
        if entry.agent.trained and k >= 0:
            check_training(path, entry.config, entry.shares[k])
    for kind, steps in map(str.split, content["responses"] if own.exists() else ()):
        if (path := entry.response(f"{kind} {steps}")).exists():
            check_training(path, response_config(entry.task, entry.seed, kind, int(steps), own), int(steps), str(own))


def check_training(path: Path, config: TrainingConfig, steps: int, own: str = "") -> None:
    """Raise TrainingError unless a file was trained as the protocol prescribes: by a config, for so many agent-steps.

    own: The file of the policy that a best response was trained against; "": any opponents.
    """
    header = policy_file.read_header(path, ("plan", "preset", "scenario", STEPS))
    plan, wanted = dict(header["plan"]), dict(config.header()["plan"])
    for each in (plan, wanted):  # places and machines differ; a longer run has the same checkpoints
        for key in ("threads", "every", "device", "processes", "steps", "asked"):
            each.pop(key, None)
        if own:  # in another folder
            each["opponents"] = {Path(name).name: weight for name, weight in opponents_in(each).items()}
            teacher, length = parse_warm_start(each.get("warm_start", ""))
            each["warm_start"] = Path(teacher).name, length
    given = {key: plan.get(key, value) for key, value in wanted.items()}  # earlier files lack some
    given["game"] = not preset(header["preset"]).difference(header["scenario"], config.scenario)
    for key, value in (wanted | {"game": True}).items():
        if given[key] != value:
            raise TrainingError(f"{path.name} was not trained as the protocol says: {key} is {given[key]}, not {value}")
    if not steps <= header[STEPS] <= most_steps(steps):
        raise TrainingError(f"{path.name} has {header[STEPS]:,} agent-steps, and {steps:,} are planned")


def likeness(one: Path, other: Path) -> float:
    """Return the largest cosine of two large matrices in the same place of two policies, without critics; 0 if none."""
    first, second = (
        {
            (k, name): values.ravel().astype(np.float64)
            for k, own in enumerate(policy_file.read(path)[1])
            for name, values in own.items()
            if values.ndim > 1 and values.size >= LARGE and not name.startswith(policy_file.CRITIC)
        }
        for path in (one, other)
    )
    pairs = [(first[key], second[key]) for key in first if key in second and len(first[key]) == len(second[key])]
    return max((float(a @ b / np.sqrt((a @ a) * (b @ b)).clip(1e-30)) for a, b in pairs), default=0.0)


def check_situations(entry: Entry) -> None:
    """Try an entry in situations again."""
    given, own = entry.content["situations"], _agent(entry, -1)
    if given is None or own is None:
        raise _Missing(UNCOMPARED if given is not None else "it has not been tried in situations")
    found = passed(entry.task.scenario, own)
    if given.keys() != found.keys():
        raise TrainingError(f"it has {', '.join(given) or 'none'}: the game has {', '.join(found) or 'none'}")
    for name, value in found.items():
        if abs(given[name] - value) > ROUNDED:
            raise TrainingError(f"{name} is {given[name]} in the result, but {value} here")


def check_match(entry: Entry, pairing: Pairing) -> tuple[str, int, int]:
    """Play a match again. Return what is not verified of it, and the numbers of actions that differ and were drawn."""
    path, match = entry.folder / pairing.file, entry.matches[pairing]
    if not path.exists():
        raise _Missing("its file is not here")
    if digest(path) != match["moves"]:
        raise TrainingError("its file is not the one that was made")
    if pairing.against in entry.content["responses"] and not (response := entry.response(pairing.against)).exists():
        raise _Missing(f"{response.name} is missing")

    def rival(other: Entry) -> Contender | None:
        policy = other.content["policy"]
        if policy is None or policy["digest"] != match["opponent"]:
            raise TrainingError(f"its opponent is not the {other.name} of this seed")
        return _agent(other, -1)

    policies = [_agent(entry, pairing.candidate), *entry.others(pairing, rival)]
    played = play(entry.task.games[pairing.game], policies, entry.games(pairing), Moves.read(path))
    for key in NUMBERS:
        if played.outcome[key] != match[key]:
            raise TrainingError(f"{key} is {match[key]} in the result, but {played.outcome[key]} in its games")
    figures = played.outcome["figures"] if pairing.against == SELF else {}
    for name in sorted(match["figures"].keys() | figures.keys()):
        one, two = (own.get(name, "nothing") for own in (match["figures"], figures))
        if one != two and not (isinstance(one, list) and isinstance(two, list) and np.allclose(one, two, NEAR, 1e-9)):
            raise TrainingError(f"{name} is {one} in the result, but {two} in its games")
    return UNCOMPARED if None in policies else "", played.differing, played.drawn


def _agent(entry: Entry, candidate: int) -> Contender | None:
    """Return the policy of an entry; None for a function, which is not executed. Raises _Missing."""
    if entry.agent.function:
        return None
    if not (path := entry.policy(candidate)).exists():
        raise _Missing(f"{path.name} is missing, so its choices were not compared")
    return entry.contender(candidate)
