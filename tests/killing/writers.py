"""The commands that are stopped by tests/robustness/test_killing.py, and what each may leave."""

import contextlib
import csv
import json
import logging
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from outlast import make_vec, record
from outlast.envs.recording import Recording
from outlast.envs.snapshots.state import State
from tests.killing.harness import Comparison, Writer, same_bytes, temporary_files, visible


def same_files(path: Path, expected: Path, equal: Comparison = same_bytes) -> None:
    """The same files in a folder."""
    assert [file.name for file in visible(path)] == [file.name for file in visible(expected)]
    some_files(path, expected, equal)


def some_files(path: Path, expected: Path, equal: Comparison = same_bytes) -> None:
    """Some of the files of a folder, each of them complete."""
    for file in visible(path):
        equal(file, expected / file.name)


# ---- recordings and what is made of them


def whole_recording(path: Path, expected: Path) -> None:
    assert not Recording.open(path).cut
    assert len(Recording.open(path)) == len(Recording.open(expected))


def prefix(path: Path, expected: Path) -> None:
    """A recording is appended to: a killed run leaves its first ticks."""
    found, other = Recording.open(path), Recording.open(expected)
    assert len(found), "a file without ticks"
    assert bool(found.cut) == (len(found) < len(other)) or "end is missing" in found.cut
    for one, two in zip(found.tick_records(), other.tick_records(), strict=False):
        for name in ("mode", "codes", "keys", "digest"):
            assert np.array_equal(getattr(one, name), getattr(two, name)), name


def prepare_recording(folder: Path) -> None:
    (folder / "minari").mkdir()
    with contextlib.closing(make_vec("teams_3", 32, seed=5)) as env, record(env, folder / "a.rec"):
        rng = np.random.default_rng(0)
        env.reset()
        for _ in range(150):
            env.step(rng.integers(0, env.action_sizes, (32, 4, len(env.action_sizes))))


def same_parquet(path: Path, expected: Path) -> None:
    import pyarrow.parquet as pq

    assert pq.read_table(path).equals(pq.read_table(expected))


def same_shard(path: Path, expected: Path) -> None:
    if path.suffix == ".json":
        return same_bytes(path, expected)
    one, other = np.load(path), np.load(expected)
    assert one.files == other.files
    assert all(np.array_equal(one[key], other[key]) for key in one.files)


def same_shards(path: Path, expected: Path) -> None:
    assert not temporary_files(path)
    same_files(path, expected, same_shard)


def same_minari(path: Path, expected: Path) -> None:
    from minari.dataset.minari_dataset import MinariDataset

    one, other = (MinariDataset(folder / "data") for folder in (path, expected))
    assert (one.total_episodes, one.total_steps) == (other.total_episodes, other.total_steps)
    assert len(list(one.iterate_episodes())) == len(list(other.iterate_episodes()))


def replayed(name: str, product: str, option: str, whole: Comparison, **more: Any) -> Writer:
    """outlast replay, of a recording that is made first. Datasets are not overwritten."""
    command = f"outlast replay {{folder}}/a.rec {option} --quiet"
    variables = {"MINARI_DATASETS_PATH": "{folder}/minari"}
    given: dict[str, Any] = {"prepare": prepare_recording, "keeps": True, "variables": variables}
    return Writer(f"replay {name}", command, product, whole, **(given | more))


# ---- films


SHAPE = (198, 128)  # of a frame: a square, and the scoreboard of two agents
FRAMES = "outlast frames ffa_1 --steps 60 --size 128 --quiet --out {out}"


def same_film(path: Path, expected: Path) -> None:
    from outlast.envs.rendering.films import CODECS

    codec = CODECS[path.suffix]
    assert codec.read(path) == codec.read(expected) == [(*SHAPE, 3)] * 61


def prepare_pictures(folder: Path) -> None:
    import cv2

    (folder / "film").mkdir()
    for k in range(70):
        cv2.imwrite(str(folder / "film" / f"frame_{k:06}.png"), np.zeros((*SHAPE, 3), np.uint8))


def one_of_two_films(path: Path, expected: Path) -> None:
    """Pictures of an earlier film, which go first, or of the new one."""
    import cv2

    pictures = visible(path)
    assert all(np.shape(cv2.imread(str(file))) == (*SHAPE, 3) for file in pictures)
    assert [file.name for file in pictures] == [f"frame_{k:06}.png" for k in range(len(pictures))]
    old = sum(not cv2.imread(str(file)).any() for file in pictures)
    assert old in (0, len(pictures)), "some pictures of each film"


# ---- states and compiled code


def state_that_can_be_set(path: Path, expected: Path) -> None:
    state = State.load(path)
    with contextlib.closing(make_vec("ffa_1", 64, seed=1)) as env:
        env.set_state(state)


def save_states(path: Path) -> None:
    """The command of "State.save": again and again into one file."""
    env, rng = make_vec("ffa_1", 64, seed=1), np.random.default_rng(0)
    env.reset()
    for _ in range(300):
        env.step(rng.integers(0, env.action_sizes, (64, 2, len(env.action_sizes))))
        env.get_state().save(path)
    env.close()


def same_units(path: Path, expected: Path) -> None:
    names = [{file.name for file in folder.rglob("*.unit")} for folder in (path, expected)]
    assert names[0] == names[1] != set()


# ---- training and evaluation


def untimed(points: dict[str, Any]) -> dict[str, Any]:
    """The scalars of a log without those that measure time."""
    return {tag: rows for tag, rows in points.items() if not tag.startswith("time/")}


def scalars(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """What TensorBoard shows of a run, with float64 values of log.csv in the place of its float32."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from outlast.training.base.curves import read_log

    logging.getLogger("tensorboard").setLevel(logging.ERROR)  # it warns of each restart
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
    exact = read_log(folder / "log.csv")
    shown = {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}
    rounded = {tag: [(step, float(np.float32(value))) for step, value in rows] for tag, rows in exact.items()}
    return untimed({tag: exact[tag] if rows == rounded[tag] else rows for tag, rows in shown.items()})


def beginning_of_a_run(run: Path, expected: Path) -> None:
    """Checkpoints of the run, none of them ahead of the log."""
    from outlast.training.base.curves import read_log
    from outlast.training.policies import checkpoint

    if not visible(run):
        return
    assert json.loads((run / "run.json").read_text()) == json.loads((expected / "run.json").read_text())
    saved = [checkpoint.read_checkpoint(path) for path in run.glob("steps_*.zip")]
    steps = [checkpoint.header_of(files)["steps"] for files in saved]
    if (run / "log.csv").exists() and (run / "log.csv").read_text():
        points, known = (untimed(read_log(each / "log.csv")) for each in (run, expected))
        assert all(rows == known[tag][: len(rows)] for tag, rows in points.items())
        logged = max((rows[-1][0] for rows in points.values()), default=0)
        assert logged >= max(steps, default=0), "a checkpoint is ahead of the log"


def whole_run(run: Path, expected: Path) -> None:
    from outlast.envs.rollout.saved import newest
    from outlast.training.base.curves import read_log
    from outlast.training.base.policy_file import WEIGHTS
    from outlast.training.policies import checkpoint

    one, other = (untimed(read_log(folder / "log.csv")) for folder in (run, expected))
    assert one == other, "the logs differ"
    assert scalars(run) == one, "TensorBoard shows something else than log.csv"
    assert not temporary_files(run)
    last = [checkpoint.read_checkpoint(newest(folder))[WEIGHTS] for folder in (run, expected)]
    assert last[0] == last[1], "the policies differ"


def prepare_runs(folder: Path) -> None:
    from tests.training.test_plot import keep

    (folder / "runs").mkdir()
    for name, seed in (("ffa_2", 0), ("ffa_2", 1), ("teams_3", 0)):
        keep(folder / "runs", name, seed)


def whole_table(path: Path, expected: Path) -> None:
    if path.suffix == ".webm":
        from outlast.envs.rendering.films import read_video

        assert read_video(path) == read_video(expected)
    else:
        same_bytes(path, expected)


def part_of_a_table(path: Path, expected: Path) -> None:
    """A file of an evaluation that was interrupted: its prefix of the pairings must be right."""
    if path.suffix == ".json":
        one, other = (json.loads(file.read_text()) for file in (path, expected))
        assert all(pairing in other["pairings"] for pairing in one["pairings"]), "another pairing"
        assert one["complete"] == (len(one["pairings"]) == len(other["pairings"])), "it does not say what is complete"
    elif path.name == "figures.csv":
        rows, known = (list(csv.reader(file.read_text().splitlines())) for file in (path, expected))
        assert [row for row in rows if row not in known] == [], "other figures"
    elif path.name != "ratings.csv":  # which depends on how much was played
        whole_table(path, expected)


TRAIN = (
    "outlast train ffa_1 --worlds 8 --rollout 192 --steps 9600 --every 1536 --threads 1 --set agents_health=10 "
    "--set safe_zone_stand=10 --quiet --ppo n_epochs=2 --ppo batch_size=64 --out {out}"
)
EVALUATE = (
    "outlast evaluate ffa_1 scripted noop --set safe_zone_damage=50 --set safe_zone_stand=10 --set safe_zone_shrink=5 "
    "--worlds 8 --episodes 64 --quiet --out {out}"
)
TABLES: dict[str, Any] = {"product": "out", "whole": partial(same_files, equal=whole_table), "needs": ("torch",)}
TABLES |= {"part": partial(some_files, equal=part_of_a_table)}
ROLLOUT = "outlast rollout ffa_1 --worlds 512 --steps 1500 --record {out} --quiet"
COMPILE = "outlast rollout ffa_1 --worlds 2 --steps 3 --quiet"
WRITERS = [
    Writer("rollout --record", ROLLOUT, "a.rec", whole_recording, prefix, keeps=True),
    *(Writer(f"frames {suffix}", FRAMES, f"film{suffix}", same_film) for suffix in (".webm", ".apng")),
    *(
        Writer(f"frames {each}", FRAMES, f"film{each}", same_film, needs=("imageio_ffmpeg",))
        for each in (".mp4", ".gif")
    ),
    Writer("frames folder", FRAMES, "film", same_files),
    Writer("frames over frames", FRAMES, "film", same_files, one_of_two_films, prepare_pictures),
    Writer("State.save", "tests.killing.writers {out}", "state.npz", same_bytes, state_that_can_be_set),
    Writer(
        *("compiled tick", COMPILE, "cache", same_units, lambda path, expected: None),
        variables={"OUTLAST_CACHE_DIR": "{out}"},
    ),
    replayed("samples.parquet", "data.parquet", "--data {out}", same_parquet, needs=("pyarrow",)),
    replayed("shards", "data", "--data {out}", same_shards),
    replayed("page", "page.html", "--html {out} --worlds 0,1,2", same_bytes, keeps=False),
    replayed("minari", "minari/duel-v0", "--data minari:duel-v0 --worlds 0,1", same_minari, needs=("minari",)),
    Writer("train", TRAIN, "run", whole_run, beginning_of_a_run, resume="--resume", needs=("torch", "tensorboard")),
    Writer(
        *("plot", "outlast plot {folder}/runs --out {out}", "out", same_files, some_files, prepare_runs),
        needs=("torch", "matplotlib"),
    ),
    Writer("evaluate", EVALUATE, **TABLES),
    Writer("evaluate --film", f"{EVALUATE} --film", **TABLES),
]

if __name__ == "__main__":
    save_states(Path(sys.argv[1]))
