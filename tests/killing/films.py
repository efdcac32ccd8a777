"""Writers of recordings, films, states and compiled ticks; what each may leave when it is killed."""

import sys
from pathlib import Path

import numpy as np

from outlast import make_vec
from outlast.envs.recording import Recording
from outlast.envs.snapshots.state import State
from tests.killing.writer import COMPLETE, NOTHING, AtomicOutput, Writer, same_bytes, visible


class Record(Writer):
    """outlast rollout --record, which appends: a killed run leaves a prefix of the recording."""

    name = "rollout --record"

    def command(self, folder: Path, resume: bool = False) -> list[str]:
        path = folder / ("b.rec" if resume and (folder / "a.rec").exists() else "a.rec")  # overwrites nothing
        worlds = ("--worlds", "512", "--steps", "1500")
        return ["outlast", "rollout", "ffa_1", *worlds, "--record", str(path), "--quiet"]

    def check(self, folder: Path, reference: Path) -> str:
        path = folder / "a.rec"
        if not path.exists():
            return NOTHING
        found, expected = Recording.open(path), Recording.open(reference / "a.rec")
        assert [*visible(folder)] == [path]
        assert bool(found.cut) == (len(found) < len(expected)) or "end is missing" in found.cut
        for one, other in zip(found.tick_records(), expected.tick_records(), strict=False):
            for field in ("mode", "codes", "keys", "digest"):
                assert np.array_equal(getattr(one, field), getattr(other, field)), field
        assert len(found), "a file without ticks"
        return COMPLETE if not found.cut else "a part"

    def check_resumed(self, folder: Path, reference: Path) -> None:
        last = visible(folder)[-1]
        assert not Recording.open(last).cut
        assert len(Recording.open(last)) == len(Recording.open(reference / "a.rec"))


SHAPE = (198, 128)  # of a frame: a square, and the scoreboard of two agents
FRAMES = ("outlast", "frames", "ffa_1", "--steps", "60", "--size", "128", "--quiet", "--out", "{out}")


def film(product: str) -> AtomicOutput:
    """outlast frames, in one of its formats."""
    return AtomicOutput(f"frames {Path(product).suffix}", product, FRAMES, same_film)


def same_film(path: Path, expected: Path) -> None:
    from outlast.envs.rendering.video.codecs import CODECS

    codec = CODECS[path.suffix]
    assert codec.read(path) == codec.read(expected) == (61, *SHAPE)


class Pictures(AtomicOutput):
    """outlast frames into the folder of an earlier film, whose pictures go first."""

    def __init__(self) -> None:
        super().__init__("frames over frames", "film", FRAMES, same_pictures)

    def prepare(self, folder: Path) -> None:
        import cv2

        (folder / "film").mkdir()
        for k in range(70):
            cv2.imwrite(str(folder / "film" / f"frame_{k:06}.png"), np.zeros((*SHAPE, 3), np.uint8))

    def check(self, folder: Path, reference: Path) -> str:
        import cv2

        pictures = visible(folder / "film")
        assert all(np.shape(cv2.imread(str(path))) == (*SHAPE, 3) for path in pictures)
        assert [path.name for path in pictures] == [f"frame_{k:06}.png" for k in range(len(pictures))]
        old = sum(not cv2.imread(str(path)).any() for path in pictures)
        assert old in (0, len(pictures)), "some pictures of each film"
        return COMPLETE if (old, len(pictures)) == (0, 61) else "as before" if old == 70 else "a part"


def same_pictures(path: Path, expected: Path) -> None:
    files = visible(path)
    assert [file.name for file in files] == [file.name for file in visible(expected)]
    assert all(file.read_bytes() == (expected / file.name).read_bytes() for file in files)


class States(Writer):
    """State.save, again and again into one file."""

    name = "State.save"

    def command(self, folder: Path, resume: bool = False) -> list[str]:
        return ["tests.killing.films", str(folder / "state.npz")]

    def check(self, folder: Path, reference: Path) -> str:
        if not visible(folder):
            return NOTHING
        assert [path.name for path in visible(folder)] == ["state.npz"]
        state = State.load(folder / "state.npz")
        env = make_vec("ffa_1", 64, seed=1)
        env.set_state(state)
        env.close()
        return COMPLETE if state.arrays.keys() == State.load(reference / "state.npz").arrays.keys() else "another"

    def check_resumed(self, folder: Path, reference: Path) -> None:
        same_bytes(folder / "state.npz", reference / "state.npz")


def save_states(path: Path) -> None:
    """The command of States."""
    env, rng = make_vec("ffa_1", 64, seed=1), np.random.default_rng(0)
    env.reset()
    for _ in range(300):
        env.step(rng.integers(0, env.action_sizes, (64, 2, len(env.action_sizes))))
        env.get_state().save(path)
    env.close()


class Compiled(Writer):
    """The compiled tick, into an empty compile cache."""

    name = "compiled tick"
    slow = True

    def environment(self, folder: Path) -> dict[str, str]:
        return {"OUTLAST_CACHE_DIR": str(folder / "cache")}

    def command(self, folder: Path, resume: bool = False) -> list[str]:
        return ["outlast", "rollout", "ffa_1", "--worlds", "2", "--steps", "3", "--quiet"]

    def check(self, folder: Path, reference: Path) -> str:
        files = [path for path in folder.rglob("*") if path.is_file()]
        return f"{len(files)} files" if files else NOTHING

    def check_resumed(self, folder: Path, reference: Path) -> None:
        names = [{path.name for path in directory.rglob("*.unit")} for directory in (folder, reference)]
        assert names[0] == names[1] != set()


WRITERS: list[Writer] = [
    Record(),
    *(film(f"film{suffix}") for suffix in (".webm", ".mp4", ".apng", ".gif")),
    AtomicOutput("frames folder", "film", FRAMES, same_pictures),
    Pictures(),
    States(),
    Compiled(),
]

if __name__ == "__main__":
    save_states(Path(sys.argv[1]))
