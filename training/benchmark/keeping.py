"""Publication of results: the small parts, in a folder whose tables have the same bytes.

The numbers of all entries are in one file, see `kept`. If an agent's first seed in a task is a saved policy, the
policy and its games against itself are kept, so that these can be verified.
"""

from pathlib import Path

from ..arena.players import Contender
from ..base import policy_file
from ..base.errors import TrainingError
from ..base.files import write_files
from . import crossplay, games, kept, scores
from .kept import KeptResult, place_of
from .matches import digest
from .result import SELF, Result
from .tasks import task_of

POLICIES = "policies"  # the folder of policies: in or beside the folder of kept results


def keep(places: Path, folder: Path) -> list[Path]:
    """Keep results and return the paths written. Results of other tasks in the folder stay.

    Raises TrainingError: results are not complete, or the folder has results of one of these tasks that `places`
    lacks. Raises RecordingError: a recording does not fit the games of a policy.

    folder: Destination. Policies that are in policies/ beside it are not copied.
    """
    scores.scores(places)  # raises for incomplete results
    own = kept.find(places)
    there = kept.find(folder) if (folder / kept.NAME).exists() else []
    names = {place_of(entry) for entry in own}
    tasks = {name[:2] for name in names}
    if gone := [name for name in map(place_of, there) if name[:2] in tasks and name not in names]:
        raise TrainingError(
            f"{'/'.join(gone[0])} is in {folder} but not in {places}: keep these results in another folder"
        )
    known = {digest(path): path for path in sorted((folder.parent / POLICIES).rglob(f"*{policy_file.SUFFIX}"))}
    firsts = {place_of(entry)[:3]: entry for entry in sorted(own, key=lambda entry: -int(entry.content["seed"]))}
    every = [_kept(entry, folder, known, entry in firsts.values()) for entry in own]
    stay = [entry for entry in there if place_of(entry)[:2] not in tasks]
    cross = kept.Cross()
    for task in dict.fromkeys(entry.task_folder for entry in [*own, *stay]):
        rows = [[match[key] for key in ("one", "other", *kept.NUMBERS)] for match in crossplay.load(task).values()]
        cross |= {"/".join(task.parts[-2:]): rows} if rows else {}
    kept.write(folder, [*every, *stay], cross)
    files = (path for entry in every for path in (entry.policy, entry.recording(entry.against[kept.TRAINED, SELF])))
    return [folder / kept.NAME, *(path for path in files if path.exists() and path.is_relative_to(folder))]


def _kept(entry: Result, folder: Path, known: dict[str, Path], first: bool) -> KeptResult:
    """Write the kept files of an entry, and return its kept result.

    known: Policies beside the folder by their digests. first: Whether its seed is the first one of its agent.
    """
    name, content, match = place_of(entry), entry.content, entry.against[kept.TRAINED, SELF]
    policy, there = dict(content["policy"]), first and entry.policy.exists()
    policy.pop("file", None)
    if policy["digest"] in known:
        policy["file"] = Path("..", known[policy["digest"]].relative_to(folder.parent)).as_posix()
    elif there:
        policy["file"] = Path(POLICIES, *name[:3], f"{name[3]}{policy_file.SUFFIX}").as_posix()
        write_files({folder / policy["file"]: entry.policy.read_bytes()})
    own = {"recording": kept.NOTHING}
    short = KeptResult(folder.joinpath(*name), content).recording(match)
    if there and entry.recording(match).exists():
        _shorten(entry, short)
        own = {"recording": digest(short)}
    matches = [each | own if each is match else each for each in entry.matches]
    return KeptResult(folder.joinpath(*name), content | {"policy": policy, "matches": matches})


def _shorten(entry: Result, path: Path) -> None:
    """Write the games of an entry against itself in short form."""
    match = entry.against[kept.TRAINED, SELF]
    source = entry.recording(match)
    if source.suffix == kept.SHORT:
        write_files({path: source.read_bytes()})
        return
    player, game = Contender(entry.name, str(entry.policy)), task_of(entry.content["task"]).game(kept.TRAINED)
    games.shorten(game, [player], match["games"], source).write(path)
