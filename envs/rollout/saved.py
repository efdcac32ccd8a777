"""Saved policies, and models, which are those that models.csv lists: finding, loading, observations that they need.

Models are files of results/, outside of the package. They come from the checkout that outlast runs from or in, or from
where results are published, through pooch, which keeps them in the cache. A variable of the environment names another
place.
"""

import contextlib
import csv
import functools
import hashlib
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import quote, urlsplit
from urllib.request import url2pathname

from outlast.ecs.kernels.cache_files import cache_folders
from outlast.ecs.kernels.errors import did_you_mean

from ..errors import UsageError, needed
from ..scenarios.scenario import Scenario

RESULTS = Path(__file__).resolve().parents[2] / "results"  # of a checkout; a wheel has none
HERE = "results"  # of a checkout that is the working directory, from which outlast may have been installed
ADDRESS = "OUTLAST_RESULTS_URL"  # the variable that names another place of results
LABEL = "Results"  # of the address in the project's metadata
SECONDS = 30  # that a server may be silent
TABLE = Path(__file__).with_name("models.csv")
ENDINGS = ".zip", ".safetensors"  # of saved policies: a checkpoint of a run, or weights alone
SAVED_AS = "a model's name, FILE.zip, FILE.safetensors or the folder of a run"  # what a saved policy is named by
CHECKPOINT = "steps_{:010d}.zip"  # name of a saved policy in the folder of a run, with its agent-steps
STEPS = re.compile(r"steps_(\d{10,})\.zip")
MASKED, REVEALED, OMNISCIENT = "masked", "revealed", "omniscient"  # values of cameras_mode


@dataclass(frozen=True)
class Model:
    """A trained policy that is kept."""

    name: str  # GAME/KIND-SEED
    preset: str
    steps: int  # agent-steps of its training
    wins: float  # share of games that it wins against `scripted`, where a draw counts as half
    size: int  # bytes of its file
    sha256: str

    @property
    def seed(self) -> int:
        """The seed of its training."""
        return int(self.name.rpartition("-")[2])

    @property
    def file(self) -> str:
        """The path of its file in the results."""
        return f"policies/{self.name}.safetensors"


@functools.cache
def models() -> Mapping[str, Model]:
    """Return all models by name, in the order of the table."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows: list[dict[str, Any]] = [*csv.DictReader(file)]
    numbers = {"steps": int, "wins": float, "size": int}
    found = (Model(**row | {key: kind(row[key]) for key, kind in numbers.items()}) for row in rows)
    return MappingProxyType({model.name: model for model in found})


def fetched(name: str) -> Path:
    """Return the file of a model, which has the checksum of the table. Raises UsageError if it cannot be had."""
    model = models()[name]
    return kept_file(model.file, model.sha256, name)


def cameras_mode(scenario: Scenario) -> str | None:
    """Return the scenario's cameras_mode, or the distribution it is drawn from; None without cameras."""
    mode = dict(scenario.varied).get("cameras_mode", scenario.numbers().get("cameras_mode"))
    return None if mode is None else str(mode)


def is_saved(name: str) -> bool:
    """Return whether it names a saved policy: a model, or a file by its ending."""
    return name in models() or (name.endswith(ENDINGS) and name not in ENDINGS)


def text_of(given: str | os.PathLike[str]) -> str:
    """Return what names a policy as text; a path that looks like a model's name becomes "./teams_3/fast-0"."""
    text = os.fspath(given)
    return text if isinstance(given, str) or text not in models() else os.path.join(os.curdir, text)


def located(given: str | os.PathLike[str]) -> Path:
    """Return the file of a saved policy: a model's, by its name; the file itself; a run's newest, by its folder."""
    text = text_of(given)
    if text in models():
        return fetched(text)
    if not text:
        raise UsageError(f"no policy is named: {SAVED_AS} is needed")
    if "/" in text and not (is_saved(text) or os.path.exists(text)):
        raise UsageError(f"there is no {text}: {similar(text)}{SAVED_AS} is needed")
    return newest(Path(text))


def similar(text: str, names: Iterable[str] = ()) -> str:
    """Return "did you mean runs/duel? ", with what is beside a path, or one of `names` and models; "" for none."""
    place = Path(text)
    with contextlib.suppress(OSError):
        beside = [str(each) for each in place.parent.iterdir()] if len(place.parts) > 1 else []
        if question := did_you_mean(place, beside, after=" "):
            return question
    return did_you_mean(text, [*names, *models()], after=" ")


def checkpoints(folder: Path) -> list[Path]:
    """Return the saved policies in the folder of a run, by their steps. Files with other names are ignored."""
    found = (path for path in folder.glob("*") if STEPS.fullmatch(path.name))
    return sorted(found, key=lambda path: (steps_of(path), path))


def steps_of(checkpoint: Path) -> int:
    """Return the agent-steps in the name of a checkpoint."""
    return int(checkpoint.stem.removeprefix("steps_"))


def runs_in(place: Path) -> list[Path]:
    """Return the folder itself, if it has checkpoints, or those in it that have some. UsageError if none has."""
    found = [place] if checkpoints(place) else sorted(path for path in place.iterdir() if checkpoints(path))
    if not found:
        raise UsageError(f"there is no checkpoint in {place} yet, nor in folders in it")
    return found


def newest(place: Path) -> Path:
    """Return the file itself, or the policy with the most steps of the run in a folder. Raises UsageError."""
    if not place.is_dir():
        return place
    found = runs_in(place)
    if len(found) > 1:
        raise UsageError(f"{place} holds {len(found)} runs: name one of them, such as {found[0]}")
    return checkpoints(found[0])[-1]


def policy_file(name: str, names: Collection[str]) -> str:
    """Return a name if it is one of `names` or a model's, else a path; for a folder that of its `newest` policy."""
    named = not name or name in names or name in models()
    return name if named or not Path(name).is_dir() else str(newest(Path(name)))


def load_saved(path: str, seed: int = 0) -> Any:
    """Return outlast.load_policy(path, seed). Raise UsageError without PyTorch, or if the policy does not exist."""
    import outlast  # imported here, as outlast imports the environments

    with needed("train", f"{path} needs {{}}", UsageError):
        return outlast.load_policy(path, seed)


def forms(scenario: Scenario) -> list[Scenario]:
    """Return every scenario that `common_scenario` may return for this one, depending on who plays."""
    if cameras_mode(scenario) != MASKED:
        return [scenario]
    return [scenario, scenario.replace(cameras_mode=REVEALED).titled_as(scenario)]


def common_scenario(scenario: Scenario, players: Sequence[Any]) -> Scenario:
    """Return the scenario with observations that all saved policies can play with. Raises UsageError.

    cameras_mode does not change what agents do or see, only what the rows of hidden entities hold. Policies by name and
    networks of presets with "masked" rows ignore those rows, so all policies can play where they are "revealed".
    """
    if players and (mode := cameras_mode(scenario)) not in (None, MASKED, REVEALED):
        raise UsageError(
            f"cameras_mode is {mode}: saved policies were trained to see what cameras see, the same in all worlds; "
            f"take {MASKED} or {REVEALED}"
        )
    fitting: list[Scenario] = [scenario, *(player.scenario(scenario) for player in players)]
    revealed = (each for each in fitting if each.numbers().get("cameras_mode") == REVEALED)
    return next(revealed, fitting[-1])


def kept_file(file: str, sha256: str, what: str) -> Path:
    """Return a file of the results, by its path there, which has this checksum. what: What errors call it.

    Raises UsageError if it cannot be fetched.
    """
    folders = [str(RESULTS)] * RESULTS.is_dir() + [HERE] * Path(HERE, file).is_file()
    address = os.environ.get(ADDRESS) or (folders[0] if folders else _published(what))
    try:
        scheme, _, path, *_ = urlsplit(address)
    except ValueError as error:
        raise UsageError(f"{what}: {ADDRESS} is {address!r}, which is not an address: {error}") from error
    if scheme in ("http", "https"):
        return _downloaded(f"{address.rstrip('/')}/{quote(file)}", file, sha256, what)
    if "://" in address and scheme != "file":
        raise UsageError(f"{what}: {ADDRESS} is {address!r}: an address of http, https or file is needed, or a folder")
    found = (Path(url2pathname(path)) if scheme == "file" else Path(address)).expanduser() / file
    try:
        content = found.read_bytes()
    except OSError as error:
        cure = f"set {ADDRESS} to a folder or an address with outlast's results"
        raise UsageError(f"{what}: {found} cannot be read ({error.strerror}): {cure}") from error
    if hashlib.sha256(content).hexdigest() != sha256:
        cure = "restore it; a policy that is named by its path plays as it is"
        raise UsageError(f"{what}: {found} is not the file that was kept, by its checksum: {cure}")
    return found


def _published(what: str) -> str:
    """Return the address of the results in the project's metadata. Raises UsageError."""
    try:
        lines: list[str] = metadata("outlast").get_all("Project-URL") or []
    except PackageNotFoundError:  # outlast was imported from a folder without being installed
        lines = []
    addresses: dict[str, str] = dict(line.split(", ", 1) for line in lines)
    if LABEL not in addresses:
        cure = f"set {ADDRESS} to a folder or an address with them, such as results of a checkout"
        raise UsageError(f"{what}: an installed outlast has no results, and no address of them: {cure}")
    return addresses[LABEL]


def _downloaded(address: str, file: str, sha256: str, what: str) -> Path:
    """Return the file in the cache, downloaded if it is not there. Raises UsageError."""
    with needed("train", f"{what} is downloaded by {{}}", UsageError):
        import pooch  # imported here: a checkout does not need it
    folder = cache_folders().writable
    if folder is None:
        raise UsageError(f"{what} has no folder to be downloaded to: name one in OUTLAST_CACHE_DIR")
    target, loader = folder / file, pooch.HTTPDownloader(timeout=SECONDS)
    pooch.get_logger().setLevel("WARNING")
    try:
        found = pooch.retrieve(address, f"sha256:{sha256}", target.name, target.parent, downloader=loader)
    except OSError as error:
        cure = f"connect to the network, or set {ADDRESS} to another address or a folder"
        reason = error.strerror or type(error).__name__  # not the objects in the error of a connection
        if (response := getattr(error, "response", None)) is not None:
            reason = f"{response.status_code} {response.reason}"
        raise UsageError(f"{what} cannot be downloaded from {address}: {reason}; {cure}") from error
    except ValueError as error:  # of pooch, about the checksum
        cure = f"nothing was kept; set {ADDRESS} to the results of this version of outlast"
        raise UsageError(f"{what}: the file at {address} is another one, by its checksum; {cure}") from error
    return Path(found)
