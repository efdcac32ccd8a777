"""Writers of training runs, figures and evaluations; what each may leave when it is killed."""

import csv
import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.killing.writer import NOTHING, Writer, same_bytes, temporary_files, visible

QUICK = ("--set", "safe_zone_damage=50", "--set", "safe_zone_stand=10", "--set", "safe_zone_shrink=5")


class Train(Writer):
    """outlast train, which goes on with --resume."""

    name = "train"

    def command(self, folder: Path, resume: bool = False) -> list[str]:
        numbers = ("--worlds", "8", "--rollout", "192", "--steps", "9600", "--every", "1536", "--threads", "1")
        command = ["outlast", "train", "ffa_1", *numbers, "--set", "agents_health=10", "--set", "safe_zone_stand=10"]
        command += ["--quiet", "--ppo", "n_epochs=2", "--ppo", "batch_size=64", "--out", str(folder / "run")]
        begun = resume and (folder / "run").is_dir() and visible(folder / "run")
        return [*command, "--resume"] if begun else command

    def check(self, folder: Path, reference: Path) -> str:
        from outlast.training.base.log_file import read_log
        from outlast.training.policies import checkpoint

        run = folder / "run"
        if not run.is_dir() or not visible(run):
            return NOTHING
        about = json.loads((run / "run.json").read_text())
        assert about == json.loads((reference / "run" / "run.json").read_text())
        saved = sorted(run.glob("steps_*.zip"))
        steps = [checkpoint.header_of(checkpoint.read_checkpoint(path))["steps"] for path in saved]
        text = (run / "log.csv").read_text() if (run / "log.csv").exists() else ""
        if text:
            points, expected = (untimed(read_log(each / "log.csv")) for each in (run, reference / "run"))
            assert all(rows == expected[tag][: len(rows)] for tag, rows in points.items())
            logged = max((rows[-1][0] for rows in points.values()), default=0)
            assert logged >= max(steps, default=0), "a checkpoint is ahead of the log"
        return f"{len(saved)} checkpoints" if len(saved) != 1 else "1 checkpoint"

    def check_resumed(self, folder: Path, reference: Path) -> None:
        from outlast.envs.rollout.saved import newest
        from outlast.training.base.log_file import read_log
        from outlast.training.base.run_header import WEIGHTS
        from outlast.training.policies import checkpoint

        one, other = (untimed(read_log(directory / "run" / "log.csv")) for directory in (folder, reference))
        assert one == other, "the logs differ"
        assert scalars(folder / "run") == one, "TensorBoard shows something else than log.csv"
        assert not temporary_files(folder)
        last = [checkpoint.read_checkpoint(newest(directory / "run"))[WEIGHTS] for directory in (folder, reference)]
        assert last[0] == last[1], "the policies differ"


def untimed(points: dict[str, Any]) -> dict[str, Any]:
    """The scalars of a log without those that measure time."""
    return {tag: rows for tag, rows in points.items() if not tag.startswith("time/")}


def scalars(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """What TensorBoard shows of a run, with float64 values of log.csv in the place of its float32."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from outlast.training.base.log_file import read_log

    logging.getLogger("tensorboard").setLevel(logging.ERROR)  # it warns of each restart
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
    exact = read_log(folder / "log.csv")
    shown = {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}
    rounded = {tag: [(step, float(np.float32(value))) for step, value in rows] for tag, rows in exact.items()}
    return untimed({tag: exact[tag] if rows == rounded[tag] else rows for tag, rows in shown.items()})


class Tables(Writer):
    """A command that writes several files into a folder, each complete or absent."""

    def __init__(self, name: str, command: tuple[str, ...], check_file: Callable[[Path, Path], None]) -> None:
        self.name, self.arguments, self.check_file = name, command, check_file

    def command(self, folder: Path, resume: bool = False) -> list[str]:
        return [word.format(out=folder / "out", folder=folder) for word in self.arguments]

    def check(self, folder: Path, reference: Path) -> str:
        files = visible(folder / "out") if (folder / "out").is_dir() else []
        for path in files:
            self.check_file(path, reference / "out" / path.name)
        return f"{len(files)} files" if files else NOTHING

    def check_resumed(self, folder: Path, reference: Path) -> None:
        names = [path.name for path in visible(reference / "out")]
        assert [path.name for path in visible(folder / "out")] == names
        for name in names:
            same_bytes(folder / "out" / name, reference / "out" / name)


class Plot(Tables):
    """outlast plot, of the paper's own curves."""

    def __init__(self) -> None:
        super().__init__("plot", ("outlast", "plot", "{folder}/runs", "--out", "{out}"), same_bytes)

    def prepare(self, folder: Path) -> None:
        from tests.training.test_plot import keep

        (folder / "runs").mkdir()
        for name, seed in (("ffa_2", 0), ("ffa_2", 1), ("teams_3", 0)):
            keep(folder / "runs", name, seed)


def part_of(path: Path, expected: Path) -> None:
    """A file of an evaluation that was interrupted: its prefix of the pairings must be right."""
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
    """A file of a completed evaluation, or one that does not depend on how far it came."""
    if path.suffix == ".webm":
        from outlast.envs.rendering.video.codecs import read_video

        assert read_video(path) == read_video(expected)
    elif path.name != "ratings.csv":  # which depends on how much was played
        same_bytes(path, expected)


class Evaluate(Tables):
    """outlast evaluate."""

    def __init__(self, *more: str) -> None:
        command = ("outlast", "evaluate", "ffa_1", "scripted", "noop", *QUICK, "--worlds", "8", "--episodes", "64")
        super().__init__(" ".join(("evaluate", *more)), (*command, *more, "--quiet", "--out", "{out}"), part_of)

    def check_resumed(self, folder: Path, reference: Path) -> None:
        names = [path.name for path in visible(reference / "out")]
        assert [path.name for path in visible(folder / "out")] == names
        for name in names:
            complete(folder / "out" / name, reference / "out" / name)
        same_bytes(folder / "out" / "ratings.csv", reference / "out" / "ratings.csv")


WRITERS: list[Writer] = [Train(), Plot(), Evaluate(), Evaluate("--film")]
