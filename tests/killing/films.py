"""What `killing` kills: recordings, films, states, compiled ticks; and what each may leave."""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from outlast import make_vec
from outlast.envs.recording import Recording
from outlast.envs.snapshots.state import State
from tests.killing import NOTHING, WHOLE, Writer, visible


class Record(Writer):
    """outlast rollout --record: appends, so what a killed one leaves is a part of the whole."""

    name = "rollout --record"

    def words(self, place: Path, again: bool = False) -> list[str]:
        path = place / ("b.rec" if again and (place / "a.rec").exists() else "a.rec")  # overwrites nothing
        worlds = ("--worlds", "512", "--steps", "1500")
        return ["outlast", "rollout", "ffa_1", *worlds, "--record", str(path), "--quiet"]

    def check(self, place: Path, whole: Path) -> str:
        path = place / "a.rec"
        if not path.exists():
            return NOTHING
        found, expected = Recording.open(path), Recording.open(whole / "a.rec")
        assert [*visible(place)] == [path]
        assert bool(found.cut) == (len(found) < len(expected)) or "end is missing" in found.cut
        for one, other in zip(found.runs(), expected.runs(), strict=False):
            for field in ("mode", "codes", "keys", "digest"):
                assert np.array_equal(getattr(one, field), getattr(other, field)), field
        return "whole" if not found.cut else "a part" if len(found) else "no run"

    def same(self, place: Path, whole: Path) -> None:
        last = visible(place)[-1]
        assert not Recording.open(last).cut
        assert len(Recording.open(last)) == len(Recording.open(whole / "a.rec"))


class Whole(Writer):
    """A command whose product is whole or not there. equal: (product, expected) -> None; raises AssertionError."""

    def __init__(self, name: str, product: str, words: tuple[str, ...], equal: Callable[[Path, Path], None]) -> None:
        self.name, self.product, self.arguments, self.equal = name, product, words, equal

    def words(self, place: Path, again: bool = False) -> list[str]:
        return [word.format(out=place / self.product, place=place) for word in self.arguments]

    def check(self, place: Path, whole: Path) -> str:
        assert {path.name for path in visible(place)} <= {path.name for path in visible(whole)}
        if not (place / self.product).exists():
            return NOTHING
        self.equal(place / self.product, whole / self.product)
        return WHOLE

    def same(self, place: Path, whole: Path) -> None:
        self.equal(place / self.product, whole / self.product)


def same_bytes(path: Path, expected: Path) -> None:
    assert path.read_bytes() == expected.read_bytes(), path.name


FRAMES = ("outlast", "frames", "ffa_1", "--steps", "60", "--size", "128", "--quiet", "--out", "{out}")


def film(product: str) -> Whole:
    """outlast frames, in one of its formats."""
    return Whole(f"frames {Path(product).suffix}", product, FRAMES, same_film)


def same_film(path: Path, expected: Path) -> None:
    from outlast.envs.rendering.video.codecs import CODECS

    codec = CODECS[path.suffix]
    assert codec.read(path) == codec.read(expected) == (61, 128, 128)


class Pictures(Whole):
    """outlast frames into a folder of an earlier film, whose pictures are replaced one by one."""

    def __init__(self) -> None:
        super().__init__("frames over frames", "film", FRAMES, same_pictures)

    def prepare(self, place: Path) -> None:
        import cv2

        (place / "film").mkdir()
        for k in range(70):
            cv2.imwrite(str(place / "film" / f"frame_{k:06}.png"), np.zeros((128, 128, 3), np.uint8))

    def check(self, place: Path, whole: Path) -> str:
        import cv2

        pictures = visible(place / "film")
        assert all(np.shape(cv2.imread(str(path))) == (128, 128, 3) for path in pictures)
        assert [path.name for path in pictures] == [f"frame_{k:06}.png" for k in range(len(pictures))]
        assert 61 <= len(pictures) <= 70
        old = sum(not cv2.imread(str(path)).any() for path in pictures[:61])
        return "whole" if len(pictures) == 61 else "as before" if old == 61 else "some pictures of each film"


def same_pictures(path: Path, expected: Path) -> None:
    files = visible(path)
    assert [file.name for file in files] == [file.name for file in visible(expected)]
    assert all(file.read_bytes() == (expected / file.name).read_bytes() for file in files)


class States(Writer):
    """State.save, over and over in one place."""

    name = "State.save"

    def words(self, place: Path, again: bool = False) -> list[str]:
        return ["tests.killing_films", str(place / "state.npz")]

    def check(self, place: Path, whole: Path) -> str:
        if not visible(place):
            return NOTHING
        assert [path.name for path in visible(place)] == ["state.npz"]
        state = State.load(place / "state.npz")
        env = make_vec("ffa_1", 64, seed=1)
        env.set_state(state)
        env.close()
        return "whole" if state.arrays.keys() == State.load(whole / "state.npz").arrays.keys() else "another"

    def same(self, place: Path, whole: Path) -> None:
        same_bytes(place / "state.npz", whole / "state.npz")


def save_states(path: Path) -> None:
    """What States runs."""
    env, rng = make_vec("ffa_1", 64, seed=1), np.random.default_rng(0)
    env.reset()
    for _ in range(300):
        env.step(rng.integers(0, env.action_sizes, (64, 2, len(env.action_sizes))))
        env.get_state().save(path)
    env.close()


class Compiled(Writer):
    """The compiled tick, in a cache that is empty."""

    name = "compiled tick"
    costly = True

    def environment(self, place: Path) -> dict[str, str]:
        return {"OUTLAST_CACHE_DIR": str(place / "cache")}

    def words(self, place: Path, again: bool = False) -> list[str]:
        return ["outlast", "rollout", "ffa_1", "--worlds", "2", "--steps", "3", "--quiet"]

    def check(self, place: Path, whole: Path) -> str:
        files = [path for path in place.rglob("*") if path.is_file()]
        return f"{len(files)} files" if files else NOTHING

    def same(self, place: Path, whole: Path) -> None:
        names = [{path.name for path in folder.rglob("*.nb*")} for folder in (place, whole)]
        assert names[0] == names[1] != set()


WRITERS: list[Writer] = [
    Record(),
    *(film(f"film{suffix}") for suffix in (".webm", ".mp4", ".apng", ".gif")),
    Whole("frames folder", "film", FRAMES, same_pictures),
    Pictures(),
    States(),
    Compiled(),
]

if __name__ == "__main__":
    save_states(Path(sys.argv[1]))
