"""What repeats the paper: what it plans, trains, measures and writes; called again, it goes on."""

import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast.envs.cli.main import parser
from outlast.training.arena.match import MatchResults, Pairing
from outlast.training.base.curves import FILE, format_curves, read_curves
from outlast.training.base.errors import TrainingError
from outlast.training.base.files import packed
from outlast.training.research.__main__ import main as research

pytest.importorskip("matplotlib", reason="needs matplotlib: outlast[plot]")

from outlast.training.research import corrected_games as mended
from outlast.training.research import reproduce

RESULTS = Path(__file__).parents[2] / "results"


def outlast_paper(*arguments: object) -> int:
    return research(["reproduce", *map(str, arguments), "--quiet"])


def test_the_plan_is_of_words_that_train_takes(capsys: pytest.CaptureFixture[str]) -> None:
    assert outlast_paper("--plan") == 0
    about, *lines = capsys.readouterr().out.splitlines()
    assert about.startswith(f"{len(lines)} runs, ")
    commands = [line.partition("  #")[0].split()[1:] for line in lines]
    assert len({" ".join(words) for words in commands}) == len(lines) == 8 * 3 + 16 * 3 + 25 * 2
    seeds = [options.seed[0] for options in map(parser().parse_args, commands)]
    assert seeds == sorted(seeds)
    assert outlast_paper("original", "--only", "teams_2", "ffa_2", "--seeds", 2, "--first", 3, "--plan") == 0
    chosen = [line.partition("  #")[0].split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert [(words[2], words[words.index("--seed") + 1]) for words in chosen] == [
        (name, seed) for seed in "34" for name in ("ffa_2", "teams_2")
    ]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["orginal"], "unknown part 'orginal'; known: original, text, mended"),
        (["original", "--only", "ffa_2+bounty"], r"--only ffa_2\+bounty: unknown game; known: ffa_1, ffa_2"),
    ],
)
def test_what_is_not_there_is_refused(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert outlast_paper(*words) == 2
    assert re.search(message, capsys.readouterr().err)


def test_the_plan_has_what_is_left(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("original", "--only", "ffa_1", "ffa_4", "--seeds", 1, "--plan", "--out", tmp_path)
    for game, share in (("ffa_1", 1), ("ffa_4", 0.5)):
        folder = tmp_path / f"runs/original/{game}-original-0"
        folder.mkdir(parents=True)
        (folder / "log.csv").write_text(f"tag,step,value\ntime/fps,{round(share * reproduce.PAPER_STEPS)},1\n")
    assert outlast_paper(*words, "--jobs", 3) == 0
    about, line = capsys.readouterr().out.splitlines()
    assert about == "1 runs, 3 at a time: 5,000,000 agent-steps; 1 of 2 runs are finished"
    assert line.startswith("outlast train ffa_4 ")
    assert line.endswith("  # 5,000,000 agent-steps")
    assert outlast_paper("original", "--only", "ffa_1", *words[4:]) == 0
    assert capsys.readouterr().out == "1 of 1 runs are finished: figures and tables are written again\n"


def test_films_need_ffmpeg_before_anything_is_trained(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert outlast_paper("original", "--only", "ffa_1", "--out", tmp_path / "out") == 2
    assert "the films need FFmpeg: pip install 'outlast[train,plot,view]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_emerges_counts_both_roles(tmp_path: Path) -> None:
    """Two teams of two: means over a side's agents, and sums over its side, of both sides; kept, and read again."""
    rows = []
    for name, far in (("teams", 1.0), ("alone", 0.0)):
        results, found = MatchResults(1, 2), {"run": name, "policy": "steps", "against itself at half time": "0.25"}
        roles = {"kills": [1.0, 0.5], "damage_dealt": [30.0, 10.0], "mate_distance": [4 * far, 6 * far]}
        for figure, both in roles.items():
            results.enter((np.zeros(2, int), np.arange(2)), figure, np.array([both, both]))
        own = mended.self_play(Pairing((0, 0), results), mended.SELF_PLAY, 4)
        rows.append(found | {title: repr(mean) for title, (mean, _) in own.items()})
    kept = tmp_path / mended.FILE
    kept.write_bytes(mended.format_measured(rows))
    again = mended.read_measured(kept)
    heads, _, *lines = mended.table({name: [again[name]] for name in ("teams", "alone")}).splitlines()
    cells = [[cell.strip() for cell in line.split("|")] for line in (heads, *lines)]
    teams, alone = (dict(zip(cells[0], row, strict=True)) for row in cells[1:])
    titles = ("against itself at half time", "kills", "damage", "m to a mate")
    assert [float(teams[title]) for title in titles] == [0.25, 1 + 0.5, 2 * 30 + 2 * 10, 5]
    assert alone["m to a mate"] == "–"
    assert "wins against scripted" not in teams  # which nobody has played


@pytest.mark.parametrize("content", [b"run,agents", packed("run,agents\n1,2\n"), packed("run,agents")[:-9]])
def test_what_is_not_measured_is_refused(tmp_path: Path, content: bytes) -> None:
    assert mended.read_measured(tmp_path / mended.FILE) == {}
    (tmp_path / mended.FILE).write_bytes(content)
    with pytest.raises(TrainingError, match=f"{mended.FILE} does not hold measurements of runs"):
        mended.read_measured(tmp_path / mended.FILE)


@pytest.mark.parametrize(
    ("part", "games", "table"),
    [
        ("original", ("ffa_2-original", "teams_2-original"), "ends.csv"),
        ("mended", ("ffa_2-fast", "ffa_2+health_cap+bounty+steering-fast"), "measured.md"),
    ],
)
def test_tables_are_of_all_games_that_are_there(part: str, games: Any, table, tmp_path, monkeypatch, capsys) -> None:
    """Also where one is asked for after the other; films are of that one."""
    filmed = list[str]()
    monkeypatch.setattr(reproduce, "_film", lambda scenario, policy, path: filmed.append(path.name) or path)
    runs, study, words = [f"{game}-0" for game in games], tmp_path / part, (part, "--only", "ffa_2", "--seeds", 1)
    curves, measured = read_curves(RESULTS / part / FILE), mended.read_measured(RESULTS / part / mended.FILE)
    study.mkdir()
    (study / FILE).write_bytes(format_curves({run: curves[run] for run in runs}))
    if part == "mended":
        (study / mended.FILE).write_bytes(mended.format_measured(measured[run] for run in runs))
    assert outlast_paper(*words, "--out", tmp_path) == 0
    found = (study / table).read_text()
    assert all(game.rpartition("-")[0] in found for game in games)
    assert filmed == [f"{games[0]}.webm" if part == "original" else "ffa_2.webm"]
    assert read_curves(study / FILE).keys() == {*runs}
    if part == "mended":  # the other one is not measured for that
        (study / mended.FILE).write_bytes(mended.format_measured([measured[runs[0]]]))
        assert outlast_paper(*words, "--out", tmp_path) == 0
        assert games[1].rpartition("-")[0] not in (study / table).read_text()
        (study / mended.FILE).unlink()  # nor is one that is asked for, if only its curves are there
        assert outlast_paper(*words, "--out", tmp_path) == 2
        assert f"does not have {runs[0]}" in capsys.readouterr().err


def is_enough(folder: Path, words: Any, *files: str) -> None:
    """Check that what is kept is written again when the runs are gone."""
    before = [(folder / file).read_text() for file in files]
    shutil.rmtree(folder / "runs")
    assert outlast_paper(*words) == 0
    assert not (folder / "runs").exists()
    assert [(folder / file).read_text() for file in files] == before


@pytest.mark.nightly
def test_mended_games_are_trained_measured_drawn_and_filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = "--worlds 16 --rollout 1024 --every 8192 --with Behaviour --opponents self,scripted"
    monkeypatch.setattr(reproduce, "MENDED_STEPS", 32768)  # so many that episodes of all games end
    monkeypatch.setattr(reproduce, "POOL", tuple(small.split()))
    monkeypatch.setattr(mended, "EPISODES", 64)
    words = ("mended", "--only", "ffa_2+bounty", "teams_2+bounty", "--out", tmp_path)
    assert outlast_paper(*words) == 0
    assert sorted(path.name for path in (tmp_path / "runs/mended").iterdir()) == [
        f"{game}-fast-{seed}" for game in ("ffa_2+bounty", "teams_2+bounty") for seed in (0, 1)
    ]
    table = (tmp_path / "mended/measured.md").read_text()
    assert table.count("\n") == 4
    assert "| teams_2+bounty | 2 |" in table
    policy = "policies/ffa_2+bounty/pool-1.safetensors"
    for name in ("mended/ffa_2+bounty.webm", "mended/ffa_2/curves.png", "mended/teams_2/curves.png", policy):
        assert (tmp_path / name).stat().st_size > 1000
    measured = mended.read_measured(tmp_path / "mended" / mended.FILE)
    assert {row["policy"] for row in measured.values()} == {"steps_0000032768.zip"}
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").rglob("*") if path.is_file()}
    assert outlast_paper(*words) == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before  # nothing is trained or measured twice
    is_enough(tmp_path, words, "mended/measured.md", "mended/ffa_2/ends.csv")


@pytest.mark.nightly
def test_the_papers_variants_are_trained_and_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reproduce, "PAPER_STEPS", 4096)
    monkeypatch.setattr(reproduce, "FEW_WORLDS", ("--worlds", "4", "--rollout", "512", "--ppo", "n_epochs=1"))
    words = ("text", "--only", "teams_2", "--seeds", 1, "--out", tmp_path)
    assert outlast_paper("original", *words[1:]) == 0  # which the others are compared with
    broken = tmp_path / "runs/text/teams_2-scaled-0"
    broken.mkdir(parents=True)
    (broken / "run.json").write_text("{")
    assert outlast_paper(*words) == 2
    assert "| preset `original` | preset `paper` |" in (tmp_path / "text/ends.md").read_text()  # made all the same
    shutil.rmtree(broken)
    assert outlast_paper(*words) == 0
    names = [f"teams_2-{name}" for name in ("paper", "scaled")]
    assert all((tmp_path / "text" / f"{name}{end}").exists() for name in names for end in (".png", ".webm"))
    assert [*read_curves(tmp_path / "text" / FILE)] == [f"{name}-0" for name in names]
    policies = [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*.safetensors"))]
    assert policies == [f"policies/teams_2/{name}-0.safetensors" for name in ("original", "paper", "scaled")]
    text = (tmp_path / "text/ends.md").read_text()
    assert all(f"`teams_2`, preset `{name}`, seed 0. Unfinished" in text for name in ("paper", "scaled"))
    assert "| preset `original` | preset `paper` | preset `scaled` |" in text.splitlines()[0]
    monkeypatch.setattr(reproduce, "PAPER_STEPS", 4000)  # kept curves end where the last rollout began
    is_enough(tmp_path, words, "text/ends.md")
