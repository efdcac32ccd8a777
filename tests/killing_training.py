"""What `killing` kills: training, and what is made of it; and what each may leave."""

import csv
import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.killing import NOTHING, Writer, drafts, visible
from tests.killing_films import same_bytes

SETS = ("safe_zone_damage=50", "safe_zone_stand=10", "safe_zone_shrink=5")
QUICK = tuple(word for number in SETS for word in ("--set", number))


class Train(Writer):
    """outlast train, which goes on with --resume."""

    name = "train"
    sets = ("agents_health=10", "safe_zone_radii=(9.0,)", "safe_zone_stand=10", "safe_zone_shrink=10")

    def words(self, place: Path, again: bool = False) -> list[str]:
        numbers = ("--worlds", "8", "--rollout", "192", "--steps", "9600", "--every", "1536", "--threads", "1")
        words = [
            "outlast",
            "train",
            "ffa_1",
            *numbers,
            "--set",
            "agents_health=10",
            "--set",
            "safe_zone_stand=10",
            "--quiet",
        ]
        words += ["--ppo", "n_epochs=2", "--ppo", "batch_size=64", "--out", str(place / "run")]
        begun = again and (place / "run").is_dir() and visible(place / "run")
        return [*words, "--resume"] if begun else words

    def check(self, place: Path, whole: Path) -> str:
        from outlast.training import checkpoint, curves

        run = place / "run"
        if not run.is_dir() or not visible(run):
            return NOTHING
        about = json.loads((run / "run.json").read_text())
        assert about == json.loads((whole / "run" / "run.json").read_text())
        saved = sorted(run.glob("steps_*.zip"))
        steps = [checkpoint.about(checkpoint.read(path))["steps"] for path in saved]
        text = (run / "log.csv").read_text() if (run / "log.csv").exists() else ""
        if text:
            points, expected = untimed(curves.read(run / "log.csv")), untimed(curves.read(whole / "run" / "log.csv"))
            assert all(rows == expected[tag][: len(rows)] for tag, rows in points.items())
            logged = max((rows[-1][0] for rows in points.values()), default=0)
            assert logged >= max(steps, default=0), "a checkpoint is ahead of the log"
        return f"{len(saved)} checkpoints" if len(saved) != 1 else "1 checkpoint"

    def same(self, place: Path, whole: Path) -> None:
        from outlast.training import checkpoint, curves

        one, other = (untimed(curves.read(folder / "run" / "log.csv")) for folder in (place, whole))
        assert one == other, "the logs differ"
        assert scalars(place / "run") == one, "TensorBoard shows something else than log.csv"
        assert not drafts(place)
        last = [checkpoint.read(checkpoint.newest(folder / "run"))["policy.pt"] for folder in (place, whole)]
        assert last[0] == last[1], "the policies differ"


def untimed(points: dict[str, Any]) -> dict[str, Any]:
    """Of what a log says, that which is the same each time."""
    return {tag: rows for tag, rows in points.items() if not tag.startswith("time/")}


def scalars(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """What TensorBoard shows of a run, with the doubles of its log in place of its floats."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from outlast.training import curves

    logging.getLogger("tensorboard").setLevel(logging.ERROR)  # it tells of each restart
    events, exact = (
        EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload(),
        curves.read(folder / "log.csv"),
    )
    shown = {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}
    rounded = {tag: [(step, float(np.float32(value))) for step, value in rows] for tag, rows in exact.items()}
    return untimed({tag: exact[tag] if rows == rounded[tag] else rows for tag, rows in shown.items()})


class Tables(Writer):
    """A command that writes several files into a folder, each whole or not there."""

    def __init__(self, name: str, words: tuple[str, ...], alike: Callable[[Path, Path], None]) -> None:
        self.name, self.arguments, self.alike = name, words, alike

    def words(self, place: Path, again: bool = False) -> list[str]:
        return [word.format(out=place / "out", place=place) for word in self.arguments]

    def check(self, place: Path, whole: Path) -> str:
        files = visible(place / "out") if (place / "out").is_dir() else []
        for path in files:
            self.alike(path, whole / "out" / path.name)
        return f"{len(files)} files" if files else NOTHING

    def same(self, place: Path, whole: Path) -> None:
        names = [path.name for path in visible(whole / "out")]
        assert [path.name for path in visible(place / "out")] == names
        for name in names:
            same_bytes(place / "out" / name, whole / "out" / name)


class Plot(Tables):
    """outlast plot, of the paper's own curves."""

    def __init__(self) -> None:
        super().__init__("plot", ("outlast", "plot", "{place}/runs", "--out", "{out}"), same_bytes)

    def prepare(self, place: Path) -> None:
        from tests.training.test_training_plot import keep

        (place / "runs").mkdir()
        for name, seed in (("ffa_2", 0), ("ffa_2", 1), ("teams_3", 0)):
            keep(place / "runs", name, seed)


def part_of(path: Path, expected: Path) -> None:
    """A table, film or page of an evaluation that may not be complete."""
    if path.suffix == ".json":
        one, other = (json.loads(file.read_text()) for file in (path, expected))
        assert all(pairing in other["pairings"] for pairing in one["pairings"]), "another pairing"
        assert one["complete"] == (len(one["pairings"]) == len(other["pairings"])), "it does not say what is complete"
    elif path.name == "figures.csv":
        rows, known = (list(csv.reader(file.read_text().splitlines())) for file in (path, expected))
        assert [row for row in rows if row not in known] == [], "other figures"
    else:
        complete(path, expected)


def complete(path: Path, expected: Path) -> None:
    """The same as if nobody had killed it."""
    if path.suffix == ".webm":
        from outlast.envs.rendering.video.codecs import read_video

        assert read_video(path) == read_video(expected)
    elif path.name != "ratings.csv":  # of which there is more, the more is played
        same_bytes(path, expected)


class Evaluate(Tables):
    """outlast evaluate."""

    def __init__(self, *more: str) -> None:
        words = ("outlast", "evaluate", "ffa_1", "scripted", "noop", *QUICK, "--worlds", "8", "--episodes", "64")
        super().__init__(" ".join(("evaluate", *more)), (*words, *more, "--quiet", "--out", "{out}"), part_of)

    def same(self, place: Path, whole: Path) -> None:
        names = [path.name for path in visible(whole / "out")]
        assert [path.name for path in visible(place / "out")] == names
        for name in names:
            complete(place / "out" / name, whole / "out" / name)
        same_bytes(place / "out" / "ratings.csv", whole / "out" / "ratings.csv")


WRITERS: list[Writer] = [Train(), Plot(), Evaluate(), Evaluate("--film")]
