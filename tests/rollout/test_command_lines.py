"""Command lines as people type them: help, counts, signs, and what is refused in one line."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from outlast.envs.cli import main as cli
from outlast.envs.cli import options
from outlast.envs.cli.grammar import Parser
from outlast.envs.cli.overview import SECTIONS, summaries
from outlast.envs.rollout.policies import POLICIES
from tests.conftest import run


def commands() -> Any:
    """The commands of the parser, as argparse keeps them."""
    (found,) = (action for action in cli.parser()._actions if isinstance(action.choices, dict))
    return found


NAMES = list(commands().choices)
FEW = "rollout ffa_1 --worlds 2 --steps 3 --quiet"

# ---- help


def test_alone_it_shows_every_command_with_an_example(capsys: Any) -> None:
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
def test_help_of_a_command(capsys: Any, name: str) -> None:
    """It says what it does, options stand in groups, and every example is understood."""
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


# ---- counts and signs


@pytest.mark.parametrize(
    ("text", "value"),
    [("7", 7), ("1e3", 1000), ("2.5e6", 2_500_000), ("1_000", 1000), ("1E3", 1000), ("3.0", 3), (" 4 ", 4)],
)
def test_counts_are_written_as_people_write_them(text: str, value: int) -> None:
    assert options.count(text) == value


@pytest.mark.parametrize("text", ["0", "-1", "1.5", "1e-3", "nan", "inf", "1e999999999", "x", "", "1,000", "0x10"])
def test_what_is_no_count_is_refused(text: str) -> None:
    with pytest.raises(options.argparse.ArgumentTypeError, match=r"an integer of at (least 1|most 1,000,000,000,000)"):
        options.count(text)


def test_every_count_of_every_command_takes_an_exponent() -> None:
    """Whatever is an integer by default, or takes one."""
    kinds = {options.positive, options.nonnegative, options.seed, options.port}
    for name, command in commands().choices.items():
        for _, actions in command.groups():
            for action in actions:
                assert action.type is not int, (name, action.option_strings)
                if action.type in kinds - {options.port}:
                    assert action.type("1e3") == 1000


def test_a_value_may_begin_with_a_minus() -> None:
    words = ["frames", "ffa_1", "--views", "-ids,+vision", "--steps", "3", "--out", "film"]
    parsed = cli.parser().parse_args(words)
    assert (parsed.views, parsed.steps) == ("-ids,+vision", 3)
    assert cli.parser().parse_args(["frames", "ffa_1", "--views=-ids", "--out", "f"]).views == "-ids"


# ---- mistakes

NONE = "must be >= 1 and <= 65536; for none, leave it out: --without"
LINES = {
    "rolout ffa_1": "COMMAND: rolout: did you mean rollout?; known: variants",
    "help rolout": "COMMAND: rolout: did you mean rollout?",
    "--verison": "there is no option --verison: did you mean --version?",
    f"{FEW} --wrlds 3": "there is no option --wrlds: did you mean --worlds?",
    f"{FEW} --wrlds=3": "there is no option --wrlds: did you mean --worlds?",
    f"{FEW} ffa_2": "ffa_2 is one word too many",
    "evaluate ffa_2 random --episodes 1 scripted": "scripted is one word too many; put what belongs together in a row",
    "rollout": "required: VARIANT",
    "frames ffa_1": "required: --out",
    "frames ffa_1 --out ''": "--out: the name of a file or folder is needed, not nothing",
    "frames ffa_1 --out / --steps 1 --quiet": "give a folder of their own",
    f"{FEW} --record ''": "--record: the name of a file or folder is needed, not nothing",
    f"{FEW} --record -": "--record: the name of a file is needed: only --json - writes to standard output",
    f"{FEW} --roles ''": "--roles: the name of a file or folder is needed, not nothing",
    "replay ''": "file: the name of a file or folder is needed, not nothing",
    f"{FEW} --seed {2**64}": f"--seed: {2**64}: an integer of at most 2**64 - 1 is needed",
    f"{FEW} --seed -1": "--seed: -1: an integer of at least 0 is needed, such as 1000 or 1e6",
    f"{FEW} --steps many": "--steps: many: an integer of at least 1 is needed",
    f"{FEW} --steps 1e13": "--steps: 1e13: an integer of at most 1,000,000,000,000 is needed",
    f"{FEW} --worlds": "--worlds: expected one argument",
    f"{FEW} --worlds 0": "--worlds: 0: an integer of at least 1 is needed",
    "rollout ffa_1 --worlds 1e12": "there is not enough memory, take fewer --worlds",
    f"{FEW} --set room_size=1e30": "room.size = 1e+30: must be >= 1 and <= 10000",
    f"{FEW} --set n_agents=100": "115 bodies (100 agent, 15 heal) do not fit into spawn_grid.cells = 8 x 8 = 64 cells",
    "rollout ffa_1 --set mele_damage=3": "no number 'mele_damage'; did you mean melee_damage",
    "rollout ffa_1 --set n_heals=0": f"heals.count = 0: {NONE} heals",
    "rollout ffa_3 --set n_boxes=0": f"boxes.count = 0: {NONE} boxes",
    "rollout ffa_1 --set safe_zone_radii=5,x": "safe_zone.radii[1] = 'x': a finite number",
    "rollout ffa_1 --set safe_zone_radii=": "safe_zone.radii[0] = '': a finite number",
    "rollout ffa_1 --set safe_zone_radii=13,4": "safe_zone.radii: 13 does not fit into a room of side 25",
    "rollout ffa_1 --set melee_damage=1,2": "melee.damage = '1,2': an integer",
    f"{FEW} --set agents_count": "--set agents_count: NUMBER=VALUE is needed",
    f"{FEW} --episodes 3": "not allowed with argument --steps",
    f"{FEW} --policy nobody": f"nobody: did you mean noop? {', '.join(POLICIES)} or a saved policy",
    f"{FEW} --policy scriptd": f"scriptd: did you mean scripted? {', '.join(POLICIES)} or a saved policy",
    f"{FEW} --policy nowhere.zip": "nowhere.zip",
    f"{FEW} --others scripted:x": "the weight of scripted is 'x'",
    f"{FEW} --csv a.parquet": "episodes are written as NAME.csv",
    f"{FEW} --record nowhere/a.rec": "nowhere/a.rec cannot be written: there is no folder nowhere",
    "rollout ffa_9": "there is no variant 'ffa_9'; did you mean ffa_4 or ffa_3? known: ffa_1, ",
    "rollout nowhere.py:arena": "nowhere.py",
    "schedule ''": "''",
    "schedule nothing": "there is no variant 'nothing'; known: ",
    "replay nowhere.rec": "nowhere.rec: No such file or directory",
    "replay .": "",
    "play ffa_1 --fps 0 --no-browser": "--fps: 0: a number above 0",
    "play ffa_1 --port 99999": "--port: 99999: a port is needed",
    "completion tcsh": "shell: tcsh",
}


@pytest.mark.parametrize("line", LINES)
def test_mistakes_are_one_line(line: str, capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
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


UNBUFFERED = pytest.mark.parametrize("unbuffered", ["", "1"])
needs_bash = pytest.mark.skipif(shutil.which("bash") is None or not Path("/dev/full").exists(), reason="needs Linux")


@needs_bash
@UNBUFFERED
def test_who_stops_reading_stops_a_command_in_silence(tmp_path: Path, unbuffered: str) -> None:
    for words in ("variants", "--help"):
        line = f"$O {words} | true; exit ${{PIPESTATUS[0]}}"
        assert outlast_in_shell(line, tmp_path, PYTHONUNBUFFERED=unbuffered) == (0, "")


@needs_bash
@UNBUFFERED
def test_files_are_complete_whatever_becomes_of_what_is_printed(tmp_path: Path, unbuffered: str) -> None:
    line = (
        "$O rollout ffa_2 --worlds 2 --quiet --others random --csv a.csv --json a.json --events a.events.csv >/dev/full"
    )
    status, text = outlast_in_shell(line, tmp_path, PYTHONUNBUFFERED=unbuffered)
    assert status == 2
    assert "No space left on device" in text
    assert "Traceback" not in text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "a.events.csv", "a.json"]


@needs_bash
def test_any_encoding_and_closed_streams_will_do(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="needs imageio-ffmpeg: outlast[video]")
    rollout = "$O rollout ffa_2 --worlds 2 --others random"
    assert outlast_in_shell(f"{rollout} --quiet", tmp_path, PYTHONIOENCODING="ascii") == (0, "")
    assert outlast_in_shell(f"{rollout} --csv a.csv 2>&- >&-", tmp_path)[0] == 0
    assert outlast_in_shell("$O frames ffa_1 --steps 2 --size 64 --out a.mp4 --quiet 2>&-", tmp_path)[0] == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "a.mp4"]


def test_what_a_mosaic_leaves_out_is_said(capsys: Any, tmp_path: Path) -> None:
    small = ("--steps=1", "--size=64", "--quiet", "--out", tmp_path / "frames")
    status, _, err = run(capsys, "frames", "ffa_1", "--mosaic=2x2", "--worlds=9", *small)
    assert (status, err) == (0, "outlast: a mosaic of 2x2 has room for 4 of the 9 worlds\n")


def test_a_data_set_is_what_its_name_says(capsys: Any, tmp_path: Path) -> None:
    recording = tmp_path / "a.rec"
    run(capsys, *shlex.split(FEW), "--record", recording)
    status, _, err = run(capsys, "replay", recording, "--quiet", "--data", tmp_path / "samples.csv")
    assert status == 2
    assert "there is no export to .csv; give a folder without an ending for .npz files, NAME.parquet" in err
    assert [file.name for file in tmp_path.iterdir()] == ["a.rec"]


# ---- completion


def completed(script: str, shell: str, *words: str) -> set[str]:
    """What the shell offers in the place of the last word."""
    if shell == "bash":
        given = " ".join(map(shlex.quote, ("outlast", *words)))
        text = f'{script}\nCOMP_WORDS=({given}); COMP_CWORD={len(words)}; _outlast; printf "%s\\n" "${{COMPREPLY[@]}}"'
        done = subprocess.run(["bash", "-c", text], capture_output=True, text=True, check=True)
    else:
        text = f"{script}\ncomplete -C {shlex.quote(' '.join(('outlast', *words)))}"
        done = subprocess.run(["fish", "--no-config", "-c", text], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return {line.partition("\t")[0] for line in done.stdout.splitlines()}


@pytest.mark.parametrize("shell", ["bash", "fish"])
def test_shells_complete(shell: str, capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
def test_the_script_for_zsh_is_read(capsys: Any, tmp_path: Path) -> None:
    (tmp_path / "_outlast").write_text(run(capsys, "completion", "zsh")[1])
    load = f"fpath=({tmp_path} $fpath); autoload -U compinit; compinit -u -D"
    text = f"{load}; autoload +X _outlast; print $_comps[outlast]"
    done = subprocess.run(["zsh", "-f", "-c", text], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("_outlast\n", "")
