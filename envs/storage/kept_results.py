"""Files of results/, outside of the package: found in the checkout, or fetched, and identified by their checksums.

They come from the checkout that outlast runs from or in, or from where results are published, through pooch, which
keeps them in the cache. A variable of the environment names another place.
"""

import hashlib
import os
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from urllib.parse import quote, urlsplit
from urllib.request import url2pathname

from outlast.ecs.kernels.cache_files import cache_folders

from ..errors import UsageError, needed

RESULTS = Path(__file__).resolve().parents[2] / "results"  # of a checkout; a wheel has none
HERE = "results"  # of a checkout that is the working directory, from which outlast may have been installed
ADDRESS = "OUTLAST_RESULTS_URL"  # the variable that names another place of results
LABEL = "Results"  # of the address in the project's metadata
SECONDS = 30  # that a server may be silent


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
