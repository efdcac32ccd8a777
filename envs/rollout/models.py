"""Models: trained policies that are kept with outlast, by name. They are found beside its source, or fetched.

models.csv lists them with the checksums of their files. A file comes from results/policies of the checkout that outlast
was installed from; or from where results are published, through pooch, which keeps it in the cache.
"""

import csv
import functools
import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from types import MappingProxyType
from urllib.parse import quote, urlsplit
from urllib.request import url2pathname

from outlast.ecs.cache_folder import cache_folders

from ..errors import UsageError, install

TABLE = Path(__file__).with_name("models.csv")
RESULTS = Path(__file__).resolve().parents[2] / "results"  # of a checkout; a wheel has none
ADDRESS = "OUTLAST_RESULTS_URL"  # the variable that names another place of results
LABEL = "Results"  # of the address in the project's metadata
SECONDS = 30  # that a server may be silent


@dataclass(frozen=True)
class Model:
    """A trained policy that is kept.

    Attributes:
        name: GAME/KIND-SEED; the seed is that of its training.
        preset: The preset that it was trained with.
        steps: Agent-steps of its training.
        wins: Share of games that it wins against `scripted`, where a draw counts as half.
        size: Bytes of its file.
        sha256: Checksum of its file.
    """

    name: str
    preset: str
    steps: int
    wins: float
    size: int
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
        rows = [*csv.DictReader(file)]
    found = (
        Model(row["name"], row["preset"], int(row["steps"]), float(row["wins"]), int(row["size"]), row["sha256"])
        for row in rows
    )
    return MappingProxyType({model.name: model for model in found})


def fetched(name: str) -> Path:
    """Return the file of a model, which has the checksum of the table.

    Raises:
        UsageError: There is no such model, or its file cannot be had.
    """
    model, given = models()[name], os.environ.get(ADDRESS, "")
    address = given or (str(RESULTS) if RESULTS.is_dir() else _published())
    if urlsplit(address).scheme in ("http", "https"):
        return _downloaded(model, f"{address.rstrip('/')}/{quote(model.file)}")
    folder = Path(url2pathname(urlsplit(address).path)) if address.startswith("file:") else Path(address)
    return _checked(model, folder.expanduser() / model.file)


def _checked(model: Model, path: Path) -> Path:
    """Return the path, if that file is the model's. Raises UsageError."""
    try:
        content = path.read_bytes()
    except OSError as error:
        cure = f"set {ADDRESS} to a folder or an address with outlast's results"
        raise UsageError(f"{model.name}: {path} cannot be read ({error.strerror}): {cure}") from error
    if hashlib.sha256(content).hexdigest() != model.sha256:
        cure = "restore it, or name it by its path to play it as it is"
        raise UsageError(f"{model.name}: {path} is not the file that was kept, by its checksum: {cure}")
    return path


def _published() -> str:
    """Return the address of the results in the project's metadata. Raises UsageError."""
    try:
        lines: list[str] = metadata("outlast").get_all("Project-URL") or []
    except PackageNotFoundError:  # outlast was imported from a folder without being installed
        lines = []
    addresses: dict[str, str] = dict(line.split(", ", 1) for line in lines)
    if LABEL not in addresses:
        cure = f"set {ADDRESS} to a folder or an address with them, such as results of a checkout"
        raise UsageError(f"models are not part of an installed outlast, which knows no address of its results: {cure}")
    return addresses[LABEL]


def _downloaded(model: Model, address: str) -> Path:
    """Return the file in the cache, downloaded if it is not there. Raises UsageError."""
    try:
        import pooch  # imported here, as a checkout needs none
    except ModuleNotFoundError as error:
        raise UsageError(f"{model.name} is downloaded by {error.name}: {install('models')}") from error
    folder = cache_folders().writable
    if folder is None:
        raise UsageError(f"{model.name} has no folder to be downloaded to: name one in OUTLAST_CACHE_DIR")
    target, loader = folder / model.file, pooch.HTTPDownloader(timeout=SECONDS)
    pooch.get_logger().setLevel("WARNING")
    try:
        found = pooch.retrieve(address, f"sha256:{model.sha256}", target.name, target.parent, downloader=loader)
    except OSError as error:
        cure = f"connect to the network, or set {ADDRESS} to another address or a folder"
        raise UsageError(f"{model.name} cannot be downloaded from {address}: {_reason(error)}; {cure}") from error
    except ValueError as error:  # of pooch, about the checksum
        cure = f"nothing was kept; set {ADDRESS} to the results of this version of outlast"
        raise UsageError(f"{model.name}: what is at {address} is another file, by its checksum; {cure}") from error
    return Path(found)


def _reason(error: OSError) -> str:
    """Return the first line of an error of a connection, without the objects in it."""
    response = getattr(error, "response", None)
    if response is not None:
        return f"{response.status_code} {response.reason}"
    return type(error).__name__ if not error.strerror else error.strerror
