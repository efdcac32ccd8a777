"""The commands in README and on the pages run, in their order, each page in a folder of its own."""

import re
import shlex
from pathlib import Path

import pytest

from outlast.envs.cli.main import main
from outlast.envs.rollout.saved import CHECKPOINT, models
from tests.conftest import COMPILED

ROOT = Path(__file__).resolve().parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
SMALL = {  # the same commands with less work: of an option that is given twice, the last counts
    "frames": ["--steps", "3", "--quiet"],
    "replay": ["--quiet"],
    "rollout": ["--worlds", "5", "--steps", "60", "--quiet"],
}
SMALL_PICTURES = ["--size", "64"]
ELSEWHERE = {"play", "train", "watch", "plot", "evaluate", "benchmark"}  # long, or needing results


def shown(page: Path) -> list[list[str]]:
    """The arguments of each command in a page's shell blocks."""
    blocks = re.findall(r"^```bash\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)
    lines = re.findall(r"^(?:.* && )?(?:\S*/)?outlast (.*)$", "\n".join(blocks), re.MULTILINE)
    return [shlex.split(line, comments=True) for line in lines]


@pytest.mark.skipif(not COMPILED, reason="the commands are the same in every mode")
@pytest.mark.parametrize("page", [page for page in PAGES if shown(page)], ids=lambda page: page.stem)
@pytest.mark.by_day(8)
def test_commands_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("docs").mkdir()
    for game in (ROOT / "docs/examples").glob("*.py"):
        Path(game.name).symlink_to(game)
    for name in ("results", "docs/examples"):  # trained policies, and games of one's own
        Path(name).symlink_to(ROOT / name)
    run = Path("runs/ffa_2-fast-0")  # in place of what the page trains
    run.mkdir(parents=True)
    for name, *options in shown(page):
        if name in ELSEWHERE:
            continue
        if any(option.startswith("runs/") or any(name in option for name in models()) for option in options):
            pytest.importorskip("torch", reason="needs PyTorch: outlast[train]")
            from tests.helpers.checkpoints import as_checkpoint

            as_checkpoint("ffa_2/original-0", run / CHECKPOINT.format(10_000_000))
        if "--out" in options:
            out = Path(options[options.index("--out") + 1])
            out.parent.mkdir(parents=True, exist_ok=True)
            options += SMALL_PICTURES if out.suffix not in (".json", ".html") else []
        if "--to" in options:
            options += ["--to", "30"]
        status = main([name, *options, *SMALL.get(name, ())])
        if extra := re.search(r"pip install '(outlast\[\w+\])'", capsys.readouterr().err):
            pytest.skip(f"{name} {' '.join(options)} needs {extra[1]}")
        assert status == 0


def test_there_are_commands_to_run() -> None:
    assert {name for page in PAGES for name, *_ in shown(page)} >= {*SMALL, *ELSEWHERE}
