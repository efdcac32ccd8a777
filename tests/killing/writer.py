"""What a test of crash safety needs of a command that writes files."""

from collections.abc import Callable
from pathlib import Path

from outlast.envs.storage.atomic_write import is_temporary

NOTHING, COMPLETE = "nothing", "complete"  # what may be left


class Writer:
    """A command that writes into a folder.

    slow: it runs for long, and is killed a tenth as often. keeps_existing: it does not overwrite a complete output.
    """

    name = ""
    slow = keeps_existing = False

    def prepare(self, folder: Path) -> None:
        """Set up an empty folder for the first run."""

    def command(self, folder: Path, resume: bool = False) -> list[str]:
        """A module and its arguments. resume: to go on from what is there."""
        raise NotImplementedError

    def environment(self, folder: Path) -> dict[str, str]:
        """Additional environment variables."""
        return {}

    def check(self, folder: Path, reference: Path) -> str:
        """What a killed run left, in a word or two; AssertionError if that is wrong.

        reference: the folder of an uninterrupted run.
        """
        raise NotImplementedError

    def check_resumed(self, folder: Path, reference: Path) -> None:
        """AssertionError unless the resumed run ended as the uninterrupted one."""
        raise NotImplementedError


def temporary_files(folder: Path) -> list[Path]:
    """The temporary files in a folder, at any depth."""
    return [path for path in folder.rglob("*") if is_temporary(path)]


def visible(folder: Path) -> list[Path]:
    """Everything in a folder but temporary files, sorted by name."""
    return sorted(path for path in folder.iterdir() if not is_temporary(path))


class AtomicOutput(Writer):
    """A command whose product is complete or absent. equal: (product, expected) -> None; raises AssertionError."""

    def __init__(self, name: str, product: str, command: tuple[str, ...], equal: Callable[[Path, Path], None]) -> None:
        self.name, self.product, self.arguments, self.equal = name, product, command, equal

    def command(self, folder: Path, resume: bool = False) -> list[str]:
        return [word.format(out=folder / self.product, folder=folder) for word in self.arguments]

    def check(self, folder: Path, reference: Path) -> str:
        assert {path.name for path in visible(folder)} <= {path.name for path in visible(reference)}
        if not (folder / self.product).exists():
            return NOTHING
        self.equal(folder / self.product, reference / self.product)
        return COMPLETE

    def check_resumed(self, folder: Path, reference: Path) -> None:
        self.equal(folder / self.product, reference / self.product)


def same_bytes(path: Path, expected: Path) -> None:
    assert path.read_bytes() == expected.read_bytes(), path.name
