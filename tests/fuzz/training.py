"""Fuzz targets: checkpoints that runs resume from, saved policies, logs and kept results."""

import dataclasses
import json
import lzma
import shutil
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

import outlast
from outlast.envs.errors import FaultError, StateError
from outlast.envs.rollout.saved import CHECKPOINT
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.training.base import policy_file
from outlast.training.base.config import TrainingConfig
from outlast.training.base.curves import FILE, format_curves
from outlast.training.base.errors import TrainingError
from outlast.training.base.files import unpacked
from outlast.training.base.policy_file import WEIGHTS
from outlast.training.base.presets import preset
from outlast.training.policies import checkpoint
from outlast.training.policies.player import Player
from outlast.training.ppo.trainer import Trainer, capture, restore
from outlast.training.research import compare, figures, results
from outlast.training.runs.run import TrainingRun
from tests.fuzz.mutations import Random, mutated, mutated_json, mutated_npy, mutated_zip, to_json, unzipped, zipped
from tests.fuzz.worlds import folder_of

SMALL = outlast.variant("teams_3").replace(n_heals=2, n_boxes=2)
SETTINGS = {"batch_size": 16, "n_epochs": 1, "scale_rewards": True}
POOL: dict[str, Any] = {"opponents": {"self": 0.5, "past": 0.5}, "snapshots": 1}
CONFIG = TrainingConfig(SMALL, "paper", worlds=2, rollout=16, threads=1, settings=SETTINGS, **POOL)


def mutated_checkpoint(content: bytes, rng: Random) -> bytes:
    """A mutated checkpoint: the archive itself, or one of the files in it."""
    files = unzipped(content)
    match rng.randrange(10):
        case 0:
            return mutated(content, rng)
        case 1:
            return mutated_zip(content, rng)
        case 2 | 3 | 4:
            files["run.json"] = to_json(mutated_json(json.loads(files["run.json"]), rng))
        case 5 | 6 | 7 | 8:
            name = rng.choice((WEIGHTS, checkpoint.REST))
            files[name] = rng.choice((mutated, mutated_header, mutated_header, mutated_header))(files[name], rng)
        case _:
            inner = unzipped(files["worlds.npz"])
            part = rng.choice([*inner])
            files["worlds.npz"] = zipped(inner | {part: mutated_npy(inner[part], rng)})
    return zipped(files)


def mutated_header(content: bytes, rng: Random) -> bytes:
    """Tensors with another header: other types, sizes and names, larger than the file, or another text beside them."""
    size = int.from_bytes(content[:8], "little")
    header, numbers = json.loads(content[8 : 8 + size]), content[8 + size :]
    name, other = (rng.choice([key for key in header if key != "__metadata__"]) for _ in range(2))
    about = header["__metadata__"]
    match rng.randrange(6):
        case 0:
            header = mutated_json(header, rng)
        case 1:
            header[name] = mutated_json(header[name], rng)
        case 2:
            header[name]["dtype"] = rng.choice(("F16", "BF16", "F64", "I32", "I64", "U8", "U32", "BOOL", "C64", "F4"))
        case 3:
            header[name], header[other] = header[other], header[name]
        case 4 if about[policy_file.ENTRY]:
            text = to_json(mutated_json(json.loads(about[policy_file.ENTRY]), rng)).decode()
            about[policy_file.ENTRY] = rng.choice((text, text, text, text[:-1]))
        case _:
            header[rng.choice((f"{name}/x", name[:-1], f"1{name}", "\x1b[31m", "9" * 5000))] = header.pop(name)
    changed = to_json(header)
    return len(changed).to_bytes(8, "little") + changed + numbers


class _Checkpoints:
    """Hostile checkpoints."""

    files: list[bytes]

    def mutate(self, rng: Random) -> bytes:
        """A hostile checkpoint."""
        return mutated_checkpoint(rng.choice(self.files), rng)


class Checkpoints(_Checkpoints):
    """Checkpoints that a run resumes from, for one rollout and one update."""

    refusals: ClassVar = (StateError, TrainingError)

    def __init__(self) -> None:
        torch.set_num_threads(1)
        self.folder = folder_of(self)
        self.trainer = Trainer(CONFIG)
        first = capture(self.trainer, CONFIG.header())
        self._go_on()
        self.files = [zipped(files) for files in (first, capture(self.trainer, CONFIG.header()))]
        self.valid = self.files[1]

    def use(self, path: Path) -> None:
        """Resume from it; sometimes as `outlast train --resume` does."""
        if path.stat().st_size % 32:
            restore(self.trainer, checkpoint.read_checkpoint(path))
            self._go_on()
            return
        run = self.folder / "run"
        shutil.rmtree(run, ignore_errors=True)
        run.mkdir()
        shutil.copy(path, run / CHECKPOINT.format(1))
        TrainingRun(dataclasses.replace(CONFIG, steps=1), run, resume=True).log.close()

    def _go_on(self) -> None:
        try:
            rollout = self.trainer.collect()
        except FaultError:  # positions that physics refuses
            return
        self.trainer.update(rollout)


class Policies(_Checkpoints):
    """Saved policies, which compute actions."""

    refusals: ClassVar = (TrainingError,)

    def __init__(self) -> None:
        torch.set_num_threads(1)
        trainers = [Trainer(dataclasses.replace(CONFIG, preset=name)) for name in ("original", "scaled")]
        self.files = [zipped(capture(trainer, CONFIG.header())) for trainer in trainers]
        self.valid = self.files[0]

    def use(self, path: Path) -> None:
        """Compute actions for observations of the shapes that the file declares."""
        player, rng = Player(path), np.random.default_rng(0)
        observations = {key: rng.random((2, 3, *shape)).astype(np.float32) for key, shape in player.shapes.items()}
        observations |= {key: np.rint(values) for key, values in observations.items() if key.endswith("_mask")}
        actions = player(observations)
        sizes = np.array(player.header["actions"])
        assert actions.shape == (2, 3, len(sizes))
        assert ((actions >= 0) & (actions < sizes)).all()
        str(player.scenario(SMALL))


class Results:
    """Logs and run.json of runs, and kept results: made into tables and figures."""

    refusals: ClassVar = (TrainingError,)

    def __init__(self) -> None:
        self.folder = folder_of(self)
        rows = [f"{tag},{step},{step * k / 7}\n" for step in range(9, 400, 9) for k, tag in enumerate(TAGS)]
        self.log = ("tag,step,value\n" + "".join(rows)).encode()
        header = {"version": 1, "scenario": fingerprint(preset("paper").scenario(outlast.variant("teams_3")))}
        self.header = json.dumps(header | CONFIG.header()).encode()
        (self.folder / "log.csv").write_bytes(self.log)
        (self.folder / "run.json").write_bytes(self.header)
        (found,) = results.load_runs([self.folder])
        self.valid = unpacked(format_curves({found.name: (found.about, found.curves)})).encode()

    def mutate(self, rng: Random) -> bytes:
        """A hostile log, kept result or run.json."""
        match rng.randrange(5):
            case 0:
                return rng.choice((mutated, _changed_cell))(self.log, rng)
            case 1:
                whole = to_json(mutated_json(json.loads(self.header), rng))
                return rng.choice((whole, whole, mutated(self.header, rng), self.header))
            case 2:
                first, _, rest = self.valid.partition(b"\n")
                return b"# " + to_json(mutated_json(json.loads(first[2:]), rng)) + b"\n" + rest
            case _:
                return rng.choice((mutated, _changed_cell))(self.valid, rng)

    def use(self, path: Path) -> None:
        """Make a table, and sometimes figures."""
        content = path.read_bytes()
        source, first = self.folder, content[:1]
        if first in (b"t", b"{"):
            (source / "log.csv").write_bytes(content if first == b"t" else self.log)
            (source / "run.json").write_bytes(content if first == b"{" else self.header)
        else:
            source = self.folder / "kept"
            source.mkdir(exist_ok=True)
            (source / FILE).write_bytes(lzma.compress(content, preset=0))
        (group,) = results.group_runs(results.load_runs([source]))
        for name in (group.name, group.runs[0].name):
            assert Path(name).name == name, f"{name} would be written elsewhere"
        for run in group.runs:
            format_curves({run.name: (run.about, run.curves)})
        assert compare.markdown(group)
        assert compare.csv_table([group])
        if path.stat().st_size % 64 == 0:
            figures.picture(group, "svg")


TAGS = ("rollout/reward0", "rollout/reward1", "rollout/kills0", "rollout/kills1", "rollout/steps", "train/loss")


def _changed_cell(content: bytes, rng: Random) -> bytes:
    """The table with one cell replaced."""
    rows = [line.split(b",") for line in content.split(b"\n")]
    row = rng.choice(rows[1:])
    row[rng.randrange(len(row))] = rng.choice(CELLS)
    return b"\n".join(b",".join(row) for row in rows)


CELLS = (
    *(b"", b"0", b"-1", b"nan", b"inf", b"-inf", b"1e999", b"3.5e38", b"1e300", b"-3e38", b"9" * 30, b"9" * 5000),
    *(b"x", b'"', b"\0", b"\xff", "٣".encode(), b"rollout/reward9999999", b"rollout/reward", b"1_0", b" 7 ", b"0x10"),
)
