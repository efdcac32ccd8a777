"""The command line does what the README says, takes words as people type them, and refuses mistakes in one line."""

import ast
import importlib
import logging
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import pytest

import outlast
from outlast import ABLATIONS, variant
from outlast.ecs import Worlds
from outlast.envs.cli import main as cli
from outlast.envs.cli import options
from outlast.envs.cli.grammar import SECTIONS, Parser, summaries
from outlast.envs.cli.options import scenario
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.scenarios.hide_and_seek import SCENARIOS
from outlast.levels import FloorPlan
from tests.conftest import run


def test_variants_lists_all_eight_and_hide_and_seek(capsys) -> None:
    status, out, _ = run(capsys, "variants")
    assert status == 0
    variants, installed, ablations = out.split("\n\n")
    assert len(variants.splitlines()) == 8
    assert {*SCENARIOS} <= {line.split()[0] for line in installed.splitlines()[1:]}
    assert len(ablations.splitlines()) == 1 + len(ABLATIONS)
    assert "teams_4  2v2_all_high" in out
    with pytest.raises(SystemExit, match="0"):
        cli.main(("--version",))
    assert capsys.readouterr().out == f"outlast {outlast.__version__}\n"


def test_a_new_game_is_tested_checked_played_filmed_and_trained(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert run(capsys, "new", "red_hill")[0] == 0
    assert run(capsys, "new", "red_hill")[2].startswith("outlast: red_hill.py exists")
    (ast_of,) = ast.parse(Path("red_hill.py").read_text()).body[-1:]
    assert isinstance(ast_of, ast.FunctionDef)
    getattr(importlib.import_module("red_hill"), ast_of.name)()
    small = ("--worlds", "2", "--steps", "20")
    for words in (("check", *small), ("rollout", *small), ("frames", "--steps", "5", "--out", "film.gif")):
        assert run(capsys, words[0], "red_hill.py", *words[1:])[0] == 0
    pytest.importorskip("torch", reason="needs PyTorch: outlast[train]")
    assert run(capsys, "train", "red_hill.py", "--steps", "1", "--rollout", "512", "--worlds", "4")[0] == 0


def test_schedule_prints_the_tick_and_the_generated_code(capsys) -> None:
    status, out, _ = run(capsys, "schedule", "ffa_1", "--source")
    assert status == 0
    assert "# ---- MELEE (step): attacks have landed" in out
    assert "def unit(arguments, first, last):  # melee.aim" in out
    status, out, _ = run(capsys, "schedule", "1v1_heals_low")
    assert status == 0
    assert out.index("motors.drive") < out.index("physics.collide") < out.index("safe_zone.apply_damage")
    assert "boxes." not in out


def test_a_system_runs_as_python(capsys):
    few = ("rollout", "ffa_1", "--worlds", "2", "--steps", "5", "--quiet")
    status, out, _ = run(capsys, *few, "--interpret", "melee.aim", "--interpret", "melee.strike")
    assert status == 0
    assert "10 world-steps" in out


def test_rollout_prints_rates_and_a_table_of_means_with_errors(capsys):
    command = "rollout ffa_2 --worlds 3 --steps 150 --policy noop --set safe_zone_damage=100"
    status, out, err = run(capsys, *command.split())
    assert status == 0
    assert "world-step" in err  # the progress bar
    assert "3 worlds x 150 steps\n" in out
    assert "450 world-steps in" in out
    assert "episodes ended; those cut off at the end are missing, so means lean towards short episodes" in out
    shares = re.search(r"agent-steps/s \(policy (\d+)%, worlds (\d+)%, rest (\d+)%\)", out)
    assert shares
    assert 98 <= sum(map(int, shares.groups())) <= 102
    assert "std. error" in out
    assert "deaths_zone" in out
    assert out.split("length")[1].split()[0].replace(".", "").isdigit()
    _, out, err = run(capsys, "rollout", "ffa_2", "--worlds=3", "--policy=noop", "--set=safe_zone_damage=100")
    assert "3 worlds x 1 episode\n" in out
    assert "3 of 3 episodes" in err


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("melee_damage=7", 7),
        ("room_size=2.5e1", 25.0),
        ("melee_blocked=False", False),
        ("cameras_mode=omniscient", "omniscient"),
        ("safe_zone_radii=(5,3)", (5.0, 3.0)),
        ("safe_zone_radii=5", (5.0,)),
    ],
)
def test_set_changes_numbers_of_every_kind(text: str, value: Any) -> None:
    options = cli.parser().parse_args(["rollout", "teams_4", "--set", text])
    assert scenario(options) == variant("teams_4").replace(**{text.partition("=")[0]: value})


def test_a_compilation_is_announced_on_stderr(capsys, monkeypatch):
    monkeypatch.setattr(Worlds, "uncompiled", ["clock"])
    arguments = ("rollout", "ffa_1", "--worlds", "1", "--steps", "3", "--quiet")
    status, _, err = run(capsys, *arguments)
    assert status == 0
    assert err.startswith("outlast: compiling 1 system of ffa_1 for this machine; machine code is kept in ")
    assert "outlast: compiled in 0 s\n" in err
    assert logging.getLogger("outlast").handlers == []


def commands() -> Any:
    """The commands of the parser, as argparse keeps them."""
    (found,) = (action for action in cli.parser()._actions if isinstance(action.choices, dict))
    return found


NAMES = list(commands().choices)
FEW = "rollout ffa_1 --worlds 2 --steps 3 --quiet"


def test_alone_it_shows_every_command_with_an_example(capsys) -> None:
    texts = []
    for words in ((), ("help",), ("--help",)):
        with pytest.raises(SystemExit, match="0"):
            cli.main(words)
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1] == texts[2]
    lines = texts[0].splitlines()
    for name, about in summaries(commands()).items():
        where = lines.index(f"  {name:<11} {about}")
        assert lines[where + 1].strip().startswith(f"outlast {name}")
    assert list(SECTIONS) == [title for title in SECTIONS if f"{title}:" in lines]


@pytest.mark.parametrize("name", NAMES)
def test_help_of_a_command(capsys, name: str) -> None:
    with pytest.raises(SystemExit, match="0"):
        cli.main(("help", name))
    text = capsys.readouterr().out
    command: Parser = commands().choices[name]
    assert text.startswith(f"usage: outlast {name}")
    assert command.description
    assert command.examples
    for example, says in command.examples:
        assert f"  # {says}\n  outlast {example}\n" in f"{text}\n"
        if not example.startswith("help"):
            cli.parser().parse_args(shlex.split(example))
    for title, actions in command.groups():
        assert f"\n{title}:\n" in text
        assert all(action.help for action in actions), title


def test_counts_are_written_as_people_write_them() -> None:
    for text, value in {"7": 7, "1e3": 1000, "2.5e6": 2_500_000, "1_000": 1000, "3.0": 3, " 4 ": 4}.items():
        assert options.count(text) == value
    for text in ("0", "-1", "1.5", "1e-3", "nan", "inf", "1e999999999", "x", "", "1,000", "0x10"):
        with pytest.raises(options.argparse.ArgumentTypeError, match=r"an integer of at (least 1|most 1,000,000,000,)"):
            options.count(text)


def test_every_count_of_every_command_takes_an_exponent() -> None:
    kinds = {options.positive, options.nonnegative, options.seed}
    for name, command in commands().choices.items():
        for _, actions in command.groups():
            for action in actions:
                assert action.type is not int, (name, action.option_strings)
                if action.type in kinds:
                    assert action.type("1e3") == 1000


def test_a_value_may_begin_with_a_minus() -> None:
    words = ["frames", "ffa_1", "--views", "-ids,+vision", "--steps", "3", "--out", "film"]
    parsed = cli.parser().parse_args(words)
    assert (parsed.views, parsed.steps) == ("-ids,+vision", 3)
    assert cli.parser().parse_args(["frames", "ffa_1", "--views=-ids", "--out", "f"]).views == "-ids"


LINES = {
    **{f"new {name}": f"{name}: " for name in ("Hill", "class", "json", "game.py", "body", "climber")},
    "new 'two words'": "two words: ",
    f"{FEW} --interpret melee.ain": "did you mean melee.aim",
    f"{FEW} --csv a.csv --events ./a.csv": "--csv and --events are both ./a.csv: give another name for one",
    "rolout ffa_1": "COMMAND: rolout: did you mean rollout?; known: variants",
    "help rolout": "COMMAND: rolout: did you mean rollout?",
    "--verison": "unknown option --verison: did you mean --version?",
    f"{FEW} --wrlds 3": "unknown option --wrlds: did you mean --worlds?",
    f"{FEW} ffa_2": "ffa_2 is one word too many",
    "evaluate ffa_2 random --episodes 1 scripted": "scripted is one word too many; put what belongs together in a row",
    "rollout": "required: VARIANT",
    "frames ffa_1": "required: --out",
    "frames ffa_1 --out ''": "--out: the name of a file or folder is needed, not nothing",
    "frames ffa_1 --out / --steps 1 --quiet": "give a folder of their own",
    f"{FEW} --record ''": "--record: the name of a file or folder is needed, not nothing",
    f"{FEW} --record -": "--record: the name of a file is needed: only --json - writes to standard output",
    "replay ''": "file: the name of a file or folder is needed, not nothing",
    f"{FEW} --seed {2**64}": f"--seed: {2**64}: an integer of at most 2**64 - 1 is needed",
    f"{FEW} --steps 1e13": "--steps: 1e13: an integer of at most 1,000,000,000,000 is needed",
    f"{FEW} --worlds": "--worlds: expected one argument",
    "rollout ffa_1 --worlds 1e12": "there is not enough memory, take fewer --worlds",
    f"{FEW} --set room_size=1e30": "room.size = 1e+30: must be >= 1 and <= 10000",
    f"{FEW} --set n_agents=100": "115 bodies (100 agent, 15 heal) do not fit into spawn_grid.cells = 8 x 8 = 64 cells",
    "rollout ffa_1 --set mele_damage=3": "no number 'mele_damage'; did you mean melee_damage",
    "rollout ffa_1 --set safe_zone_radii=5,x": "safe_zone.radii[1] = 'x': a finite number",
    "rollout ffa_1 --set melee_damage=1,2": "melee.damage = '1,2': an integer",
    f"{FEW} --set agents_count": "--set agents_count: NUMBER=VALUE is needed",
    f"{FEW} --episodes 3": "--steps and --episodes exclude each other",
    f"{FEW} --policy nobody": f"nobody: did you mean noop? {', '.join(POLICIES)} or a saved policy",
    f"{FEW} --csv a.txt": "episodes are written as NAME.csv or NAME.parquet",
    f"{FEW} --record nowhere/a.rec": "nowhere/a.rec cannot be written: there is no folder nowhere",
    "rollout ffa_9": "there is no variant 'ffa_9'; did you mean ffa_4 or ffa_3? known: ffa_1, ",
    "schedule nothing": "there is no variant 'nothing'; known: ",
    "replay nowhere.rec": "nowhere.rec: No such file or directory",
    "play ffa_1 --fps 0 --no-browser": "--fps: 0: a number above 0",
    "play ffa_1 --no-browser --allow-host localhost": "outlast: localhost: NAME:PORT is needed, as in localhost:9000",
    "play ffa_1 --others noop:0.5,scriptd": "--others: scriptd: did you mean scripted",
    "play ffa_1 --no-browser --host 203.0.113.7": "--host takes an address of this machine",
    "completion tcsh": "shell: tcsh",
    f"{FEW} --record a.rec --ray": "leave them out with --ray",
    f"{FEW} --others noop --ray": "outlast: --others plays on one machine: leave it out with --ray",
    "layout nowhere --out x.png": "layout nowhere: No such file or directory; maze, rooms, pillars",
    "layout maze --out x.gif": "x.gif: layouts are written as NAME.png or NAME.html or NAME.json",
    "layout maze --size 9999 --out x.png": "size = 9999: 64 to 4096 pixels",
    "layout maze --size 200 --out x.html": "--size 200 is for pictures",
    "layout maze --worlds 2 --out x.json": "is for the floor plan of one world",
    "layout maze --out /nowhere/x.json": "/nowhere/x.json cannot be written: there is no folder",
    "layout maze --worlds 100000 --out x.png": "a mosaic of 316x317 pictures of 384 pixels is wider than 16384",
    "layout x.json --out x.json": "LAYOUT and --out are both x.json: give another name for one",
    "rollout ffa_1 --layout /dev/null": "/dev/null is not a floor plan: a drawing of 0 x 0 characters",
    "rollout ffa_2 --policy scripted --record a.rec --record-policy": "does not report the probabilities of its",
    "rollout ffa_2 --policy scripted --record-policy": "name a file to record into, too",
    "frames ffa_3 --out film.avi": ".mp4, .webm, .gif, .apng",
    "frames ffa_3 --out nowhere/film.webm": "there is no folder nowhere",
    "frames ffa_3 --out f.webm --views +vison": "did you mean vision",
    "frames ffa_3 --out f.webm --size 32": "64 to 4096",
    "frames ffa_3 --out pictures --fps 10": "fps = 10: for films only; pictures is a folder",
    "frames ffa_3 --out f.webm --size 64 --mosaic 2000000x1000000": "is wider than 16384: take a smaller size",
    "frames ffa_3 --out f.webm --mosaic 4": "4: rows x columns are needed, as in 4x4",
    "evaluate ffa_1 noop noop": "named twice",
    "evaluate ffa_1 scriptd": "scriptd: did you mean scripted?",
    "evaluate ffa_1 runs/nowhere": "runs/nowhere is not a saved policy: it must be a model's name, FILE.zip, ",
    "evaluate ffa_1 noop --film": "films need a folder",
    "evaluate ffa_1 noop --out /dev/null": "cannot be a folder: ",
    "train ffa_1 1v1_heals_low --out run": "name each variant and each seed once",
    "train ffa_1 --jobs 2 --out run": "--jobs has no effect on one run: leave it out, or name several",
    "train ffa_2 --sweep n_agents=2,3 --sweep agents_count=2,3 --out run": "agents_count is given twice",
    "train ffa_2 --sweep melee_damage=1,1 --out run": "different values, as in melee_damage=5,10,20",
    "train ffa_2 --sweep gamma=0.9 --ppo gamma=1 --out run": "gamma is given twice",
    "train ffa_2 --sweep heals_count=1,2 --save-scenario game.json --out run": "--sweep makes several",
    "train ffa_2 --ppo gama=1 --out run": "PPO has no hyperparameter 'gama'; did you mean gamma?",
    "train ffa_2 --steps 1.5 --out run": "1.5: an integer of at least 0 is needed",
    "train ffa_2 --memory 8 --rollout 2560 --out run": "--rollout 4096",
}
LATE = {  # found only once worlds are made, which may print that they are compiled
    "rollout ffa_2 --policy scripted --record a.rec --record-policy",
    *(line for line in LINES if line.startswith("play") and "--host 203.0.113.7" in line),
}


@pytest.mark.parametrize("line", LINES)
def test_mistakes_are_one_line(line: str, capsys, tmp_path: Path, monkeypatch) -> None:
    if line.startswith(("train", "evaluate")):
        pytest.importorskip("torch", reason="needs PyTorch: outlast[train]")
    monkeypatch.chdir(tmp_path)
    for _ in range(2 if line in LATE else 1):
        capsys.readouterr()
        try:
            status = cli.main(shlex.split(line))
        except SystemExit as left:
            status = int(str(left.code))
    out, err = capsys.readouterr()
    assert (status, out) == (2, "")
    assert err.startswith("outlast")
    assert len(err.splitlines()) == 1
    assert LINES[line] in err
    assert list(tmp_path.iterdir()) == []


def outlast_in_shell(line: str, place: Path, **variables: str) -> tuple[int, str]:
    """Exit status and stderr of a line in which $O is the command; its status is that of the command."""
    environment = {**os.environ, **variables, "O": f"{shlex.quote(sys.executable)} -m outlast"}
    done = subprocess.run(["bash", "-c", line], cwd=place, env=environment, capture_output=True, text=True)
    return done.returncode, done.stderr


@pytest.mark.skipif(shutil.which("bash") is None or not Path("/dev/full").exists(), reason="needs Linux")
def test_files_are_complete_whatever_becomes_of_what_is_printed(tmp_path: Path) -> None:
    """On a full disk, in any encoding, and on closed streams."""
    rollout = "$O rollout ffa_2 --worlds 2 --others random"
    for unbuffered in ("", "1"):
        files = f"--csv a{unbuffered}.csv --json a{unbuffered}.json --events a{unbuffered}.events.csv"
        line = f"{rollout} --quiet {files} >/dev/full"
        status, text = outlast_in_shell(line, tmp_path, PYTHONUNBUFFERED=unbuffered)
        assert (status, "No space left on device" in text, "Traceback" in text) == (2, True, False)
    assert outlast_in_shell(f"{rollout} --quiet", tmp_path, PYTHONIOENCODING="ascii") == (0, "")
    assert outlast_in_shell(f"{rollout} --csv b.csv 2>&- >&-", tmp_path)[0] == 0
    names = "a.csv a.events.csv a.json a1.csv a1.events.csv a1.json b.csv"
    assert sorted(path.name for path in tmp_path.iterdir()) == names.split()


def test_what_a_mosaic_leaves_out_is_said(capsys, tmp_path: Path) -> None:
    small = ("--steps=1", "--size=64", "--quiet", "--out", tmp_path / "frames")
    status, _, err = run(capsys, "frames", "ffa_1", "--mosaic=2x2", "--worlds=9", *small)
    assert (status, err) == (0, "outlast: a mosaic of 2x2 has room for 4 of the 9 worlds\n")


def completed(script: str, shell: str, *words: str) -> set[str]:
    """What the shell offers in the place of the last word."""
    if shell == "bash":
        given = " ".join(map(shlex.quote, ("outlast", *words)))
        call = f'COMP_WORDS=({given}); COMP_CWORD={len(words)}; _shtab_outlast; printf "%s\\n" "${{COMPREPLY[@]}}"'
        text = f"{script}\n{call}"
        done = subprocess.run(["bash", "-c", text], capture_output=True, text=True, check=True)
    else:
        text = f"{script}\ncomplete -C {shlex.quote(' '.join(('outlast', *words)))}"
        done = subprocess.run(["fish", "--no-config", "-c", text], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return {line.partition("\t")[0] for line in done.stdout.splitlines()}


@pytest.mark.parametrize("shell", ["bash", "fish"])
def test_shells_complete(shell: str, capsys, tmp_path: Path, monkeypatch) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a fight.rec").write_text("")
    script = run(capsys, "completion", shell)[1]
    assert completed(script, shell, "ro") == {"rollout"}
    assert completed(script, shell, "rollout", "ffa_") == {"ffa_1", "ffa_2", "ffa_3", "ffa_4"}
    assert completed(script, shell, "rollout", "ffa_2", "--pol") == {"--policy"}
    assert completed(script, shell, "rollout", "ffa_2", "--policy", "sc") == {"scripted"}
    assert completed(script, shell, "rollout", "ffa_2", "--quiet", "--se") >= {"--seed", "--set"}
    assert completed(script, shell, "train", "ffa_2", "--preset", "o") == {"original"}
    assert completed(script, shell, "help", "sch") == {"schedule"}
    assert completed(script, shell, "layout", "ma") == completed(script, shell, "check", "--layout", "ma") == {"maze"}
    (found,) = completed(script, shell, "replay", "a")
    assert found.replace("\\", "") == "a fight.rec"


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed")
def test_the_script_for_zsh_is_read(capsys, tmp_path: Path) -> None:
    (tmp_path / "_outlast").write_text(run(capsys, "completion", "zsh")[1])
    load = f"fpath=({tmp_path} $fpath); autoload -U compinit; compinit -u -D"
    text = f"{load}; autoload +X _outlast; print $_comps[outlast]"
    done = subprocess.run(["zsh", "-f", "-c", text], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("_outlast\n", "")


def test_layouts_are_drawn_and_written_down(capsys, tmp_path: Path) -> None:
    assert run(capsys, "layout", "pillars", "--set", "n_pillars=5", "--out", tmp_path / "plan.json")[0] == 0
    assert len(FloorPlan.load(tmp_path / "plan.json").walls) == 5
    for name, out in (("pillars", "one.png"), (tmp_path / "plan.json", "two.png")):
        more = ("--set", "n_pillars=5") if name == "pillars" else ()
        assert run(capsys, "layout", name, *more, "--variant", "ffa_1", "--out", tmp_path / out)[0] == 0
    one, two = (cv2.imread(str(tmp_path / out)) for out in ("one.png", "two.png"))
    assert (one.shape, two.shape) == ((384, 384, 3), (384, 384, 3))
    assert (one != two).any(-1).mean() < 0.02  # who starts where is drawn by another mechanic
    assert run(capsys, "layout", "pillars", "--worlds", 3, "--out", tmp_path / "three.png")[0] == 0
    assert cv2.imread(str(tmp_path / "three.png")).shape == (771, 771, 3)
    assert run(capsys, "layout", "rooms", "--worlds", 2, "--out", tmp_path / "rooms.html")[0] == 0
    assert "<title>rooms: ffa_3-with_rooms" in (tmp_path / "rooms.html").read_text()


def test_a_floor_plan_overwrites_nothing(capsys, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    FloorPlan(walls=[(0, 0, 6, 0.4)], starts=[(0, -8, 0, 4, 8), (1, 8, 0, 4, 8)]).save("plan.json")
    before = Path("plan.json").read_bytes()
    status, _, err = run(capsys, "layout", "plan.json", "--variant", "ffa_1", "--out", "walls.json")
    assert (status, "plan.json has start areas, which are not written" in err) == (0, True)
    status, _, err = run(capsys, "layout", "maze", "--out", "plan.json")
    assert (status, "plan.json exists; floor plans never overwrite files" in err) == (2, True)
    assert Path("plan.json").read_bytes() == before


def test_commands_take_a_layout(capsys, tmp_path: Path) -> None:
    (tmp_path / "plan.txt").write_text("A" + "." * 38 + "B\n" + "." * 40 + "\n" + ".....#" * 6 + "....\n" + "." * 40)
    given = ("rollout", "ffa_1", "--layout", tmp_path / "plan.txt", "--set", "safe_zone_radii=2,1")
    assert "room_width=40" in run(capsys, *given, "--worlds", 2, "--steps", 5, "--quiet")[1]
    assert run(capsys, "schedule", "ffa_1", "--layout", "maze")[1].count("maze.") > 3
