"""The progress of a run: a bar and a few lines of figures below it, or an occasional line in a log."""

from collections.abc import Mapping, Sequence
from typing import TextIO

from outlast.envs.progress import Progress

from ..base.quantities import GROUPS, Figure, headline

NAME = max(map(len, GROUPS)) + 2  # width of the name of a line, in characters
BETWEEN = " · "  # separator of figures


class LiveView(Progress):
    """The progress of a run with its figures, in a line for each group of them (see `headline`).

    Lines are shortened to the terminal's width. Numbers that are missing in an update keep their values.

    >>> view = LiveView(done=0, total=10_000_000)
    >>> view.now("collecting")
    >>> view.update(16_384, 10_000_000, {"rollout/steps": 812.0, "wins/scripted": 0.12})
    >>> view.close()
    """

    def __init__(
        self,
        done: int,
        total: int,
        *,
        quiet: bool = False,
        file: TextIO | None = None,
        about: str = "",
        unit: str = "agent-steps",
    ) -> None:
        """Show the beginning of the run, with `done` of `total` agent-steps, or of another unit; see Progress."""
        self.tags = dict[str, float]()
        super().__init__(total, unit, done=done, quiet=quiet, file=file, about=about)

    def update(self, done: int, total: int, shown: Mapping[str, float]) -> None:
        """Show the progress of the run, and its numbers.

        done: Agent-steps done, including earlier ones. total: Agent-steps at the end. shown: Values by tag, as they are
        logged; may include tags that are never shown.
        """
        self.tags |= shown
        self.show(done, total)
        if self.bar is not None:
            self.bar.refresh()

    def below(self, columns: int) -> list[str]:
        """Return the line of each group of figures, of at most `columns` characters."""
        return [fitted(name, figures, columns) for name, figures in self._groups()]

    def beside(self) -> list[str]:
        """Return the figures of each group, for the line of a log."""
        return [f"{name}: {', '.join(f'{each.name} {each.text}' for each in own)}" for name, own in self._groups()]

    def _groups(self) -> list[tuple[str, list[Figure]]]:
        figures = headline(self.tags)
        groups = [(group, [figure for figure in figures if figure.group == group]) for group in GROUPS]
        return [(name, members) for name, members in groups if members]


def fitted(name: str, figures: Sequence[Figure], width: int) -> str:
    """Return a line of the figures that fit into `width` characters, at least a part of the first one."""
    text = name.ljust(NAME)
    for k, figure in enumerate(figures):
        more = f"{BETWEEN if k else ''}{figure.name} {figure.text}"
        if k and len(text) + len(more) > width:
            break
        text += more
    return text[: max(0, width)]
